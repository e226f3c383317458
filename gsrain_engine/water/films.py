"""Water films: depth of the water on the ground over time, filled by rain, drained and dried.

A road is a plane with dips. On the plane a film stores what rain brings until it drains as fast: h' = R - E - D(h).
D(h) inverts the depth in steady rain of Gallaway et al. (1979), which `wetness` has, too: h ~ R^0.59, the law of a
kinematic wave on a slope with Manning's friction (h ~ R^0.6). So films, colors and the mirror share one depth, and in
steady rain it is Gallaway's. Dips hold what falls into them and what runs in from their catchment, and run over when
full; only evaporation empties them. All of it is a function of the rain's keyframes and of time alone.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float64

from ..kernels import kernel
from ..rain.keyframes import KeyframeCurve, RainKeyframes
from ..rain.simulation import RainSimulation
from ..rain.wetness import DEPTH_EXPONENT, OVERCAST_FROM_MM_H, OVERCAST_MM_H, TEXTURE_DEPTH_MM, water_depth_mm
from ..scene.gaussians import IdentityKey, scene_cache
from ..scene.ground_water import GroundWater

EVAPORATION_MM_H = OVERCAST_FROM_MM_H
"""Evaporation under an open sky: rain up to that dries where it falls. Under rain clouds there is none."""
DIP_MM = 4.0
"""Mean depth of a full dip. Ruts of 5 mm and more count as worn; our choice."""
CATCHMENT = 3.0
"""Area of road whose water runs through a dip, relative to the dip's own; our choice."""
_STEP_S = 4.0
_PER_S = 1 / 3600


class WaterDepth(NamedTuple):
    """Depth of the water on the ground at one time."""

    film_mm: float
    """Mean depth on the road, from the bottom of its texture."""
    dip_mm: float
    """Mean depth of the water in dips, of at most `DIP_MM`."""

    @property
    def filled(self) -> float:
        """Share of the area of dips under water, 0..1: the root of the share of the volume, as in a paraboloid."""
        return float(np.sqrt(self.dip_mm / DIP_MM))


def evaporation_mm_h(intensity_mm_h: float) -> float:
    """Evaporation in mm/h in rain of an intensity: none from 0.5 mm/h on."""
    return float(_evaporation(intensity_mm_h))


def drainage_mm_h(film_mm: float) -> float:
    """Water in mm/h that a film of a depth loses by drainage: the steady rain in which it has that depth."""
    return (film_mm / water_depth_mm(1.0)) ** (1 / DEPTH_EXPONENT)


def flooded_share(depth_mm: float) -> float:
    """Share of a road's texture that water of a mean depth covers, so that it stands on it, 0..1.

    The share of places whose texture is less deep than the water, with a normal distribution of depths of mean MTD and
    standard deviation MTD / 2, our choice: 0.08 in steady rain of 1, 0.5 of 8.5, 0.9 of 20 mm/h.
    """
    above = (depth_mm - TEXTURE_DEPTH_MM) / (TEXTURE_DEPTH_MM / 2)
    return 0.5 * math.erfc(-above / math.sqrt(2)) if depth_mm > 0 else 0.0


@dataclass(frozen=True, eq=False)
class WaterFilms:
    """Depth of water on the ground as a function of time and place. World frame, meters; depths in mm.

    >>> films = WaterFilms.of(rainfall, scene.water)
    >>> films.depth_mm(points, time_s)  # under tires, for instance
    """

    intensity: KeyframeCurve
    """Rain rate in mm/h over time; it was constant, for as long as it takes, before the first knot."""
    ground: GroundWater | None = None
    """Map of the ground, whose standing water lies in dips; None is a plane without dips."""
    _latest: dict[float, WaterDepth] = field(default_factory=dict[float, WaterDepth], init=False)

    @classmethod
    def of(cls, rainfall: RainSimulation, ground: GroundWater | None = None) -> "WaterFilms":
        """Films of a rain with its keyframes; those of the last ones are cached."""
        return _films(IdentityKey(rainfall.weather), rainfall.rain.intensity_mm_h, IdentityKey(ground))

    def at(self, time_s: float) -> WaterDepth:
        """Depth of film and dips at a time; the latest one is cached."""
        latest = self._latest.get(time_s)
        if latest is None:
            knot = self.intensity.before(time_s)
            times, rates = self.intensity.times_s, self.intensity.values[:, 0]
            if knot < 0 or len(times) == 1:
                film, dip = self._at_knots[0]
            else:
                film, dip = self._at_knots[knot]
                rate, passed = float(self.intensity.at(time_s)[0]), time_s - float(times[knot])
                film, dip = _passed(film, dip, float(rates[knot]), rate, passed, self._run_in)
            latest = WaterDepth(float(film), float(dip))
            self._latest.clear()
            self._latest[time_s] = latest  # another thread may clear it at once
        return latest

    def depth_mm(self, points_m: Float64[np.ndarray, "n 2"], time_s: float) -> Float64[np.ndarray, " n"]:
        """Depth of the water in mm at points of the ground (x and y in the world) at a time, under an open sky.

        (1 - s) of the film's and s of the dips', s the share of standing water of the map; the film's outside of it.
        """
        now = self.at(time_s)
        if self.ground is None:
            return np.full(len(points_m), now.film_mm)
        standing = self.ground.at(points_m)[:, 1].astype(np.float64)
        return now.film_mm + standing * (now.dip_mm - now.film_mm)

    @cached_property
    def dip_share(self) -> float:
        """Share of the map's ground in dips."""
        return 0.0 if self.ground is None else float(self.ground.cover[..., 1].mean() / 255)

    @property
    def _run_in(self) -> float:
        """Area whose drainage runs into dips, relative to their own."""
        share = self.dip_share
        return min(CATCHMENT, (1 - share) / share) if share > 0 else 0.0

    @cached_property
    def _at_knots(self) -> Float64[np.ndarray, "n 2"]:
        times, rates = self.intensity.times_s, self.intensity.values[:, 0]
        net = float(rates[0]) - evaporation_mm_h(float(rates[0]))
        start = (water_depth_mm(net), DIP_MM) if net > 0 else (0.0, 0.0)
        return _integrate(*start, times, rates, self._run_in)


@scene_cache(maxsize=8)
def _films(weather: IdentityKey, steady_mm_h: float, ground: IdentityKey) -> WaterFilms:
    keyframes: RainKeyframes = weather.of  # pyright: ignore[reportAssignmentType]
    water: GroundWater | None = ground.of  # pyright: ignore[reportAssignmentType]
    curve = keyframes.curves.get("intensity_mm_h")
    return WaterFilms(curve or KeyframeCurve(np.zeros(1), np.array([[steady_mm_h]])), water)


# Integration: Strang's splitting into what falls and dries, and the exact drainage of a film

_OF_DEPTH, _ALL_DRIES, _NONE_DRIES = 1 / DEPTH_EXPONENT, OVERCAST_FROM_MM_H, OVERCAST_MM_H
_UNIT_MM = water_depth_mm(1.0)


@kernel(error_model="numpy")
@no_type_check
def _evaporation(rate):
    share = min(max((rate - _ALL_DRIES) / (_NONE_DRIES - _ALL_DRIES), 0.0), 1.0)
    return EVAPORATION_MM_H * (1 - share * share * (3 - 2 * share))


@kernel(error_model="numpy")
@no_type_check
def _passed(film, dip, start_rate, end_rate, seconds, run_in):
    """Depths after a time in which the rain rate changes linearly, in steps of `_STEP_S` and a rest."""
    rate = (end_rate - start_rate) / seconds if seconds > 0 else 0.0
    done = 0.0
    while done < seconds:
        step = min(_STEP_S, seconds - done)
        now = start_rate + rate * (done + 0.5 * step)
        gain = (now - _evaporation(now)) * step * _PER_S
        half = max(film + 0.5 * gain, 0.0)
        drained = 0.0
        if half > 1e-9:
            # h^(1 - p) rises linearly in time under h' = -(h / h_1)^p
            falling = (_OF_DEPTH - 1) * step * _PER_S * _UNIT_MM**-_OF_DEPTH
            left = (half ** (1 - _OF_DEPTH) + falling) ** (1 / (1 - _OF_DEPTH))
            drained = half - left
        film = max(half - drained + 0.5 * gain, 0.0)
        dip = min(max(dip + gain + run_in * drained, 0.0), DIP_MM)
        done += step
    return film, dip


@kernel(error_model="numpy")
@no_type_check
def _integrate(film, dip, times, rates, run_in):
    found = np.empty((len(times), 2))
    found[0] = film, dip
    for k in range(1, len(times)):
        film, dip = _passed(film, dip, rates[k - 1], rates[k], times[k] - times[k - 1], run_in)
        found[k] = film, dip
    return found
