"""How surfaces look with water in and on them: darker and more colourful where they are porous."""

from math import erfc, exp, pi, sqrt
from typing import no_type_check

import cv2
import numba
import numpy as np
from jaxtyping import Float, Float32

from ...scene.geometry import srgb_to_linear
from ..base import ClearView
from .illumination import LUMINANCE, overcast_sky
from .masks import SurfaceShares, smoothstep
from .noise import SmoothNoise, guided_filter
from .settings import WetSettings

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


def wet_surfaces_color(surface: Image, surfaces: SurfaceShares, settings: WetSettings) -> Image:
    """Wet the surfaces of a view, linear light in and out."""
    albedo = np.clip(WHITE * surface, 0, 0.95)
    wet = wet_albedo(albedo) / WHITE
    share = settings.darkening * porosity_wetness(surfaces, settings)[..., None]
    soaked = surface + share * (np.minimum(wet, surface) - surface)
    grey = (soaked @ LUMINANCE)[..., None]
    greener = (settings.darkening * PLANT_SATURATION * surfaces.plants)[..., None]
    return np.maximum(soaked + greener * (soaked - grey), 0).astype(np.float32)


def porosity_wetness(surfaces: SurfaceShares, settings: WetSettings) -> Plane:
    """How soaked each pixel is, 0 to 1: what lies open most, walls in streaks from above, vehicles not at all."""
    walls = SOAKING_OF_WALLS * (1 + settings.streaks * _streaks(surfaces, settings.seed))
    open_to_rain = walls + (SOAKING_OF_GROUND - walls) * surfaces.up_facing
    porous = open_to_rain + surfaces.plants * (SOAKING_OF_PLANTS - open_to_rain)
    return np.clip(porous + surfaces.vehicles * (SOAKING_OF_VEHICLES - porous), 0, 1).astype(np.float32)


def _streaks(surfaces: SurfaceShares, seed: int) -> Plane:
    """Where water runs down: noise that is fine along a wall and long downwards, -1 to 1."""
    x, y, z = (surfaces.points[..., i] for i in range(3))
    along = (0.8 * x + 0.6 * y) / _STREAK_WIDTH_M + 0.618 * (0.8 * y - 0.6 * x) / _STREAK_WIDTH_M
    noise = SmoothNoise(seed + 1, 0.9).at(along, z / _STREAK_HEIGHT_M)
    return (2 * smoothstep(-1.0, 1.6, noise) - 1) * (1 - surfaces.up_facing)


# § Wet paint: what vehicles mirror of the overcast sky.

_OF_GROUND = 0.12
"""Brightness of what a vehicle mirrors below the horizon, over the sky's: a wet road."""


def add_clear_coat(
    surface: Image, surfaces: SurfaceShares, directions: Float[np.ndarray, "h w 3"], settings: WetSettings
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


# § How much light water mirrors: Fresnel's law for unpolarized light.

WATER_INDEX = 1.333
"""Refractive index of water in visible light at 20 C."""


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def reflectance(cosine, index):
    """Share of unpolarized light that a smooth dielectric mirrors (Fresnel 1823): the mean over both polarizations.

    `cosine` is that of the angle between ray and normal, 0 to 1; `index` the refractive index of the inside.
    """
    inside = sqrt(max(1 - (1 - cosine * cosine) / (index * index), 0.0))
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (index * cosine - inside) / (index * cosine + inside)
    return 0.5 * (across * across + along * along)


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def unshadowed(cosine, slope):
    """Share of a rough surface's facets that a ray this flat meets unhindered (Smith 1967, Gaussian slopes).

    `cosine` is that of the angle to the mean normal, `slope` the facets' standard deviation of slope along the ray.
    """
    if cosine <= 0:
        return 0.0
    if slope <= 0 or cosine >= 1:
        return 1.0
    v = cosine / sqrt(1 - cosine * cosine) / (sqrt(2.0) * slope)
    if v > 4:
        return 1.0
    return 1 / (1 + 0.5 * (exp(-v * v) / (v * sqrt(pi)) - erfc(v)))


# § Lamps, lit signs and traffic lights: as bright as ever under a dimmer sky, with a soft glow around them.

_AROUND_SHARE = 0.025
"""A lamp is small: it outshines the mean over this share of the picture's width."""

_GLOW_SHARES, _GLOW_STRENGTHS = (0.004, 0.014), (0.25, 0.12)
"""Spread of the glow's core and skirt as shares of the picture's width, and how strong they are."""

BRIGHTENING = 2.0
"""Of lamps over their clear look: the camera opens up under cloud, lamps don't dim."""


def emissive_share(view: ClearView, surfaces: SurfaceShares, tail_lamps: bool = True) -> Plane:
    """How surely each pixel is a light of its own, 0 to 1: bright, colourful, small, neither sky nor ground.

    With `tail_lamps` also what is red on a vehicle and redder than what is around it.
    """
    light = srgb_to_linear(view.image).astype(np.float32)
    brightest = light.max(axis=-1)
    colorful = 1 - light.min(axis=-1) / np.maximum(brightest, 1e-4)
    is_lit = smoothstep(0.45, 0.75, brightest) * smoothstep(0.6, 0.8, colorful)
    red, green, blue = (light[..., i] for i in range(3))
    is_red_to_green = (green >= 0.9 * blue) | (red > 2 * blue)
    size = 2 * max(2, round(_AROUND_SHARE * view.camera.width)) + 1
    outshines = smoothstep(2.0, 4.0, brightest / (cv2.blur(brightest, (size, size)) + 0.02))
    own = is_lit * is_red_to_green * outshines
    if tail_lamps and surfaces.vehicles.any():
        redness = np.maximum(red - np.maximum(green, blue), 0)
        redder = smoothstep(1.5, 2.5, redness / (cv2.blur(redness, (size, size)) + 0.02))
        own = np.maximum(own, smoothstep(0.15, 0.4, redness) * redder * surfaces.vehicles)
    return (own * (1 - view.sky) * (1 - surfaces.ground)).astype(np.float32)


def add_emissive_lights(surface: Image, view: ClearView, share: Plane, glow: float) -> Image:
    """Put lamps back at their own brightness, and light around them. Linear light in and out."""
    if not share.any():
        return surface
    own = BRIGHTENING * srgb_to_linear(view.image).astype(np.float32)
    lit = surface + share[..., None] * (np.maximum(own, surface) - surface)
    emitted = share[..., None] * own
    for size, strength in zip(_GLOW_SHARES, _GLOW_STRENGTHS, strict=True):
        lit = lit + glow * strength * cv2.GaussianBlur(emitted, (0, 0), max(0.8, size * view.camera.width))
    return lit.astype(np.float32)


# § Damp air: what is far fades into the light of the cloudy horizon.

_FILL_SHARE, _EDGE_SHARE, _EDGE2 = 0.02, 0.012, 0.002
"""Sizes over which an unknown distance is taken from around it, and over which distances keep to the picture's edges,
as shares of its width; variance of display brightness from which something is an edge."""

_ENCLOSED = 0.5
"""Share of known distances around a gap from which it is filled: what lies beyond them may be near or far."""


def apply_fog(surface: Image, view: ClearView, rays: Float[np.ndarray, "h w 3"], settings: WetSettings) -> Image:
    """Fade by exp(-extinction * distance) (Koschmieder 1924), linear light in and out; the sky stays as it is.

    `rays` are world directions a metre of view depth long.
    """
    if settings.mist_km == 0:
        return surface
    through = np.exp(-settings.mist_km / 1000 * view.depth * np.linalg.norm(rays, axis=-1)).astype(np.float32)
    left = _even(through, view)[..., None]
    level = rays * (1, 1, 0)
    level /= np.maximum(np.linalg.norm(level, axis=-1, keepdims=True), 1e-9)
    return (left * surface + (1 - left) * overcast_sky(level, settings)).astype(np.float32)


def _even(through: Plane, view: ClearView) -> Plane:
    """Give unknown places what is around them, and let steps be only where the picture has edges too."""
    width = view.camera.width
    known = (view.depth > 0).astype(np.float32)
    sigma = max(1.0, _FILL_SHARE * width)
    around = cv2.GaussianBlur(known, (0, 0), sigma)
    mean = cv2.GaussianBlur(known * through, (0, 0), sigma) / np.maximum(around, 1e-6)
    filled = np.where(known > 0, through, np.where((around > _ENCLOSED) & (view.sky < 1), mean, 1)).astype(np.float32)
    guide = np.ascontiguousarray(view.image.mean(axis=-1))
    return np.clip(guided_filter(filled, guide, max(1, round(_EDGE_SHARE * width)), _EDGE2), 0, 1)
