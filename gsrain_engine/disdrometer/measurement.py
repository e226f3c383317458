"""Measurement of the virtual disdrometer: rain rate with its error, diameters, spectra."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64

from ..rain.properties import RainProperties
from ..rain.settings import LARGEST_MM, SMALLEST_MM
from .spectra import DropSpectra

INSTRUMENT = "GSRAIN virtual disdrometer"
_DIAMETER_EDGES_MM = np.arange(round(10 * SMALLEST_MM), round(10 * LARGEST_MM) + 1) / 10
_FASTEST_M_S = 12
_EPOCH = np.datetime64("1970-01-01T00:00:00", "ms")
_MM_PER_M, _SECONDS_PER_HOUR = 1e3, 3600


@dataclass(frozen=True, eq=False, kw_only=True)
class DisdrometerMeasurement:
    """Drops of each class of the rain field by record. All drops of a class have the same size and speed."""

    state: RainProperties
    """Properties of the simulated rain."""
    times_s: Float64[np.ndarray, " records_and_one"]
    """Simulated times of the records' bounds."""
    area_m2: float
    diameters_mm: Float64[np.ndarray, " classes"]
    fall_speed_m_s: Float64[np.ndarray, " classes"]
    counts: Int64[np.ndarray, "records classes"]

    @property
    def drops(self) -> int:
        return int(self.counts.sum())

    @property
    def seconds(self) -> Float64[np.ndarray, " records"]:
        return np.diff(self.times_s)

    @property
    def rate_mm_h(self) -> float:
        """Rain rate over all records: the drops' water over area and time."""
        return float(np.sum(self._totals * self._rate_of_one_mm_h))

    @property
    def standard_error_mm_h(self) -> float:
        """Standard error of the rate: sqrt(sum w^2), w the contribution of one drop; arrivals are Poisson.

        For an area that is a share p of the lattice's period, the true error is sqrt(1 - p) times this: the total is
        fixed.
        """
        return float(np.sqrt(np.sum(self._totals * self._rate_of_one_mm_h**2)))

    @property
    def record_rates_mm_h(self) -> Float64[np.ndarray, " records"]:
        return self.counts @ self._rate_of_one_mm_h * float(self.seconds.sum()) / self.seconds

    @property
    def in_air_m3(self) -> Float64[np.ndarray, " classes"]:
        """Drops of each class per cubic meter: each counted drop represents 1 / (V A t)."""
        falling = self._totals > 0
        speed = np.where(falling, self.fall_speed_m_s, 1.0)
        return self._totals / (speed * self.area_m2 * float(self.seconds.sum()))

    @property
    def density_m3(self) -> float:
        return float(np.sum(self.in_air_m3))

    @property
    def mean_diameter_mm(self) -> float | None:
        """Mean diameter of drops in the air, corrected for slow drops being counted less often; None without drops."""
        return float(self.in_air_m3 @ self.diameters_mm / self.density_m3) if self.drops else None

    @property
    def mean_counted_diameter_mm(self) -> float | None:
        """Mean diameter of the counted drops; None without drops."""
        return float(self._totals @ self.diameters_mm / self.drops) if self.drops else None

    @cached_property
    def spectra(self) -> DropSpectra:
        """Spectra in classes of 0.1 mm and 0.1 m/s, like an instrument's; time counts from 1970."""
        fastest = max(_FASTEST_M_S, int(np.ceil(np.max(self.fall_speed_m_s))))
        velocity_edges = np.arange(10 * fastest + 1) / 10
        row, column = _bins(self.diameters_mm, _DIAMETER_EDGES_MM), _bins(self.fall_speed_m_s, velocity_edges)
        shape = len(_DIAMETER_EDGES_MM) - 1, len(velocity_edges) - 1
        cell = row * shape[1] + column
        counts = [np.bincount(cell, weights=each, minlength=shape[0] * shape[1]) for each in self.counts]
        return DropSpectra(
            instrument=INSTRUMENT,
            times=_EPOCH + np.round(1e3 * self.times_s[1:]).astype("timedelta64[ms]"),
            seconds=self.seconds,
            diameter_edges_mm=_DIAMETER_EDGES_MM,
            velocity_edges_m_s=velocity_edges,
            counts=np.stack(counts).reshape(-1, *shape),
            area_m2=np.full(shape[0], self.area_m2),
            reported_mm_h=self.record_rates_mm_h,
        )

    @property
    def _totals(self) -> Int64[np.ndarray, " classes"]:
        return self.counts.sum(axis=0)

    @property
    def _rate_of_one_mm_h(self) -> Float64[np.ndarray, " classes"]:
        volume_m3 = np.pi / 6 * (1e-3 * self.diameters_mm) ** 3
        return _MM_PER_M * _SECONDS_PER_HOUR * volume_m3 / (self.area_m2 * float(self.seconds.sum()))


def _bins(values: Float64[np.ndarray, " n"], edges: Float64[np.ndarray, " e"]) -> Int64[np.ndarray, " n"]:
    """Class of each value; the last one includes its upper bound."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
