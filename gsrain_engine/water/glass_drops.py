"""Drops on a pane: they land, merge, creep, run off, are blown by the air and wiped.

Every impact is a function of (seed, tick, number), so that replaying the same past gives the same drops.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import no_type_check

import numpy as np
from jaxtyping import Float32, Float64

from ..kernels import kernel
from ..rain.pcg_hash import pcg4d_scalar
from ..rain.properties import CLASSES
from .pane import Pane
from .wiper import INNER_M, OUTER_M, PIVOT_M

TICK_S = 0.01
WATER_N_M, WATER_KG_M3, WATER_PA_S = 0.0728, 998.0, 1.0e-3
"""Surface tension, density and viscosity of water at 20 degrees Celsius."""

HYSTERESIS_DEG = 15.0
"""Advancing and receding contact angle lie so far above and below the mean one: a clean windshield's; ours."""

GRAVITY_M_S2, _AIR_KG_M3 = 9.81, 1.2
_NEAR_WALL = 0.6  # speed of the air at a drop's height relative to that outside of the boundary layer; ours
_FILM_M = 0.002  # cells of the film
_FILM_DRIES_S = 0.9
_STREAKS_M = 6e-6  # greatest depth of the film behind a blade; ours
_MAX_SPEED_M_S = 0.6
_CELL_M = 0.004  # of the grid in which neighbors are found
_LARGEST_M = 0.009  # footprint radius of the largest drop that neighbors are sought for
U, V, VOLUME, RADIUS, SPEED, TO_U, TO_V, TRAIL, TRAVEL, SHAPE = range(10)
"""Columns of `GlassDrops.drops`: center (m), volume (m^3; 0 where there is none), footprint radius (m), speed (m/s),
its direction, volume for the next bead of the trail, path since the last one, a number for the outline, 0..1."""

LANDED, LEFT, IMPACTS = range(3)  # of `GlassDrops.totals`: m^3, m^3, number


@dataclass(frozen=True, eq=False)
class Impacts:
    """Drops that land on a pane per second, by class."""

    shift_m_s: float
    """Speed along the inward normal that all classes share, from wind and camera."""
    density_m3: float
    """Of one class."""
    normal_fall_m_s: Float64[np.ndarray, " classes"]
    """Speed along the inward normal by falling, of each class."""
    volumes_m3: Float64[np.ndarray, " classes"]
    area_m2: float

    @cached_property
    def sums(self) -> Float64[np.ndarray, " sums"]:
        """Impacts per second of all classes below each."""
        rates = self.density_m3 * self.area_m2 * np.maximum(self.shift_m_s + self.normal_fall_m_s, 0.0)
        return np.concatenate([np.zeros(1), np.cumsum(rates)])

    @property
    def rate_s(self) -> float:
        """Expected impacts per second: the integral of the flux over the pane."""
        return float(self.sums[-1])

    @cached_property
    def water_m_s(self) -> float:
        """Depth of water that lands per second."""
        return float(np.sum(np.diff(self.sums) * self.volumes_m3)) / self.area_m2


def impacts_on(
    pane: Pane,
    camera_to_world: Float64[np.ndarray, "3 3"],
    velocity_m_s: Float64[np.ndarray, "3"],
    wind_m_s: tuple[float, float],
    density_m3: float,
    diameters_mm: Float64[np.ndarray, " classes"],
    fall_speed_m_s: Float64[np.ndarray, " classes"],
) -> Impacts:
    """Impacts on a moving pane: flux N (v_pane - v_drop) n A of each class, with n outward; none from behind."""
    normal = camera_to_world @ pane.normal
    shift = float((np.asarray(velocity_m_s) - np.array([*wind_m_s, 0.0])) @ normal)
    diameters_m = 1e-3 * diameters_mm
    volumes = np.pi / 6 * (diameters_m * diameters_m * diameters_m)  # a power takes 20 times as long
    return Impacts(shift, density_m3 / CLASSES, fall_speed_m_s * float(normal[2]), volumes, pane.area_m2)


@dataclass(frozen=True, slots=True)
class Wetting:
    """Spherical caps of water with a contact angle, and the force that holds them."""

    contact_angle_deg: float

    @property
    def volume_factor(self) -> float:
        """Volume over the cube of the footprint's radius."""
        a = np.radians(self.contact_angle_deg)
        return float(np.pi * (2 - 3 * np.cos(a) + np.cos(a) ** 3) / (3 * np.sin(a) ** 3))

    @property
    def frontal_factor(self) -> float:
        """Area of the profile over the square of the footprint's radius."""
        a = np.radians(self.contact_angle_deg)
        return float((a - np.sin(a) * np.cos(a)) / np.sin(a) ** 2)

    @property
    def holding_n_m(self) -> float:
        """Greatest holding force over the radius: 2 gamma (cos receding - cos advancing) (Furmidge 1962)."""
        low, high = (np.radians(max(self.contact_angle_deg + s * HYSTERESIS_DEG, 1.0)) for s in (-1, 1))
        return float(2 * WATER_N_M * (np.cos(low) - np.cos(high)))

    @property
    def friction_pa_s(self) -> float:
        """Viscous force over speed and radius: 6 mu ln(L / l) / angle on each side, L / l = 6e4 (de Gennes 1985)."""
        return float(2 * 6 * WATER_PA_S * 11 / np.radians(self.contact_angle_deg))

    @property
    def numbers(self) -> Float64[np.ndarray, "4"]:
        return np.array([self.volume_factor, self.frontal_factor, self.holding_n_m, self.friction_pa_s])


class GlassDrops:
    """Water on a pane: drops and a film, advanced tick by tick."""

    def __init__(self, pane: Pane, wetting: Wetting, seed: int) -> None:
        self.pane = pane
        self._wetting, self._seed = wetting, seed
        width, height = pane.size_m
        self.drops: Float64[np.ndarray, "n 10"] = np.zeros((4096, 10))
        self.film_m: Float32[np.ndarray, "rows columns"] = np.zeros(
            (int(np.ceil(height / _FILM_M)) + 1, int(np.ceil(width / _FILM_M)) + 1), np.float32
        )
        """Depth of the film at points of a grid of `film_cell_m` from the lower left corner of the pane."""
        self.totals = np.zeros(3)
        self._links = np.zeros(4096, np.int64)
        cells = int(np.ceil(height / _CELL_M)), int(np.ceil(width / _CELL_M))
        self._heads = np.full(cells, -1, np.int64)
        self._free = np.arange(4096)[::-1].copy()  # slots; the number of them is in `_counts`
        self._counts = np.array([4096, 0, 0, 0, 0])
        """Free slots, end of those in use, 1 if there may be a film, radius in um that no drop exceeds, and that which
        none exceeded since the last look at all."""
        self._on_blade = np.zeros(1)

    film_cell_m = _FILM_M

    @property
    def landed_m3(self) -> float:
        """Water that has landed."""
        return float(self.totals[LANDED])

    @property
    def left_m3(self) -> float:
        """Water that has run off, was wiped off or has dried."""
        return float(self.totals[LEFT])

    @property
    def stored_m3(self) -> float:
        """Water in drops, film and before the blade."""
        film = float(self.film_m.sum(dtype=np.float64)) * _FILM_M**2
        return float(self.drops[:, VOLUME].sum()) + film + float(self._on_blade[0])

    @property
    def impacts(self) -> int:
        return int(self.totals[IMPACTS])

    def present(self) -> Float64[np.ndarray, "n 10"]:
        """Rows of the drops that exist."""
        drops = self.drops[: self._counts[1]]
        return drops[drops[:, VOLUME] > 0]

    def place(self, u_m: float, v_m: float, volume_m3: float) -> None:
        """Put a drop on the glass; it merges with those that it touches."""
        self._make_room(1)
        self.totals[LANDED] += volume_m3
        low = np.array(self.pane.low_m)
        _add(
            self.drops, self._heads, self._links, self._free, self._counts, low, self._wetting.volume_factor,
            u_m, v_m, volume_m3, 0.5,
        )  # fmt: skip

    def add_film(self, depth_m: float) -> None:
        """Spread a depth of water over the whole pane: fine spray, whose drops are too many to follow."""
        self.film_m += np.float32(depth_m)
        self._counts[2] = 1
        self.totals[LANDED] += float(np.float32(depth_m)) * self.film_m.size * _FILM_M**2

    def advance(
        self,
        tick: int,
        impacts: Impacts,
        gravity_m_s2: Float64[np.ndarray, "2"],
        air_m_s: Float64[np.ndarray, "2"],
        blade_rad: Float64[np.ndarray, "ticks 2"],
    ) -> None:
        """Advance by one tick for each row of `blade_rad`, the blade's angles before and after it.

        Gravity and the air's velocity relative to the pane are those along its axes.
        """
        self._make_room(int(2 * impacts.rate_s * TICK_S * len(blade_rad)) + 256)
        low, high = np.array(self.pane.low_m), np.array(self.pane.high_m)
        factor = 0.5 * _AIR_KG_M3 * _NEAR_WALL**2 * float(np.hypot(air_m_s[0], air_m_s[1]))
        _advance(
            self.drops, self._heads, self._links, self._free, self._counts, self.film_m, self.totals, self._on_blade,
            low, high, self._wetting.numbers, np.uint32(self._seed), tick, impacts.sums, impacts.volumes_m3,
            np.asarray(gravity_m_s2) * WATER_KG_M3, factor * np.asarray(air_m_s), blade_rad,
        )  # fmt: skip

    def _make_room(self, count: int) -> None:
        """Enlarge the arrays until so many slots are free."""
        while self._counts[0] < count:
            size = len(self.drops)
            self.drops = np.concatenate([self.drops, np.zeros((size, 10))])
            self._links = np.concatenate([self._links, np.zeros(size, np.int64)])
            free = np.zeros(2 * size, np.int64)
            free[:size] = np.arange(size, 2 * size)[::-1]  # the new ones are used last
            free[size : size + self._counts[0]] = self._free[: self._counts[0]]
            self._free = free
            self._counts[0] += size


# Kernels. Slots are linked cell by cell.

_UNIT = 2.0**-32


@kernel()
@no_type_check
def _cell(heads, low, u, v):
    row = min(max(int((v - low[1]) / _CELL_M), 0), heads.shape[0] - 1)
    return row, min(max(int((u - low[0]) / _CELL_M), 0), heads.shape[1] - 1)


@kernel()
@no_type_check
def _link(drops, heads, links, low, slot):
    row, column = _cell(heads, low, drops[slot, U], drops[slot, V])
    links[slot] = heads[row, column]
    heads[row, column] = slot


@kernel()
@no_type_check
def _unlink(drops, heads, links, low, slot):
    row, column = _cell(heads, low, drops[slot, U], drops[slot, V])
    at = heads[row, column]
    if at == slot:
        heads[row, column] = links[slot]
        return
    while links[at] != slot:
        at = links[at]
    links[at] = links[slot]


@kernel()
@no_type_check
def _remove(drops, heads, links, free, counts, low, slot):
    _unlink(drops, heads, links, low, slot)
    drops[slot, VOLUME] = 0.0
    free[counts[0]] = slot
    counts[0] += 1


@kernel()
@no_type_check
def _bound(counts, radius):
    """Enlarge the radius that none exceeds, if this one does."""
    bound = np.int64(1e6 * radius) + 1
    counts[3], counts[4] = max(counts[3], bound), max(counts[4], bound)


@kernel()
@no_type_check
def _touching(drops, heads, links, counts, low, u, v, radius, own):
    """Slot of the drop that overlaps a footprint most; -1 for none."""
    reach = radius + min(1e-6 * counts[3], _LARGEST_M)
    top, left = _cell(heads, low, u - reach, v - reach)
    bottom, right = _cell(heads, low, u + reach, v + reach)
    found, deepest = -1, 0.0
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            slot = heads[row, column]
            while slot >= 0:
                du, dv = drops[slot, U] - u, drops[slot, V] - v
                both = radius + drops[slot, RADIUS]
                square = du * du + dv * dv
                if slot != own and square < both * both:
                    overlap = both - np.sqrt(square)
                    if overlap > deepest:
                        found, deepest = slot, overlap
                slot = links[slot]
    return found


@kernel()
@no_type_check
def _merge_all(drops, heads, links, free, counts, low, factor, slot):
    """Merge a drop with all that it touches; returns the slot of what is left."""
    while True:
        other = _touching(drops, heads, links, counts, low, drops[slot, U], drops[slot, V], drops[slot, RADIUS], slot)
        if other < 0:
            return slot
        if drops[other, VOLUME] > drops[slot, VOLUME]:
            slot, other = other, slot
        total = drops[slot, VOLUME] + drops[other, VOLUME]
        share = drops[other, VOLUME] / total
        u = drops[slot, U] + share * (drops[other, U] - drops[slot, U])
        v = drops[slot, V] + share * (drops[other, V] - drops[slot, V])
        trail = drops[slot, TRAIL] + drops[other, TRAIL]
        _remove(drops, heads, links, free, counts, low, other)
        _unlink(drops, heads, links, low, slot)
        drops[slot, U], drops[slot, V], drops[slot, VOLUME] = u, v, total
        drops[slot, RADIUS] = (total / factor) ** (1.0 / 3.0)
        _bound(counts, drops[slot, RADIUS])
        drops[slot, SPEED] *= 1 - share
        drops[slot, TRAIL] = trail
        _link(drops, heads, links, low, slot)


@kernel()
@no_type_check
def _add(drops, heads, links, free, counts, low, factor, u, v, volume, shape):
    """Put a drop into a free slot, and merge it with those that it touches."""
    counts[0] -= 1
    slot = free[counts[0]]
    counts[1] = max(counts[1], slot + 1)
    drops[slot, :] = 0.0
    drops[slot, U], drops[slot, V], drops[slot, VOLUME], drops[slot, SHAPE] = u, v, volume, shape
    drops[slot, RADIUS] = (volume / factor) ** (1.0 / 3.0)
    _bound(counts, drops[slot, RADIUS])
    _link(drops, heads, links, low, slot)
    return _merge_all(drops, heads, links, free, counts, low, factor, slot)


@kernel()
@no_type_check
def _poisson(mean, seed, tick):
    """Number drawn from Poisson's law, in parts of a mean of at most 16, by inversion."""
    number, part = 0, 0
    while mean > 0:
        piece = min(mean, 16.0)
        mean -= piece
        drawn, _, _, _ = pcg4d_scalar(np.uint32(tick), np.uint32(part), np.uint32(0x9E3779B9), seed)
        below, probability = (drawn + 0.5) * _UNIT, np.exp(-piece)
        total, k = probability, 0
        while below > total and k < 200:
            k += 1
            probability *= piece / k
            total += probability
        number += k
        part += 1
    return number


@kernel()
@no_type_check
def _advance(
    drops, heads, links, free, counts, film, totals, on_blade, low, high, wetting, seed, tick, sums, volumes, weight,
    drag, blade,
):  # fmt: skip
    for step in range(len(blade)):
        _land(drops, heads, links, free, counts, totals, low, high, wetting[0], seed, tick + step, sums, volumes)
        if blade[step, 0] != blade[step, 1]:
            _wipe(drops, heads, links, free, counts, film, totals, on_blade, low, blade[step], seed)
        else:
            totals[LEFT] += on_blade[0]
            on_blade[0] = 0.0
        _run(drops, heads, links, free, counts, totals, low, high, wetting, seed, weight, drag)
        _dry(film, totals, counts)


@kernel()
@no_type_check
def _land(drops, heads, links, free, counts, totals, low, high, factor, seed, tick, sums, volumes):
    """Let the drops of a tick land: class and place of each by its number."""
    number = _poisson(sums[-1] * TICK_S, seed, tick)
    for k in range(number):
        if counts[0] < 64:  # the arrays are enlarged between ticks
            break
        a, b, c, d = pcg4d_scalar(np.uint32(tick), np.uint32(k), np.uint32(0x85EBCA6B), seed)
        at = np.searchsorted(sums, (a + 0.5) * _UNIT * sums[-1], side="right") - 1
        volume = volumes[min(max(at, 0), len(volumes) - 1)]
        u = low[0] + (b + 0.5) * _UNIT * (high[0] - low[0])
        v = low[1] + (c + 0.5) * _UNIT * (high[1] - low[1])
        totals[LANDED] += volume
        totals[IMPACTS] += 1
        _add(drops, heads, links, free, counts, low, factor, u, v, volume, d * _UNIT)


@kernel()
@no_type_check
def _run(drops, heads, links, free, counts, totals, low, high, wetting, seed, weight, drag):
    """Move drops for which weight and drag of the air exceed the force of contact angle hysteresis."""
    factor, frontal, holding, friction = wetting
    heavy, blown = np.hypot(weight[0], weight[1]), np.hypot(drag[0], drag[1])
    counts[4] = 0
    largest = 0.0
    for slot in range(counts[1]):
        radius = drops[slot, RADIUS]
        if drops[slot, VOLUME] <= 0:
            continue
        largest = max(largest, radius)
        if heavy * factor * radius**2 + blown * frontal * radius < 0.3 * holding:
            drops[slot, SPEED] = 0.0
            continue
        volume = drops[slot, VOLUME]
        force_u = weight[0] * volume + drag[0] * frontal * radius**2
        force_v = weight[1] * volume + drag[1] * frontal * radius**2
        force = np.hypot(force_u, force_v)
        # Glass is not clean everywhere: the force that holds differs from place to place.
        across, along = np.int64(np.floor(drops[slot, U] / 0.004)), np.int64(np.floor(drops[slot, V] / 0.004))
        a, b, c, d = pcg4d_scalar(np.uint32(across), np.uint32(along), np.uint32(0xC2B2AE35), seed)
        held = holding * radius * (0.6 + 0.8 * a * _UNIT)
        if drops[slot, SPEED] > 0:
            held *= 0.6
        if force <= held:
            drops[slot, SPEED] = 0.0
            continue
        speed = min((force - held) / (friction * radius), _MAX_SPEED_M_S)
        turn = 0.9 * (b * _UNIT - 0.5)
        to_u = (force_u * np.cos(turn) - force_v * np.sin(turn)) / force
        to_v = (force_u * np.sin(turn) + force_v * np.cos(turn)) / force
        if drops[slot, SPEED] > 0:
            to_u, to_v = 0.8 * drops[slot, TO_U] + 0.2 * to_u, 0.8 * drops[slot, TO_V] + 0.2 * to_v
            norm = np.hypot(to_u, to_v)
            to_u, to_v = to_u / norm, to_v / norm
        path = speed * TICK_S
        _unlink(drops, heads, links, low, slot)
        u, v = drops[slot, U] + path * to_u, drops[slot, V] + path * to_v
        drops[slot, U], drops[slot, V], drops[slot, SPEED] = u, v, speed
        drops[slot, TO_U], drops[slot, TO_V] = to_u, to_v
        _link(drops, heads, links, low, slot)
        if u < low[0] - radius or u > high[0] + radius or v < low[1] - radius or v > high[1] + radius:
            totals[LEFT] += volume
            _remove(drops, heads, links, free, counts, low, slot)
            continue
        # A film of depth r Ca^(2/3) stays behind (Landau and Levich 1942), and breaks up into beads; a third, ours.
        lost = radius * (WATER_PA_S * speed / WATER_N_M) ** (2.0 / 3.0) / 3 * 2 * radius * path
        drops[slot, TRAIL] = min(drops[slot, TRAIL] + lost, 0.5 * volume)
        drops[slot, TRAVEL] += path
        bead = drops[slot, TRAIL]
        behind = radius + 1.2 * (bead / factor) ** (1.0 / 3.0) + 3e-4
        if drops[slot, TRAVEL] > behind + (0.5 + 2.0 * c * _UNIT) * radius and bead > 1e-11 and counts[0] > 64:
            drops[slot, TRAIL] = drops[slot, TRAVEL] = 0.0
            drops[slot, VOLUME] = volume - bead
            drops[slot, RADIUS] = ((volume - bead) / factor) ** (1.0 / 3.0)
            back_u, back_v = u - behind * to_u, v - behind * to_v
            _add(drops, heads, links, free, counts, low, factor, back_u, back_v, bead, d * _UNIT)
        if drops[slot, VOLUME] > 0:
            _merge_all(drops, heads, links, free, counts, low, factor, slot)
    _bound(counts, largest)
    counts[3] = counts[4]


@kernel()
@no_type_check
def _wipe(drops, heads, links, free, counts, film, totals, on_blade, low, angles, seed):
    """Take up what the blade passes, and leave a film in streaks where its rubber is worn."""
    first, last = min(angles[0], angles[1]), max(angles[0], angles[1])
    for slot in range(counts[1]):
        if drops[slot, VOLUME] > 0:
            x, y = drops[slot, U] - PIVOT_M[0], drops[slot, V] - PIVOT_M[1]
            distance = np.hypot(x, y)
            if INNER_M <= distance <= OUTER_M:
                angle = np.arctan2(y, x)
                slack = drops[slot, RADIUS] / distance
                if first - slack <= angle <= last + slack:
                    on_blade[0] += drops[slot, VOLUME]
                    _remove(drops, heads, links, free, counts, low, slot)
    area = _FILM_M * _FILM_M
    first_sine, first_cosine, last_sine, last_cosine = np.sin(first), np.cos(first), np.sin(last), np.cos(last)
    counts[2] = 1
    for row in range(film.shape[0]):
        y = low[1] + row * _FILM_M - PIVOT_M[1]
        for column in range(film.shape[1]):
            x = low[0] + column * _FILM_M - PIVOT_M[0]
            # Faster than arctan2 for the many cells that the blade is far from.
            if (x * first_sine - y * first_cosine) > 0 or (x * last_sine - y * last_cosine) < 0:
                continue
            distance = np.hypot(x, y)
            if not INNER_M <= distance <= OUTER_M:
                continue
            band, fine = np.int64(distance / 0.008), np.int64(distance / 0.0021)
            a, _, _, _ = pcg4d_scalar(np.uint32(band), np.uint32(0), np.uint32(0x27D4EB2F), seed)
            c, _, _, _ = pcg4d_scalar(np.uint32(fine), np.uint32(1), np.uint32(0x27D4EB2F), seed)
            worn = max(a * _UNIT - 0.55, 0.0) / 0.45
            depth = _STREAKS_M * (0.06 + 0.94 * worn * (0.3 + 0.7 * c * _UNIT))
            on_blade[0] += np.float64(film[row, column]) * area
            left = np.float32(min(depth, 0.5 * on_blade[0] / area))
            film[row, column] = left
            on_blade[0] -= np.float64(left) * area


@kernel()
@no_type_check
def _dry(film, totals, counts):
    """Let the film dry."""
    if counts[2] == 0:
        return
    keeps = np.float32(np.exp(-TICK_S / _FILM_DRIES_S))
    lost, is_wet = 0.0, 0
    for row in range(film.shape[0]):
        for column in range(film.shape[1]):
            depth = film[row, column]
            if depth > 0:
                is_wet = 1
                film[row, column] = keeps * depth if depth > np.float32(1e-9) else np.float32(0)
                lost += np.float64(depth) - np.float64(film[row, column])
    totals[LEFT] += lost * _FILM_M * _FILM_M
    counts[2] = is_wet
