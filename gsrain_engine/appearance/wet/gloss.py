"""Wet paint: what vehicles mirror of the overcast sky."""

import numpy as np
from jaxtyping import Float, Float32

from .albedo import WATER_REFLECTANCE
from .settings import WetSettings
from .sky import overcast_sky
from .smoothstep import smoothstep
from .surfaces import Surfaces

Image = Float32[np.ndarray, "h w 3"]

_OF_GROUND = 0.12
"""Brightness of what a vehicle mirrors below the horizon, over the sky's: a wet road."""


def with_gloss(
    surface: Image, surfaces: Surfaces, directions: Float[np.ndarray, "h w 3"], settings: WetSettings
) -> Image:
    """Add what water on vehicles mirrors, by Schlick's (1994) form of Fresnel's law. Linear light in and out.

    Args:
        surface: The view without it.
        surfaces: Kinds and normals.
        directions: From the eye, unit, in the world.
        settings: How much gloss there is, and which sky.
    """
    if not surfaces.vehicles.any():
        return surface
    facing = np.clip(-np.sum(directions * surfaces.normals, axis=-1), 0, 1)
    mirrored = directions + 2 * facing[..., None] * surfaces.normals
    fresnel = WATER_REFLECTANCE + (1 - WATER_REFLECTANCE) * (1 - facing) ** 5
    sees_sky = _OF_GROUND + (1 - _OF_GROUND) * smoothstep(-0.1, 0.25, mirrored[..., 2])
    seen = overcast_sky(mirrored, settings) * sees_sky[..., None]
    share = (settings.gloss * surfaces.vehicles * np.minimum(fresnel, 0.6))[..., None]
    return ((1 - share) * surface + share * seen).astype(np.float32)
