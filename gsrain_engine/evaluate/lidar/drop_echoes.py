"""How strongly drops echo, and how many of them a beam meets that are detected."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from gsrain_engine.rain.drop_sizes import CLASSES
from gsrain_engine.rain.rain_state import RainState

from .sensor import LidarSensor
from .water import drop_reflectance

_STEP_M = 0.01


class DropEchoes(NamedTuple):
    """Drops that a sensor detects, each in one of its beams."""

    beams: Int64[np.ndarray, " m"]
    """Index of the beam."""
    ranges_m: Float64[np.ndarray, " m"]
    reflectances: Float64[np.ndarray, " m"]
    """Of something that fills the beam and sends back as much."""

    @staticmethod
    def joined(*parts: "DropEchoes") -> "DropEchoes":
        return DropEchoes(*(np.concatenate(column) for column in zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class DropSignals:
    """Echoes of one rain's drops in one sensor's beams.

    A drop whose centre is in a beam of the width w takes (D / w)^2 of it and sends `drop_reflectance` of that back.
    Drops count one by one: that two within a pulse are strong enough only together is left out.
    """

    sensor: LidarSensor
    state: RainState

    @cached_property
    def _strengths_mm2(self) -> Float64[np.ndarray, " classes"]:
        """Rises with the class: what a larger drop's back loses by absorption is less than what its size adds."""
        diameters = self.state.sizes.class_diameters_mm
        return diameters**2 * drop_reflectance(diameters, self.sensor.wavelength_nm)

    def reflectances(
        self, ranges_m: Float64[np.ndarray, " m"], classes: Int64[np.ndarray, " m"]
    ) -> Float64[np.ndarray, " m"]:
        """Reflectance of something that fills the beam and sends back as much as a drop of a class."""
        return 1e-6 * self._strengths_mm2[classes] / self.sensor.beam_width_m(ranges_m) ** 2

    def first_detected(self, ranges_m: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
        """Smallest class that is detected at a range; `CLASSES` where none is."""
        clear = np.exp(2 * self.state.extinction_per_m * ranges_m)
        with np.errstate(over="ignore"):
            needed = 1e6 * self.sensor.detectable(ranges_m) * clear * self.sensor.beam_width_m(ranges_m) ** 2
        return np.searchsorted(self._strengths_mm2, needed)

    @cached_property
    def reach_m(self) -> float:
        """Beyond this no drop is detected."""
        ranges = np.arange(0, min(self.sensor.range_m, self.sensor.farthest_m) + _STEP_M, _STEP_M)
        seen = np.flatnonzero(self.first_detected(ranges) < CLASSES)
        return float(ranges[seen[-1]]) + _STEP_M if len(seen) else 0.0

    @cached_property
    def grid_m(self) -> Float64[np.ndarray, " k"]:
        """Ranges up to the reach, evenly."""
        return np.linspace(0, self.reach_m, max(round(self.reach_m / _STEP_M), 1) + 1)

    @cached_property
    def expected(self) -> Float64[np.ndarray, " k"]:
        """Mean number of detected drops in a beam up to each range of the grid.

        The integral of N pi/4 w(r)^2 P(D is detected at r) over r. 0 without rain.
        """
        shares = 1 - self.first_detected(self.grid_m) / CLASSES
        per_m = self.state.density_m3 * np.pi / 4 * self.sensor.beam_width_m(self.grid_m) ** 2 * shares
        steps = np.diff(self.grid_m) * (per_m[1:] + per_m[:-1]) / 2
        return np.concatenate([[0.0], np.cumsum(steps)])

    def expected_up_to(self, ranges_m: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Mean number of detected drops in a beam up to a range."""
        return np.interp(ranges_m, self.grid_m, self.expected)
