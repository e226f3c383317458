"""How surfaces look with water in and on them: darker and more colourful where they are porous."""

import numpy as np
from jaxtyping import Float32

from .light import LUMINANCE
from .noise import SmoothNoise
from .settings import WetSettings
from .smoothstep import smoothstep
from .surfaces import Surfaces

Image = Float32[np.ndarray, "h w 3"]
Plane = Float32[np.ndarray, "h w"]

WATER_REFLECTANCE = 0.02
"""Of water at normal incidence (refractive index 1.33)."""
INTERNAL_REFLECTION = 0.55
"""Share of diffuse light that water's surface throws back down: 1 - (1 - 0.07) / 1.33^2, rounded up."""
WHITE = 0.9
"""Albedo of what the picture shows as white."""

SOAKING_OF_GROUND, SOAKING_OF_PLANTS, SOAKING_OF_WALLS, SOAKING_OF_VEHICLES = 1.0, 0.35, 0.3, 0.0
"""How much of a porous ground's change each kind shows; leaves and paint keep water on them, not in them."""

PLANT_SATURATION = 0.25
"""Growth of the colour of leaves and grass: a film on them scatters less white light than their wax and dust do."""

_STREAK_WIDTH_M, _STREAK_HEIGHT_M = 24.0, 260.0
"""Periods of the noise on walls, across and down: a streak is a hundredth of it."""


def wet_albedo(albedo: Image) -> Image:
    """Diffuse albedo under a film of water, per channel (Lekner and Dorf 1988, without their change of index).

    Light enters with 1 - R, is reflected by the surface with d, and thrown back by the film with p time and again:
    w = (1 - R) (1 - p) d / (1 - p d). Dark colours lose more than bright ones, hence also saturation grows.
    """
    return (1 - WATER_REFLECTANCE) * (1 - INTERNAL_REFLECTION) * albedo / (1 - INTERNAL_REFLECTION * albedo)


def wetted(surface: Image, surfaces: Surfaces, settings: WetSettings) -> Image:
    """Wet the surfaces of a view, linear light in and out."""
    albedo = np.clip(WHITE * surface, 0, 0.95)
    wet = wet_albedo(albedo) / WHITE
    share = settings.darkening * soaking(surfaces, settings)[..., None]
    soaked = surface + share * (np.minimum(wet, surface) - surface)
    grey = (soaked @ LUMINANCE)[..., None]
    greener = (settings.darkening * PLANT_SATURATION * surfaces.plants)[..., None]
    return np.maximum(soaked + greener * (soaked - grey), 0).astype(np.float32)


def soaking(surfaces: Surfaces, settings: WetSettings) -> Plane:
    """How soaked each pixel is, 0 to 1: what lies open most, walls in streaks from above, vehicles not at all."""
    walls = SOAKING_OF_WALLS * (1 + settings.streaks * _streaks(surfaces, settings.seed))
    open_to_rain = walls + (SOAKING_OF_GROUND - walls) * surfaces.upness
    porous = open_to_rain + surfaces.plants * (SOAKING_OF_PLANTS - open_to_rain)
    return np.clip(porous + surfaces.vehicles * (SOAKING_OF_VEHICLES - porous), 0, 1).astype(np.float32)


def _streaks(surfaces: Surfaces, seed: int) -> Plane:
    """Where water runs down: noise that is fine along a wall and long downwards, -1 to 1."""
    x, y, z = (surfaces.points[..., i] for i in range(3))
    along = (0.8 * x + 0.6 * y) / _STREAK_WIDTH_M + 0.618 * (0.8 * y - 0.6 * x) / _STREAK_WIDTH_M
    noise = SmoothNoise(seed + 1, 0.9).at(along, z / _STREAK_HEIGHT_M)
    return (2 * smoothstep(-1.0, 1.6, noise) - 1) * (1 - surfaces.upness)
