"""Ring waves: slopes of water where drops land, one by one near the camera, and their variance everywhere.

Each drop leaves a share of its kinetic energy in a packet of damped gravity-capillary waves, which spreads in a circle.
The spectrum of the slopes has the peak and the width that are measured in rain. Slopes of all rings add up. Where they
are narrower than a pixel, or too many, their variance is what is left: roughness of the mirror.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int32
from scipy import special

from ..kernels import kernel, range_of
from ..scene.ground_water import GroundWater
from .films import WaterDepth
from .impacts import CELL_M, WATER_KG_M3, GroundImpacts, LandedDrops, cells_around

PEAK_PER_M = 200.0
"""Wavenumber of the peak of the slope spectrum in deep water, rad/m (Craeye and co-authors 1999: 0.2 per mm)."""
WIDTH = 0.42
"""Standard deviation of the spectrum over ln k: 0.31 over ln f (Bliven, Sobieski and Craeye 1997), by dispersion."""
ENERGY_SHARE = 0.01
"""Share of a drop's kinetic energy that rings carry away (Craeye and co-authors 1999: of the order of 1 %)."""
TENSION_N_M, VISCOSITY_M2_S, _G = 0.0728, 1.0e-6, 9.81
_THINNEST_M = 1e-6  # of a film, where friction stops waves at once
_CALM_SLOPE = 0.01  # of standing water without rings, by wind and run-off; our choice
WAVENUMBERS_PER_M = np.linspace(15.0, 1000.0, 500)
AGES_S = np.arange(0.0, 1.02, 0.006)
RADII_M = np.arange(0.0, 0.302, 0.002)
"""Wavenumbers, ages and radii of the tables of rings."""
_DEPTHS_MM = 0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 100.0
_FOOTPRINT_PX = 0.4  # standard deviation of a pixel


def angular_frequency(wavenumber: Float64[np.ndarray, " k"], depth_m: float) -> Float64[np.ndarray, " k"]:
    """Angular frequency in rad/s of gravity-capillary waves: w^2 = (g k + sigma / rho k^3) tanh(k h) (Lamb 1932)."""
    k = wavenumber
    return np.sqrt((_G * k + TENSION_N_M / WATER_KG_M3 * k**3) * np.tanh(k * depth_m))


def damping_per_s(wavenumber: Float64[np.ndarray, " k"], depth_m: float) -> Float64[np.ndarray, " k"]:
    """Decay of the amplitude in 1/s: 2 nu k^2 in the water, and friction on the ground, k sqrt(nu w / 2) / sinh(2 k h).

    Lamb 1932; Hunt 1952 for the layer on the ground.
    """
    k, depth_m = wavenumber, max(depth_m, _THINNEST_M)
    bottom = (
        k * np.sqrt(0.5 * VISCOSITY_M2_S * angular_frequency(k, depth_m)) / np.sinh(np.minimum(2 * k * depth_m, 300))
    )
    return 2 * VISCOSITY_M2_S * k**2 + bottom


def _spectrum() -> Float64[np.ndarray, " k"]:
    """a^2 k for 1 J in the waves, a the amplitude of J_0(k r): log-normal, as slopes are in deep water.

    The energy of a packet is pi times the integral of (rho g + sigma k^2) a^2 k.
    """
    k = WAVENUMBERS_PER_M
    shape = np.exp(-0.5 * (np.log(k / PEAK_PER_M) / WIDTH) ** 2)
    return shape / (np.pi * np.trapezoid((WATER_KG_M3 * _G + TENSION_N_M * k**2) * shape, k))


def slope_spectrum(power_w_m2: float, depth_m: float) -> Float64[np.ndarray, " k"]:
    """Variance of slope per rad/m, at `WAVENUMBERS_PER_M`, of all rings of drops that bring a power to the ground.

    Campbell's theorem: packets arrive at random, each with the mean over its phases, and decay.
    """
    k = WAVENUMBERS_PER_M
    return ENERGY_SHARE * power_w_m2 * np.pi * k**2 * _spectrum() / (2 * damping_per_s(k, depth_m))


def slope_variance(power_w_m2: float, depth_m: float) -> float:
    """Mean square slope, of both directions together, of all rings."""
    return float(np.trapezoid(slope_spectrum(power_w_m2, depth_m), WAVENUMBERS_PER_M))


def standing_slope(power_w_m2: float, depth_m: float) -> float:
    """Standard deviation of slope, along one direction, of standing water with all rings as its roughness."""
    return float(np.sqrt(_CALM_SLOPE**2 + 0.5 * slope_variance(power_w_m2, depth_m)))


@lru_cache(maxsize=len(_DEPTHS_MM))
def ring_table(depth_mm: float) -> Float32[np.ndarray, "ages radii"]:
    """Radial slope of the ring of a drop with 1 J of kinetic energy, by age and radius.

    - integral of a k^2 J_1(k r) cos(w t) exp(-damping t) dk: the water begins with a dip that is let go.
    """
    k, depth_m = WAVENUMBERS_PER_M, 1e-3 * depth_mm
    amplitude = np.sqrt(ENERGY_SHARE * _spectrum() / k) * k**2 * (k[1] - k[0])
    phases = np.cos(AGES_S[:, None] * angular_frequency(k, depth_m)) * np.exp(
        -AGES_S[:, None] * damping_per_s(k, depth_m)
    )
    return -(phases * amplitude @ special.j1(k[:, None] * RADII_M)).astype(np.float32)


def _at_depth(depth_mm: float) -> Float32[np.ndarray, "ages radii"]:
    """Table for any depth: linear between neighbors, so that rings don't jump while a depth changes."""
    depths = np.array(_DEPTHS_MM)
    at = float(np.interp(np.log(max(depth_mm, 1e-3)), np.log(depths), np.arange(len(depths))))
    low = min(int(at), len(depths) - 2)
    part = np.float32(at - low)
    return (1 - part) * ring_table(_DEPTHS_MM[low]) + part * ring_table(_DEPTHS_MM[low + 1])


@dataclass(frozen=True, slots=True)
class RingReach:
    """Bounds of the rings that are followed one by one; the rest is roughness."""

    per_m2_s: float
    """The largest drops, of which that many land on a square meter in a second."""
    age_s: float

    def of_size(self, larger_per_m2_s: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
        """Factor on the slopes of a drop's ring: 0 for the smallest of them, so that none appears at once."""
        return np.clip((self.per_m2_s - larger_per_m2_s) / (0.25 * self.per_m2_s), 0, 1)

    def of_age(self, age_s: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
        share = np.clip((self.age_s - age_s) / (0.4 * self.age_s), 0, 1)
        return share * share * (3 - 2 * share)


FILM_RINGS = RingReach(300.0, 0.3)
STANDING_RINGS = RingReach(300.0, 0.5)
_FADE = 0.4  # last part of the distance up to which rings are followed, over which they turn into roughness
_NEARER = 0.6  # that distance on films, relative to that on standing water
_FARTHEST_M = 15.0
_FROM_STANDING = 0.25  # share of standing water at the impact from which its ring runs over it
_HASH_M = 0.125


class RingField(NamedTuple):
    """Rings by the cells of the ground that they reach, as kernels use them. Meters from `corner_m`."""

    corner_m: Float64[np.ndarray, "2"]
    starts: Int32[np.ndarray, "rows columns 2"]
    """First and past-the-last of each cell's `members`."""
    members: Int32[np.ndarray, " m"]
    centers_m: Float32[np.ndarray, "n 2"]
    radii_m: Float32[np.ndarray, " n"]
    """Radius beyond which a ring is flat."""
    slopes: Float32[np.ndarray, "n radii"]
    distance_m: float
    """Distance along the ground where the last ring has turned into roughness."""
    per_fade_m: float
    """1 over the distance in which they do so."""

    @classmethod
    def empty(cls) -> "RingField":
        nothing = np.zeros((0, 2), np.float32)
        return cls(
            np.zeros(2), np.zeros((0, 0, 2), np.int32), np.zeros(0, np.int32), nothing, nothing[:, 0],
            np.zeros((0, len(RADII_M)), np.float32), 0.0, 1.0,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class RingWaves:
    """Rings on the ground at one time, around a camera."""

    impacts: GroundImpacts
    time_s: float
    depth: WaterDepth
    ground: GroundWater
    eye_m: Float64[np.ndarray, "3"]
    """Position of the camera."""
    heading: Float64[np.ndarray, "2"]
    """Horizontal direction of the view, unit."""
    ground_m: float
    focal_px: float

    @property
    def distance_m(self) -> float:
        """Distance along the ground beyond which pixels are longer than the waves: 0.4 d^2 / (f h) = 2.6 / k."""
        above_m = max(self.eye_m[2] - self.ground_m, 0.0)
        return min(float(np.sqrt(2.6 / PEAK_PER_M * self.focal_px * above_m / _FOOTPRINT_PX)), _FARTHEST_M)

    @property
    def _depths_mm(self) -> tuple[float, float]:
        return self.depth.film_mm, max(self.depth.dip_mm, self.depth.film_mm)

    @cached_property
    def on_films(self) -> RingField:
        return self._field(FILM_RINGS, self._depths_mm[0], _NEARER * self.distance_m, 0)

    @cached_property
    def on_standing(self) -> RingField:
        return self._field(STANDING_RINGS, self._depths_mm[1], self.distance_m, 1)

    def slopes_along(self, distances_m: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Standard deviation of slope along the view of standing water at distances along the ground.

        That of calm water, and of all rings but for what is followed one by one and wider than a pixel.
        """
        reach, depth_m = STANDING_RINGS, 1e-3 * self._depths_mm[1]
        flux = self.impacts.flux_at(self.time_s)
        whole = slope_variance(float(flux.power_w_m2[-1]), depth_m)
        table, seen = _at_depth(self._depths_mm[1]).astype(np.float64), reach.of_age(AGES_S)
        squares = 2 * np.pi * (table**2 @ RADII_M) * (RADII_M[1] - RADII_M[0])
        followed = float(seen**2 @ squares) * (AGES_S[1] - AGES_S[0])
        followed *= flux.power_of(lambda larger: reach.of_size(larger) ** 2)
        turns = np.pi * (np.arange(16) + 0.5) / 16
        above_m = self.eye_m[2] - self.ground_m
        away = np.hypot(distances_m, above_m)
        across_m = _FOOTPRINT_PX * away / self.focal_px
        along_m = across_m * away / above_m
        blur = (along_m[:, None] * np.cos(turns)) ** 2 + (across_m[:, None] * np.sin(turns)) ** 2
        kept = np.mean(np.cos(turns) ** 2 * np.exp(-(PEAK_PER_M**2) * blur), axis=1)
        seen = np.clip((self.distance_m - distances_m) / (_FADE * self.distance_m), 0, 1)
        seen = seen * seen * (3 - 2 * seen)
        resolved = min(followed, whole) * kept * seen**2
        return np.sqrt(_CALM_SLOPE**2 + np.maximum(0.5 * whole - resolved, 0))

    def _field(self, reach: RingReach, depth_mm: float, distance_m: float, water: int) -> RingField:
        found = self.impacts.land(self._cells(distance_m), self.time_s - reach.age_s, self.time_s, reach.per_m2_s)
        if water == 1:
            found = found.only(self.ground.at(found.places_m)[:, 1] >= _FROM_STANDING)
        if not len(found.times_s):
            return RingField.empty()
        return _field_of(found, self.time_s, _at_depth(depth_mm), reach, distance_m)

    def _cells(self, reach_m: float) -> "np.ndarray":
        """Cells of the ground ahead, within reach and 60 degrees of the heading."""
        eye = self.eye_m[:2]
        cells = cells_around(eye - reach_m, eye + reach_m)
        away = (cells + 0.5) * CELL_M - eye
        distance = np.hypot(*away.T)
        ahead = away @ self.heading
        return cells[(distance < reach_m + CELL_M) & (ahead > 0.5 * distance - 1.5 * CELL_M)]


def _field_of(
    found: LandedDrops, time_s: float, table: Float32[np.ndarray, "ages radii"], reach: RingReach, distance_m: float
) -> RingField:
    age = time_s - found.times_s
    at = np.clip(age / (AGES_S[1] - AGES_S[0]), 0, len(AGES_S) - 1.001)
    low = at.astype(np.int64)
    part = (at - low).astype(np.float32)
    highest = np.abs(table).max(axis=1, keepdims=True)
    last = len(RADII_M) - 1 - np.argmax((np.abs(table) > 0.02 * highest)[:, ::-1], axis=1)
    ends = np.minimum(last[low + 1] + 1, len(RADII_M) - 1)
    strength = np.sqrt(found.energies_j) * reach.of_size(found.larger_per_m2_s) * reach.of_age(age)
    slopes = np.empty((len(age), int(ends.max()) + 1), np.float32)
    _fill_slopes(table, low, part, strength.astype(np.float32), slopes)
    radii = RADII_M[ends].astype(np.float32)
    corner = np.floor(found.places_m.min(axis=0) - RADII_M[-1])
    centers = (found.places_m - corner).astype(np.float32)
    columns, rows = (np.ceil((centers.max(axis=0) + RADII_M[-1]) / _HASH_M).astype(int) + 1).tolist()
    starts = np.zeros((rows, columns, 2), np.int32)
    _count_reached(centers, radii, starts)
    starts[..., 1] = np.cumsum(starts[..., 0]).reshape(rows, columns)
    members = np.empty(int(starts[-1, -1, 1]), np.int32)
    starts[..., 0] = starts[..., 1] - starts[..., 0]
    starts[..., 1] = starts[..., 0]
    _list_reached(centers, radii, starts, members)
    return RingField(corner, starts, members, centers, radii, slopes, distance_m, 1 / (_FADE * max(distance_m, 1e-6)))


@kernel(parallel=True)
@no_type_check
def _fill_slopes(portion, table, low, part, strength, slopes):
    for n in range_of(portion, len(low)):
        first, second, share, factor = table[low[n]], table[low[n] + 1], part[n], strength[n]
        for k in range(slopes.shape[1]):
            slopes[n, k] = ((np.float32(1) - share) * first[k] + share * second[k]) * factor


@kernel()
@no_type_check
def _count_reached(centers, radii, starts):
    rows, columns = starts.shape[:2]
    for n in range(len(radii)):
        x, y, r = centers[n, 0], centers[n, 1], radii[n]
        for row in range(max(int((y - r) / _HASH_M), 0), min(int((y + r) / _HASH_M), rows - 1) + 1):
            for column in range(max(int((x - r) / _HASH_M), 0), min(int((x + r) / _HASH_M), columns - 1) + 1):
                starts[row, column, 0] += 1


@kernel()
@no_type_check
def _list_reached(centers, radii, starts, members):
    rows, columns = starts.shape[:2]
    for n in range(len(radii)):
        x, y, r = centers[n, 0], centers[n, 1], radii[n]
        for row in range(max(int((y - r) / _HASH_M), 0), min(int((y + r) / _HASH_M), rows - 1) + 1):
            for column in range(max(int((x - r) / _HASH_M), 0), min(int((x + r) / _HASH_M), columns - 1) + 1):
                members[starts[row, column, 1]] = n
                starts[row, column, 1] += 1


_PER_CELL, _PER_RADIUS = np.float32(1 / _HASH_M), np.float32(1 / (RADII_M[1] - RADII_M[0]))
_EIGHTH = np.float32(0.5 / 8 * PEAK_PER_M**2)


@kernel(error_model="numpy")
@no_type_check
def ring_slope(x, y, along_x, along_y, along_m, across_m, corner, starts, members, centers, radii, slopes):
    """Slopes along and across (to the left of) a direction on the ground, blurred by a pixel's footprint.

    `along_m` and `across_m` are its standard deviations. The arguments after them are the fields of a `RingField`.
    """
    px, py = np.float32(x - corner[0]), np.float32(y - corner[1])
    x_cells, y_cells = px * _PER_CELL, py * _PER_CELL
    one = np.float32(1)
    along = across = np.float32(0)
    if not (0 <= x_cells < starts.shape[1] and 0 <= y_cells < starts.shape[0]):  # also NaN
        return along, across
    column, row = int(x_cells), int(y_cells)
    # (1 - t / 8)^8 stands for exp(-t)
    narrow, wide = _EIGHTH * across_m * across_m, _EIGHTH * along_m * along_m
    for k in range(starts[row, column, 0], starts[row, column, 1]):
        n = members[k]
        dx, dy = px - centers[n, 0], py - centers[n, 1]
        square = dx * dx + dy * dy
        if square >= radii[n] * radii[n] or square <= 0:
            continue
        u, v = dx * along_x + dy * along_y, dy * along_x - dx * along_y
        kept = one - (wide * u * u + narrow * v * v) / square
        if kept <= 0:
            continue
        r = np.sqrt(square)
        at = r * _PER_RADIUS
        j = int(at)
        slope = slopes[n, j] + (at - np.float32(j)) * (slopes[n, j + 1] - slopes[n, j])
        kept *= kept
        kept *= kept
        slope *= kept * kept / r
        along += slope * u
        across += slope * v
    return along, across
