"""Wetness: share of a scene's soaked colors, as a function of the rainfall intensity, and whether they are drawn."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import msgspec
import numpy as np
from jaxtyping import Float64

from ..scene.scene import Scene
from .keyframes import KeyframeCurve
from .settings import RainSettings

DRAINAGE_LENGTH_M = 5.0  # over the road: from the crown to the middle of the outer lane
CROSS_SLOPE = 0.02  # of a road, m/m; a common design value
TEXTURE_DEPTH_MM = 0.5  # mean, of dense asphalt

SOAKING_DEPTH_MM = 0.05
"""Mean depth of water at which a road has 1 - 1/e of its soaked look; our choice, see docs/physics/wetness.md."""

OVERCAST_FROM_MM_H, OVERCAST_MM_H = 0.3, 0.5
"""Intensity above which the sky closes, and from which it is closed. Below, rain dries where it falls."""

SOFTENED_ABOVE_MM_H = 2.5
"""Intensity above which the light of photographs is softened: that of moderate rain (American Meteorological Society,
Glossary of Meteorology). The sun may shine through a lighter one."""

DEPTH_EXPONENT = 0.59
"""Exponent of the rain rate in the depth of water on a road (Gallaway et al. 1979)."""
_THIRDS = 60


def water_depth_mm(intensity_mm_h: float) -> float:
    """Depth of the water on a road in steady rain, measured from the bottom of its texture.

    0.01485 MTD^0.11 L^0.43 R^0.59 / S^0.42 (Gallaway, Ivey, Hayes, Ledbetter, Olson, Woods and Schiller 1979, Federal
    Highway Administration report RD-79-31); they subtract MTD to measure from the texture's top.
    """
    road = TEXTURE_DEPTH_MM**0.11 * DRAINAGE_LENGTH_M**0.43 / CROSS_SLOPE**0.42
    return 0.01485 * road * intensity_mm_h**DEPTH_EXPONENT


def overcast(intensity_mm_h: float) -> float:
    """Share of the overcast sky in steady rain: 0 up to 0.3 mm/h, 1 from 0.5 mm/h on, and a smooth step between."""
    share = min(max((intensity_mm_h - OVERCAST_FROM_MM_H) / (OVERCAST_MM_H - OVERCAST_FROM_MM_H), 0.0), 1.0)
    return share * share * (3 - 2 * share)


def wetness(intensity_mm_h: float) -> float:
    """Share of soaked colors in steady rain: 0 up to 0.3 mm/h, rising towards 1.

    1 - exp(-h / SOAKING_DEPTH_MM), h the water's depth: the share of a surface covered by randomly placed patches of
    that depth, times `overcast`, as soaked colors are those under clouds. 0.94 at 1, 0.99 at 2.5 mm/h.
    """
    return -overcast(intensity_mm_h) * math.expm1(-water_depth_mm(intensity_mm_h) / SOAKING_DEPTH_MM)


@dataclass(frozen=True, eq=False)
class WetnessCurve:
    """Wetness under an intensity that changes over time, as a function of time alone.

    A surface gets wet at once and dries with a time constant: w(t) is the largest w(R(s)) exp(-(t - s) / drying) of all
    times s up to t.
    """

    intensity: KeyframeCurve
    drying_s: float
    """Time in which a wet surface dries to 1/e; 0 follows the intensity at once."""
    _latest: dict[float, float] = field(default_factory=dict[float, float], init=False)

    def at(self, time_s: float) -> float:
        """Wetness at a time, 0..1; the latest one is cached."""
        if (latest := self._latest.get(time_s)) is not None:
            return latest
        found = wetness(float(self.intensity.at(time_s)[0]))
        knot = self.intensity.before(time_s)
        if self.drying_s != 0 and knot >= 0:  # the rain was constant before the first keyframe
            times, values = self.intensity.times_s, self.intensity.values[:, 0]
            decayed = self._decayed_max[knot]
            if knot + 1 < len(times):
                share = (time_s - times[knot]) / (times[knot + 1] - times[knot])
                ends = np.array([values[knot], values[knot] + share * (values[knot + 1] - values[knot])])
                decayed = max(decayed, self._decayed_max_between(np.array([times[knot], time_s]), ends)[0])
            found = max(found, math.exp(decayed - time_s / self.drying_s))
        self._latest.clear()
        self._latest[time_s] = found
        return found

    @cached_property
    def _decayed_max(self) -> Float64[np.ndarray, " n"]:
        """Largest ln w(R(s)) + s / drying of all times up to each knot."""
        times, values = self.intensity.times_s, self.intensity.values[:, 0]
        first = _log_wetness(values[:1]) + times[:1] / self.drying_s
        return np.maximum.accumulate(np.concatenate([first, self._decayed_max_between(times, values)]))

    def _decayed_max_between(
        self, times_s: Float64[np.ndarray, " n"], intensities: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, " n-1"]:
        """Largest ln w(R(s)) + s / drying between each two knots, where the intensity is linear.

        If the intensity rises, it is at the end; if it falls, ln w + s / drying is concave in s: ternary search.
        """

        def log_decayed(share: Float64[np.ndarray, " m"]) -> Float64[np.ndarray, " m"]:
            there = intensities[:-1] + share * np.diff(intensities)
            return _log_wetness(there) + (times_s[:-1] + share * np.diff(times_s)) / self.drying_s

        low, high = np.zeros(len(times_s) - 1), np.ones(len(times_s) - 1)
        for _ in range(_THIRDS):
            third = (high - low) / 3
            is_later = log_decayed(low + third) < log_decayed(high - third)
            low, high = np.where(is_later, low + third, low), np.where(is_later, high, high - third)
        return np.maximum(log_decayed(0.5 * (low + high)), log_decayed(np.ones_like(low)))


def _log_wetness(intensities_mm_h: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    depths = water_depth_mm(1.0) * intensities_mm_h**DEPTH_EXPONENT
    closed = np.clip((intensities_mm_h - OVERCAST_FROM_MM_H) / (OVERCAST_MM_H - OVERCAST_FROM_MM_H), 0, 1)
    with np.errstate(divide="ignore"):  # ln 0 = -inf up to 0.3 mm/h
        return np.log(closed * closed * (3 - 2 * closed)) + np.log(-np.expm1(-depths / SOAKING_DEPTH_MM))


# Choice of `--wet/--no-wet`, for all commands and the window


def with_wet_choice(rain: RainSettings, wet: bool | None, heaviest_mm_h: float | None = None) -> RainSettings:
    """Return the rain with a choice of `--wet/--no-wet`.

    None follows the rain, where a scene has wet colors: overcast above 0.3 mm/h. False is as lit at any intensity. True
    follows the rain even if its preset is as lit, and is soaked where it never rains: `heaviest_mm_h` is that of its
    keyframes, by default its intensity.
    """
    if wet is False:
        return msgspec.structs.replace(rain, wetness=0.0)
    if not wet or rain.wetness not in (None, 0.0):
        return rain
    never_rains = (rain.intensity_mm_h if heaviest_mm_h is None else heaviest_mm_h) == 0
    return msgspec.structs.replace(rain, wetness=1.0 if never_rains else None)


def missing_wet_colors(scene: Scene, rain: RainSettings, heaviest_mm_h: float) -> str | None:
    """Return a line on how to get wet colors, if it rains on a scene that has none and is not to stay as lit."""
    if rain.wetness is not None or heaviest_mm_h <= OVERCAST_FROM_MM_H or scene.has_rainy_light:
        return None
    return f"{scene.name} is drawn dry, as it is lit: --wet gives it clouds and a wet road; --no-wet hides this line"
