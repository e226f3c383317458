"""Virtual disdrometer that counts the drops of the simulated field falling through a horizontal area."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float64, Int64
from scipy.interpolate import CubicHermiteSpline

from ..kernels import kernel, range_of
from ..rain.air import DropAir
from ..rain.drop_field import CLASS_STRIDE, FIRST_OF_CLASS, DropPhases, own_steps
from ..rain.frame import RainCamera
from ..rain.pcg_hash import pcg4d_scalar
from ..rain.properties import CLASSES
from ..rain.simulation import RainSimulation
from ..scene.camera import Camera
from .measurement import DisdrometerMeasurement

SMALLEST_AREA_M2 = 1e-4
"""A thumbnail's area; smaller ones catch no drops."""

_MIDDLE, _WHOLE = 2**31, 2**32
_HERE = RainCamera(Camera.from_fov(1, 1, 45.0, np.eye(4)), np.eye(4), np.zeros(3))
"""Fixed camera at the anchor; the field doesn't depend on the camera."""


@dataclass(frozen=True, eq=False)
class VirtualDisdrometer:
    """A horizontal square, fixed in the middle of the streak region.

    Counts are exact, not sampled: a drop's integer position in the lattice gives all times at which it crosses the
    square's height, and its x and y at each, so exactly the drawn drops are counted. (Only wind that changes within a
    record is taken from its middle for the drops' offsets.) Raises `ValueError` if the square
    is larger than one period of the lattice, as it would count the same drop twice.
    """

    rainfall: RainSimulation
    area_m2: float = 0.5

    def __post_init__(self) -> None:
        largest = float(np.min(self.rainfall.frame(0.0, _HERE).period_m[:2])) ** 2
        if not SMALLEST_AREA_M2 <= self.area_m2 <= largest * (1 + 1e-9):
            raise ValueError(
                f"area {self.area_m2:g} m²: must be within {SMALLEST_AREA_M2:g}..{largest:.4g} m², "
                "the most before the drop field repeats"
            )

    def measure(self, times_s: Float64[np.ndarray, " records_and_one"]) -> DisdrometerMeasurement:
        """Count one record for each pair of successive times, in constant rain."""
        return self.collect(times_s, [self.count(start, end) for start, end in pairwise(times_s)])

    def records(self, times_s: Float64[np.ndarray, " records_and_one"]) -> list[DisdrometerMeasurement]:
        """Count records in turn, each with the drop sizes and speeds of its midpoint, which vary under rain keyframes.

        Records should be short compared with the changes, because the drop population is also that of the midpoint.
        """
        moments = [0.5 * (start + end) for start, end in pairwise(times_s)]
        return [
            replace(self, rainfall=self.rainfall.frozen_at(middle)).collect(span, [self.count(*span)])
            for middle, span in zip(moments, np.stack([times_s[:-1], times_s[1:]], axis=1), strict=True)
        ]

    def count(self, start_s: float, end_s: float) -> Int64[np.ndarray, " classes"]:
        """Number of drops of each class in [start, end)."""
        times_s = start_s, 0.5 * (start_s + end_s), end_s
        field, middle, later = (self.rainfall.frame(time_s, _HERE) for time_s in times_s)
        before, after = _places(field.where), _places(later.where)
        size = np.round(np.minimum(np.sqrt(self.area_m2) / field.period_m[:2], 1) * _WHOLE).astype(np.int64)
        path = _path(self.rainfall, start_s, end_s)
        gusts = _gusts(self.rainfall, start_s, field.center_m, middle.where.air)
        counts = np.zeros(CLASSES, np.int64)
        air, seconds = middle.where.air, end_s - start_s
        _count(np.uint32(field.rain.seed), middle.count, before, after, size, path, seconds, *air, *gusts, counts)
        return counts

    def collect(
        self, times_s: Float64[np.ndarray, " records_and_one"], counts: list[Int64[np.ndarray, " classes"]]
    ) -> DisdrometerMeasurement:
        """Combine the counts of successive records."""
        return DisdrometerMeasurement(
            state=self.rainfall.state,
            times_s=times_s,
            area_m2=self.area_m2,
            diameters_mm=self.rainfall.diameters_mm,
            fall_speed_m_s=self.rainfall.motion.fall_speed_m_s,
            counts=np.stack(counts),
        )


def _places(where: DropPhases) -> Int64[np.ndarray, "classes 3"]:
    """Offsets as integers, 2^32 to a period."""
    return where.wraps.astype(np.int64) * _WHOLE + where.fractions


def _path(rainfall: RainSimulation, start_s: float, end_s: float) -> Float64[np.ndarray, "4 2"]:
    """Drift of the lattice since the start in meters: coefficients of a cubic of time."""
    times = np.array([start_s, end_s])
    motions = [rainfall.frozen_at(time).motion for time in times]
    drift = np.stack([motion.drift(time) for motion, time in zip(motions, times, strict=True)])
    return CubicHermiteSpline(times, drift - drift[0], np.stack([motion.wind.drift_m_s for motion in motions])).c[:, 0]


def _gusts(
    rainfall: RainSimulation, start_s: float, center_m: Float64[np.ndarray, "3"], air: DropAir
) -> tuple[Float64[np.ndarray, "2 modes"], Float64[np.ndarray, "modes"], Float64[np.ndarray, "modes"]]:
    """Phases of the gusts' modes in the middle of the cell at the start, their rates in 1/s, and reaches in m^2/s."""
    motion = rainfall.frozen_at(start_s).motion
    height_m = float(air.numbers[0] + air.numbers[1] / 2)
    x_m = float(center_m[0] - motion.drift(start_s)[0])
    phases, rates, reaches = motion.wind.modes(start_s, height_m, x_m, float(air.numbers[2]))
    return phases, rates, motion.scales(start_s).gust_m_s * reaches


@kernel(parallel=True)
@no_type_check
def _count(
    portion,
    seed,
    count,
    before,
    after,
    size,
    path,
    seconds,
    air_rows,
    air_classes,
    air_numbers,
    phases,
    rates,
    reaches,
    counts,
):
    """Count class by class, in an order that balances slow and fast classes over threads."""
    for j in range_of(portion, CLASSES):
        c = (j * CLASS_STRIDE) % CLASSES
        first = (c * FIRST_OF_CLASS) % CLASSES
        counts[c] = _count_class(
            first, count, seed, before[c], after[c, 2], size, path, seconds, air_rows, air_classes[c], air_numbers,
            phases, rates, reaches,
        )  # fmt: skip


@numba.njit
@no_type_check
def _count_class(
    first, count, seed, before, after_z, size, path, seconds, air_rows, air_class, air_numbers, phases, rates, reaches
):
    zero, one, two, mask = np.uint32(0), np.uint32(1), np.uint32(2), np.int64(_WHOLE - 1)
    passed, node = 0, air_rows.shape[1] // 2
    low_x, low_y = _MIDDLE - size[0] // 2, _MIDDLE - size[1] // 2
    slow, gust, own, per_m = air_class[0], air_class[1], air_class[2], air_numbers[4] * _WHOLE
    height = air_numbers[0] + air_numbers[1] / 2
    sway = 0.0  # farther than any gust moves a drop
    for mode in range(len(rates)):
        sway += abs(reaches[mode] * gust)
    margin = np.int64(sway * abs(per_m)) + 2
    for i in range(first, count, CLASSES):
        number = np.uint32(i)
        _, _, start_z, _ = pcg4d_scalar(number, zero, zero, seed)
        above = np.int64(start_z) + before[2] - _MIDDLE
        below = np.int64(start_z) + after_z - _MIDDLE
        for k in range((below >> 32) + 1, (above >> 32) + 1):  # crossings of the cell's middle after k wraps
            t = (above - (k << 32)) / (above - below) * seconds
            wrap_z = np.uint32(k)
            start_x, drawn_x, drawn_y, _ = pcg4d_scalar(number, wrap_z, one, seed)
            offset = air_rows[0, node] * slow + own_steps(drawn_x) * own * height
            offset += _cubic(path, 0, t)
            calm_x = np.int64(start_x) + before[0] + np.int64(np.floor(offset * per_m))
            if ((calm_x - low_x + margin) & mask) >= size[0] + 2 * margin:
                continue
            for mode in range(len(rates)):
                offset += reaches[mode] * gust * np.sin(phases[0, mode] - rates[mode] * t)
            x = np.int64(start_x) + before[0] + np.int64(np.floor(offset * per_m))
            if not low_x <= (x & mask) < low_x + size[0]:
                continue
            _, start_y, _, _ = pcg4d_scalar(number, wrap_z, np.uint32(np.uint32(x >> 32) * two + two), seed)
            # The gusts' pattern drifts along.
            turn = air_numbers[2] * (((x & mask) - _MIDDLE) / per_m - _cubic(path, 0, t))
            offset = air_rows[1, node] * slow + own_steps(drawn_y) * own * height
            offset += _cubic(path, 1, t)
            for mode in range(len(rates)):
                offset += reaches[mode] * gust * np.sin(phases[1, mode] + turn - rates[mode] * t)
            y = np.int64(start_y) + before[1] + np.int64(np.floor(offset * per_m))
            if low_y <= (y & mask) < low_y + size[1]:
                passed += 1
    return passed


@numba.njit(inline="always")
@no_type_check
def _cubic(path, axis, t):
    return ((path[0, axis] * t + path[1, axis]) * t + path[2, axis]) * t + path[3, axis]
