"""Fog: extinction without drops, from the visibility, and the clouds that come with it."""

import math

CONTRAST_THRESHOLD = 0.05
"""Contrast of a black object before the horizon at the meteorological optical range (WMO-No. 8, chapter 9)."""

CLOUDY_BELOW_M, CLOSED_BELOW_M = 2000.0, 1000.0
"""Visibility below which fog hides part of the sky, and all of it; below 1 km it is fog by definition (WMO-No. 49)."""


def fog_extinction_per_m(visibility_m: float | None) -> float:
    """Extinction coefficient of fog, -ln(0.05) / V (Koschmieder 1924); 0 for None."""
    return 0.0 if visibility_m is None else -math.log(CONTRAST_THRESHOLD) / visibility_m


def fog_overcast(visibility_m: float | None) -> float:
    """Share of the overcast sky in fog: 0 from 2 km on, 1 below 1 km, and a smooth step between."""
    if visibility_m is None:
        return 0.0
    share = min(max((CLOUDY_BELOW_M - visibility_m) / (CLOUDY_BELOW_M - CLOSED_BELOW_M), 0.0), 1.0)
    return share * share * (3 - 2 * share)
