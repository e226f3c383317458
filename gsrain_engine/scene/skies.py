"""Skies by weather and time of day: their light on surfaces, how they look, and the exposure that fits them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Float64

from .geometry import linear_to_srgb
from .noise import layered_noise

# How skies look


def sky_display(
    directions: Float[np.ndarray, "n 3"], sun: Float64[np.ndarray, "3"], seed: int
) -> Float64[np.ndarray, "n 3"]:
    """Display color of the sky in unit directions: paler towards the horizon and the sun, with cumulus."""
    up = np.clip(directions[:, 2], 0, 1).astype(np.float64)
    zenith, horizon = np.array([0.24, 0.44, 0.74]), np.array([0.80, 0.87, 0.93])
    part = (1 - up) ** 3.2
    color = zenith + (horizon - zenith) * part[:, None]
    glow = np.clip(directions @ sun, 0, 1) ** 6
    color = color + 0.16 * glow[:, None] * np.array([1.0, 0.93, 0.78])
    # Clouds are noise on a flat layer above, so that they flatten towards the horizon.
    flat = directions[:, :2].astype(np.float64) / (up + 0.22)[:, None]
    billow = layered_noise(flat, 0.75, seed + 101, 5)
    cover = np.clip((billow - 0.50) / 0.17, 0, 1)
    cover = cover * cover * (3 - 2 * cover) * np.clip((up - 0.01) / 0.10, 0, 1)
    body = np.clip((billow - 0.55) / 0.25, 0, 1)
    white = np.array([0.965, 0.97, 0.975]) - body[:, None] * np.array([0.13, 0.11, 0.085])
    return np.clip(color + (white - color) * 0.88 * cover[:, None], 0, 1)


def night_sky_display(
    directions: Float[np.ndarray, "n 3"], sun: Float64[np.ndarray, "3"], seed: int
) -> Float64[np.ndarray, "n 3"]:
    """Display color of a city's cloudy night sky in unit directions: dark, with a warm glow above the roofs."""
    up = np.clip(directions[:, 2], 0, 1).astype(np.float64)
    flat = directions[:, :2].astype(np.float64) / (up + 0.16)[:, None]
    folds = layered_noise(flat, (1.5, 0.9), seed + 151, 4) - 0.5
    glow = np.exp(-up / 0.22)[:, None] * _CITY_GLOW
    light = (_NIGHT_ZENITH + glow) * (1 + 0.9 * folds * np.clip(0.25 + 3 * up, 0, 1))[:, None]
    return linear_to_srgb(light)


_NIGHT_ZENITH, _CITY_GLOW = np.array([0.0040, 0.0056, 0.0092]), np.array([0.0105, 0.0085, 0.0075])


def dusk_sky_display(
    directions: Float[np.ndarray, "n 3"], sun: Float64[np.ndarray, "3"], seed: int
) -> Float64[np.ndarray, "n 3"]:
    """Display color of rain clouds after sunset in unit directions: blue, with a warm band where the street ends."""
    up = np.clip(directions[:, 2], 0, 1).astype(np.float64)
    flat = directions[:, :2].astype(np.float64) / (up + 0.16)[:, None]
    folds = layered_noise(flat, (1.6, 0.8), seed + 171, 5) - 0.5
    ahead = np.clip(0.5 + 0.5 * directions[:, 0].astype(np.float64), 0, 1) ** 3
    band = (np.exp(-up / 0.16) * (0.05 + ahead))[:, None] * _DUSK_BAND
    pale = np.exp(-up / 0.5)[:, None] * _DUSK_HORIZON
    light = (_DUSK_ZENITH + pale) * (1 + 1.5 * folds * np.clip(0.25 + 3 * up, 0, 1))[:, None]
    return linear_to_srgb(np.maximum(light + band * (1 + 1.4 * folds)[:, None], 0))


_DUSK_ZENITH, _DUSK_HORIZON = np.array([0.030, 0.044, 0.080]), np.array([0.042, 0.055, 0.084])
_DUSK_BAND = np.array([0.150, 0.080, 0.042])


def overcast_luminance(rise: Float[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
    """Luminance of CIE's overcast sky relative to the zenith's, (1 + 2 sin e)/3 (Moon and Spencer 1942).

    `rise` is the sine of the elevation e; below the horizon it is the horizon's.
    """
    return (1 + 2 * np.clip(rise, 0, 1).astype(np.float64)) / 3


OVERCAST_ZENITH = 2.0
"""Luminance of the overcast sky's zenith, relative to a camera's white: the camera is exposed for the street."""
_CLOUD_GRAY = np.array([0.965, 1.0, 1.035])


def overcast_sky_display(
    directions: Float[np.ndarray, "n 3"], sun: Float64[np.ndarray, "3"], seed: int
) -> Float64[np.ndarray, "n 3"]:
    """Display color of a closed cloud deck in unit directions: gray, brighter above, with soft folds; no sun."""
    up = np.clip(directions[:, 2], 0, 1).astype(np.float64)
    flat = directions[:, :2].astype(np.float64) / (up + 0.16)[:, None]
    folds = layered_noise(flat, (1.5, 0.9), seed + 131, 4) - 0.5
    light = OVERCAST_ZENITH * overcast_luminance(up) * (1 + 0.85 * folds * np.clip(0.25 + 3 * up, 0, 1))
    return linear_to_srgb(1 - np.exp(-light[:, None] * _CLOUD_GRAY))


# Light

Sky = Callable[[Float[np.ndarray, "n 3"], Float64[np.ndarray, "3"], int], Float64[np.ndarray, "n 3"]]
"""Display color of the sky in unit directions, for a direction towards the sun and a seed."""
LightingName = Literal["sunny", "overcast", "dusk", "night"]
TimeOfDay = Literal["day", "overcast", "dusk", "night"]
"""Overcast is by day."""


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """Light of one weather or time of day. Colors of light are linear, relative to a camera's white."""

    sun: Float64[np.ndarray, "3"]
    """Sunlight on a surface that faces it; zero without a sun."""
    sky: Float64[np.ndarray, "3"]
    """Light of the whole sky on level ground in the open."""
    ground: Float64[np.ndarray, "3"]
    """Light of the ground on a surface that faces down."""
    exposure: float
    sky_display: Sky
    diffuse: Literal["uniform", "overcast"]
    """Brightness of the sky by elevation: uniform, or as of CIE's overcast sky, with houses that occlude it."""
    haze: Float64[np.ndarray, "3"]
    """Display color of surfaces at infinity, without rain."""
    mirrored: Float64[np.ndarray, "3"]
    """Display color of a mirror that reflects the horizon."""
    mirrored_up: Float64[np.ndarray, "3"]
    """Added for a reflection of the zenith, subtracted for one of the road."""
    mirrored_sun: Float64[np.ndarray, "3"]
    """Added for a reflection towards the sun."""
    lamps: bool = False
    """True if lamps and lit rooms light the street."""
    reflected_sky: Float64[np.ndarray, "3"] | None = None
    """With lamps: light of the sky that wet ground reflects."""
    reflected_dim: Float64[np.ndarray, "3"] | None = None
    """With lamps: light of leaves and vehicles in reflections, relative to that under clouds."""

    def display(self, light: Float[np.ndarray, "*n"], albedo: Any = 1.0) -> Float[np.ndarray, "*n"]:
        """Display color of surfaces in a light: highlights are compressed as by film."""
        return linear_to_srgb(1 - np.exp(-self.exposure * light * albedo))


SUNNY = Lighting(
    sun=np.array([3.05, 2.72, 2.18]),
    sky=np.array([0.50, 0.62, 0.82]),
    ground=np.array([0.30, 0.27, 0.22]),
    exposure=1.18,
    sky_display=sky_display,
    diffuse="uniform",
    haze=np.array([0.70, 0.78, 0.86]),
    mirrored=np.array([0.36, 0.40, 0.45]),
    mirrored_up=np.array([0.30, 0.37, 0.48]),
    mirrored_sun=np.array([0.16, 0.15, 0.12]),
)

CLOUD = np.array([0.955, 1.0, 1.045])
"""Color of light under thick clouds relative to gray; cameras balance most of it."""
OVERCAST = Lighting(
    sun=np.zeros(3),
    sky=7 / 9 * OVERCAST_ZENITH * CLOUD,  # of (1 + 2 sin e)/3 on level ground, over pi
    ground=0.10 * OVERCAST_ZENITH * np.array([1.0, 0.99, 0.97]),
    exposure=1.0,
    sky_display=overcast_sky_display,
    diffuse="overcast",
    haze=np.array([0.70, 0.715, 0.73]),
    mirrored=np.array([0.34, 0.355, 0.37]),
    mirrored_up=np.array([0.44, 0.455, 0.47]),
    mirrored_sun=np.zeros(3),
)

NIGHT = Lighting(
    sun=np.zeros(3),
    sky=np.array([0.0075, 0.0095, 0.0140]),
    ground=np.array([0.010, 0.0075, 0.0050]),
    exposure=1.0,
    sky_display=night_sky_display,
    diffuse="overcast",
    haze=np.array([0.075, 0.080, 0.095]),
    mirrored=np.array([0.060, 0.054, 0.050]),
    mirrored_up=np.array([0.010, 0.018, 0.030]),
    mirrored_sun=np.zeros(3),
    lamps=True,
    reflected_sky=np.array([0.006, 0.0062, 0.0078]),
    reflected_dim=np.array([0.16, 0.115, 0.07]),
)

DUSK = Lighting(
    sun=np.zeros(3),
    sky=np.array([0.115, 0.135, 0.190]),
    ground=np.array([0.022, 0.020, 0.021]),
    exposure=1.0,
    sky_display=dusk_sky_display,
    diffuse="overcast",
    haze=np.array([0.235, 0.245, 0.285]),
    mirrored=np.array([0.135, 0.135, 0.150]),
    mirrored_up=np.array([0.045, 0.060, 0.090]),
    mirrored_sun=np.zeros(3),
    lamps=True,
    reflected_sky=np.array([0.060, 0.070, 0.098]),
    reflected_dim=np.array([0.20, 0.175, 0.155]),
)
"""Clouds half an hour after sunset: blue from above, with a warm band ahead, about as bright as the lanterns' light."""

LIGHTINGS: dict[LightingName, Lighting] = {"sunny": SUNNY, "overcast": OVERCAST, "dusk": DUSK, "night": NIGHT}


# Overcast sky


def overcast_share(tilt: Float[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Light of CIE's overcast sky on a surface relative to level ground, by the upward component of its normal.

    Luminance (1 + 2 sin e)/3 of the zenith's at the elevation e (Moon and Spencer 1942; ISO 15469): 1 upwards, 0.396
    on a wall, 0 downwards.
    """
    tilts, shares = _overcast_table()
    return np.interp(tilt, tilts, shares)


@lru_cache(maxsize=1)
def _overcast_table() -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
    rise = (np.arange(200) + 0.5) / 200  # equal solid angles: even in sin e
    turn = (np.arange(360) + 0.5) * np.pi / 180
    across = np.sqrt(1 - rise**2)[:, None] * np.cos(turn)
    tilts = np.linspace(-1, 1, 65)
    cosines = (np.sqrt(1 - t * t) * across + t * rise[:, None] for t in tilts)
    light = np.array([np.sum(overcast_luminance(rise)[:, None] * np.maximum(c, 0)) for c in cosines])
    return tilts, light / light[-1]
