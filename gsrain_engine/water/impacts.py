"""Impacts on the ground: drops that land, by place, time and size, as a function of (seed, place, time).

They are drawn from the flux of the drops in the air, N E[V], with the same spectrum and fall speeds, on a lattice that
is fixed to the ground: the field of drops fills a cell around the camera, while rings and splashes are visible far
beyond it, and from several cameras at once. In each cell and tick drops come in the order of their size, as a Poisson
process in the flux of larger ones: those above any size come first, and stay the same ones if the rain gets stronger.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt32

from ..kernels import kernel
from ..rain.calibration import Calibration
from ..rain.pcg_hash import pcg4d_scalar
from ..rain.properties import fall_speed, rain_properties
from ..rain.settings import LARGEST_MM, SMALLEST_MM, RainSettings
from ..rain.simulation import RainSimulation

CELL_M = 1.0
"""Edge of a cell of the lattice."""
TICK_S = 1 / 32
_EPOCH = 16
"""Ticks in which the rain counts as steady, by its intensity in the middle."""
WATER_KG_M3 = 998.0
_NODES = 1024
_KNOTS = 512


class LandedDrops(NamedTuple):
    """Drops that land. World frame, meters."""

    places_m: Float64[np.ndarray, "n 2"]
    """x and y."""
    times_s: Float64[np.ndarray, " n"]
    diameters_mm: Float64[np.ndarray, " n"]
    speeds_m_s: Float64[np.ndarray, " n"]
    """Downward."""
    larger_per_m2_s: Float64[np.ndarray, " n"]
    """Flux of the drops that are larger than this one."""
    hashes: UInt32[np.ndarray, " n"]
    """Number of its own, for random properties of what follows."""

    def only(self, mask: Bool[np.ndarray, " n"]) -> "LandedDrops":
        return LandedDrops(*(each[mask] for each in self))

    @property
    def energies_j(self) -> Float64[np.ndarray, " n"]:
        """Kinetic energies of the downward motion."""
        return kinetic_energy_j(self.diameters_mm, self.speeds_m_s)


def kinetic_energy_j(
    diameters_mm: Float64[np.ndarray, " n"], speeds_m_s: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Kinetic energy of spherical drops in J."""
    return WATER_KG_M3 * np.pi / 12 * (1e-3 * diameters_mm) ** 3 * speeds_m_s**2


@dataclass(frozen=True, eq=False)
class ImpactFlux:
    """Flux of drops through level ground in steady rain, by size."""

    diameters_mm: Float64[np.ndarray, " n"]
    """Falling, from `LARGEST_MM` to `SMALLEST_MM`."""
    speeds_m_s: Float64[np.ndarray, " n"]
    larger_per_m2_s: Float64[np.ndarray, " n"]
    """Number of larger drops that land on a square meter in a second: the integral of N p(D) V(D)."""
    power_w_m2: Float64[np.ndarray, " n"]
    """Kinetic energy that larger drops bring to a square meter in a second."""

    @property
    def per_m2_s(self) -> float:
        """Number of all drops on a square meter in a second."""
        return float(self.larger_per_m2_s[-1])

    def larger_than(self, diameter_mm: float) -> float:
        """Number of larger drops on a square meter in a second."""
        return float(np.interp(-diameter_mm, -self.diameters_mm, self.larger_per_m2_s))

    def largest_drops(self, per_m2_s: float) -> tuple[float, Float64[np.ndarray, "knots 2"]]:
        """Rate of the largest drops, of at most that many a square meter and second, and their sizes.

        Diameter (mm) and speed (m/s) at the fourth powers of equal steps of the share of that rate.
        """
        rate = min(self.per_m2_s, per_m2_s)
        knots = rate * _shares() ** 4
        values = [np.interp(knots, self.larger_per_m2_s, each) for each in (self.diameters_mm, self.speeds_m_s)]
        return rate, np.stack(values, axis=1)

    def power_of(self, share: Callable[[Float64[np.ndarray, " n"]], Float64[np.ndarray, " n"]]) -> float:
        """Kinetic energy per square meter and second times a share, a function of `larger_per_m2_s`."""
        middle = 0.5 * (self.larger_per_m2_s[1:] + self.larger_per_m2_s[:-1])
        return float(np.sum(np.diff(self.power_w_m2) * share(middle)))


@lru_cache(maxsize=16)
def impact_flux(rain: RainSettings, calibration: Calibration) -> ImpactFlux:
    """Flux of drops on level ground for a rain's intensity, closure and turbulence; wind does not change it."""
    state = rain_properties(rain, calibration)
    diameters = np.geomspace(LARGEST_MM, SMALLEST_MM, _NODES)
    speeds = fall_speed(rain, calibration)(diameters)
    flux = state.density_m3 * state.sizes.probability_per_mm(diameters) * speeds

    def summed(values: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * -np.diff(diameters))])

    return ImpactFlux(diameters, speeds, summed(flux), summed(flux * kinetic_energy_j(diameters, speeds)))


@dataclass(frozen=True, eq=False)
class GroundImpacts:
    """Impacts of a rain, with its keyframes, on level ground."""

    rainfall: RainSimulation

    def flux_at(self, time_s: float) -> ImpactFlux:
        """Flux in the lattice's epoch around a time, half a second long."""
        middle = (np.floor(time_s / (TICK_S * _EPOCH)) + 0.5) * TICK_S * _EPOCH
        rain = self.rainfall.weather.rain_at(self.rainfall.rain, float(middle))
        bare = RainSettings(
            intensity_mm_h=rain.intensity_mm_h, closure=rain.closure, velocity=rain.velocity,
            turbulence_m_s=rain.turbulence_m_s, diameter_scale=rain.diameter_scale,
        )  # fmt: skip
        return impact_flux(bare, self.rainfall.calibration)

    def land(
        self, cells: Int64[np.ndarray, "m 2"], start_s: float, end_s: float, largest_per_m2_s: float = np.inf
    ) -> LandedDrops:
        """Drops that land in cells of the lattice (x and y, in `CELL_M`) from a time to another.

        Only the largest drops, of which that many land on a square meter in a second.
        """
        first, last = int(np.floor(start_s / TICK_S)), int(np.ceil(end_s / TICK_S))
        epochs = np.arange(first // _EPOCH, (last - 1) // _EPOCH + 1)
        tables, ends = np.empty((len(epochs), _KNOTS, 2)), np.empty(len(epochs))
        for k, epoch in enumerate(epochs):
            ends[k], tables[k] = self.flux_at((epoch + 0.5) * _EPOCH * TICK_S).largest_drops(largest_per_m2_s)
        ground = np.ascontiguousarray(cells, np.int64)
        expected = len(cells) * (last - first) * CELL_M**2 * TICK_S * float(ends.max(initial=0.0))
        room = int(expected + 8 * np.sqrt(expected)) + 16
        while True:
            rows, hashes = np.empty((room, 6)), np.empty(room, np.uint32)
            count = _land(ground, first, last, self.rainfall.rain.seed, ends, tables, rows, hashes)
            if count <= room:
                break
            room = count
        rows, hashes = rows[:count], hashes[:count]
        found = np.flatnonzero((rows[:, 2] >= start_s) & (rows[:, 2] < end_s))
        rows = rows[found]
        return LandedDrops(rows[:, :2], rows[:, 2], rows[:, 3], rows[:, 4], rows[:, 5], hashes[found])


def cells_around(low_m: Float64[np.ndarray, "2"], high_m: Float64[np.ndarray, "2"]) -> Int64[np.ndarray, "m 2"]:
    """Cells of the lattice that meet a rectangle."""
    (x0, y0), (x1, y1) = (np.floor(each / CELL_M).astype(np.int64) for each in (low_m, high_m))
    x, y = np.meshgrid(np.arange(x0, x1 + 1), np.arange(y0, y1 + 1))
    return np.stack([x.ravel(), y.ravel()], axis=1)


@lru_cache(maxsize=1)
def _shares() -> Float64[np.ndarray, " knots"]:
    return np.linspace(0, 1, _KNOTS)


_STRIDE, _TINY, _UNIT = np.uint32(0x9E3779B9), 2.0**-33, 2.0**-32


@numba.njit(inline="always")
@no_type_check
def _drawn(cell_x, cell_y, tick, number, seed):
    """Four 32-bit numbers of a drop: step to the next size, x, y and time."""
    mixed = np.uint32(np.uint32(seed) ^ np.uint32(np.uint32(number + 1) * _STRIDE))
    return pcg4d_scalar(np.uint32(cell_x), np.uint32(cell_y), np.uint32(tick), mixed)


@kernel(error_model="numpy")
@no_type_check
def _land(cells, first, last, seed, ends, tables, rows, hashes):
    """Write the drops as far as there is room, and return their number."""
    scale, at = 1 / (CELL_M * CELL_M * TICK_S), 0
    for n in range(len(cells)):
        for tick in range(first, last):
            epoch = tick // _EPOCH - first // _EPOCH
            end, larger, number = ends[epoch], 0.0, 0
            while True:
                step, x, y, later = _drawn(cells[n, 0], cells[n, 1], tick, number, seed)
                larger -= np.log(step * _UNIT + _TINY) * scale
                if larger >= end:
                    break
                number += 1
                at += 1
                if at > len(rows):
                    continue
                along = np.sqrt(np.sqrt(larger / end)) * (_KNOTS - 1)
                k = min(int(along), _KNOTS - 2)
                part = along - k
                row = rows[at - 1]
                row[0] = (cells[n, 0] + x * _UNIT) * CELL_M
                row[1] = (cells[n, 1] + y * _UNIT) * CELL_M
                row[2] = (tick + later * _UNIT) * TICK_S
                for column in range(2):
                    low, high = tables[epoch, k, column], tables[epoch, k + 1, column]
                    row[3 + column] = low + part * (high - low)
                row[5] = larger
                hashes[at - 1] = step ^ x ^ np.uint32(y * _STRIDE)
    return at
