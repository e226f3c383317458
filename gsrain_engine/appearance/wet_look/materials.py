"""Wet materials: darkened porous surfaces, glossy paint, lamps, and mist. Linear light."""

from collections.abc import Callable

import cv2
import numpy as np
from jaxtyping import Float, Float32

from ...render.guided_filter import guided_filter
from ...scene.geometry import srgb_to_linear
from ...scene.water_surface import WATER_REFLECTANCE, wet_albedo
from ..base import ClearView, Image, Plane
from .illumination import LUMINANCE, overcast_sky
from .masks import SurfaceShares, smoothstep
from .noise import smooth_noise_at
from .settings import WetSettings

MATTE_GROUND = 0.5
"""Share of the ground's own light where a mirror adds what water reflects. In RainSense at 9.2 mm/h a road before dark
trees has 0.07 of the sky's light; relit roads of captures have 0.17, since the sky of a sunny picture is clipped."""
MEAN_REFLECTANCE = 0.066
"""Fresnel reflectance of water for diffuse light, the mean over all directions."""
WHITE = 0.9
"""Albedo of white pixels."""
SOAKING_OF_GROUND, SOAKING_OF_PLANTS, SOAKING_OF_WALLS, SOAKING_OF_VEHICLES = 1.0, 0.55, 0.55, 0.0
"""Share of the change of porous ground per class; leaves and paint hold water on them, not in them."""
PLANT_SATURATION = 0.25
"""Increase in saturation of leaves and grass: a water film scatters less white light than their wax and dust."""
_STREAK_WIDTH_M, _STREAK_HEIGHT_M = 24.0, 260.0
"""Periods of the noise on walls, across and down: a streak is a hundredth of it."""


def wet_surfaces_color(surface: Image, surfaces: SurfaceShares, settings: WetSettings) -> Image:
    """Wet the surfaces of a view, linear light in and out."""
    wet = wet_albedo(np.clip(WHITE * surface, 0, 0.95)) / WHITE
    share = settings.darkening * porosity_wetness(surfaces, settings)[..., None]
    soaked = surface + share * (np.minimum(wet, surface) - surface)
    grey = (soaked @ LUMINANCE)[..., None]
    greener = (settings.darkening * PLANT_SATURATION * surfaces.plants)[..., None]
    return np.maximum(soaked + greener * (soaked - grey), 0).astype(np.float32)


def porosity_wetness(surfaces: SurfaceShares, settings: WetSettings) -> Plane:
    """Soaking of each pixel, 0 to 1: full for surfaces open to rain, in streaks on walls, none on vehicles."""
    walls = SOAKING_OF_WALLS * (1 + settings.streaks * _streaks(surfaces, settings.seed))
    open_to_rain = walls + (SOAKING_OF_GROUND - walls) * surfaces.up_facing
    porous = open_to_rain + surfaces.plants * (SOAKING_OF_PLANTS - open_to_rain)
    return np.clip(porous + surfaces.vehicles * (SOAKING_OF_VEHICLES - porous), 0, 1).astype(np.float32)


def _streaks(surfaces: SurfaceShares, seed: int) -> Plane:
    """Pattern of water running down walls: noise that is fine across and long downwards, -1 to 1."""
    x, y, z = (surfaces.points[..., i] for i in range(3))
    along = (0.8 * x + 0.6 * y) / _STREAK_WIDTH_M + 0.618 * (0.8 * y - 0.6 * x) / _STREAK_WIDTH_M
    noise = smooth_noise_at(along, z / _STREAK_HEIGHT_M, seed + 1, 0.9)
    return (2 * smoothstep(-1.0, 1.6, noise) - 1) * (1 - surfaces.up_facing)


# Wet paint: reflections of the overcast sky on vehicles

_OF_GROUND = 0.12  # brightness of vehicle reflections below the horizon (a wet road) relative to the sky's


def add_clear_coat(
    surface: Image, surfaces: SurfaceShares, directions: Float[np.ndarray, "h w 3"], settings: WetSettings
) -> Image:
    """Add reflections of wet vehicles, by Schlick's (1994) form of Fresnel's law. Linear light in and out.

    `directions` are unit view directions from the eye, in the world.
    """
    if not surfaces.vehicles.any():
        return surface
    facing = np.clip(-np.sum(directions * surfaces.normals, axis=-1), 0, 1)
    mirrored = directions + 2 * facing[..., None] * surfaces.normals
    fresnel = WATER_REFLECTANCE + (1 - WATER_REFLECTANCE) * (1 - facing) ** 5
    brightness = _OF_GROUND + (1 - _OF_GROUND) * smoothstep(-0.1, 0.25, mirrored[..., 2])
    reflection = overcast_sky(mirrored, settings) * brightness[..., None]
    share = (settings.gloss * surfaces.vehicles * np.minimum(fresnel, 0.6))[..., None]
    return ((1 - share) * surface + share * reflection).astype(np.float32)


# Lamps, lit signs and traffic lights: unchanged brightness under a dimmer sky, with a soft glow

_AROUND_SHARE = 0.025  # window as a share of the image width; a lamp is small, so it outshines the mean over it
_GLOW_SHARES, _GLOW_STRENGTHS = (0.004, 0.014), (0.25, 0.12)
"""Spread of the glow's core and skirt as shares of the image width, and their strengths."""
BRIGHTENING = 2.0
"""Brightness of lamps relative to the clear view: exposure rises under cloud, and lamps don't dim."""


def emissive_share(view: ClearView, surfaces: SurfaceShares, tail_lamps: bool = True) -> Plane:
    """Confidence that each pixel is a light source, 0 to 1: bright, colorful, small, neither sky nor ground.

    `tail_lamps` adds pixels of vehicles that are red, and redder than their surroundings.
    """
    light = srgb_to_linear(view.image).astype(np.float32)
    size = 2 * max(2, round(_AROUND_SHARE * view.camera.width)) + 1

    def mean(each: Plane) -> Plane:
        return cv2.blur(each, (size, size))

    own = lamp_share(light, mean, surfaces.vehicles if tail_lamps else np.zeros_like(surfaces.vehicles))
    return (own * (1 - view.sky) * (1 - surfaces.ground)).astype(np.float32)


def lamp_share(
    light: Float32[np.ndarray, "*n 3"],
    mean: Callable[[Float32[np.ndarray, "*n"]], Float32[np.ndarray, "*n"]],
    with_tail_lamps: Float32[np.ndarray, "*n"],
) -> Float32[np.ndarray, "*n"]:
    """Confidence that each color (linear) is that of a light source, by its difference from the mean around it.

    `with_tail_lamps` is the share of vehicles, whose red parts are lamps if redder than their surroundings.
    """
    brightest = light.max(axis=-1)
    colorful = 1 - light.min(axis=-1) / np.maximum(brightest, 1e-4)
    is_lit = smoothstep(0.45, 0.75, brightest) * smoothstep(0.6, 0.8, colorful)
    red, green, blue = (light[..., i] for i in range(3))
    is_red_to_green = (green >= 0.9 * blue) | (red > 2 * blue)
    outshines = smoothstep(2.0, 4.0, brightest / (mean(brightest) + 0.02))
    own = is_lit * is_red_to_green * outshines
    if with_tail_lamps.any():
        redness = np.maximum(red - np.maximum(green, blue), 0)
        redder = smoothstep(1.5, 2.5, redness / (mean(redness) + 0.02))
        own = np.maximum(own, smoothstep(0.15, 0.4, redness) * redder * with_tail_lamps)
    return own


def add_emissive_lights(surface: Image, view: ClearView, share: Plane, glow: float) -> Image:
    """Restore lamps to their own brightness and add their glow. Linear light in and out."""
    if not share.any():
        return surface
    own = BRIGHTENING * srgb_to_linear(view.image).astype(np.float32)
    lit = surface + share[..., None] * (np.maximum(own, surface) - surface)
    emitted = share[..., None] * own
    for size, strength in zip(_GLOW_SHARES, _GLOW_STRENGTHS, strict=True):
        lit = lit + glow * strength * cv2.GaussianBlur(emitted, (0, 0), max(0.8, size * view.camera.width))
    return lit.astype(np.float32)


# Mist: distant surfaces fade into the light of the cloudy horizon

_FILL_SHARE, _EDGE_SHARE, _EDGE2 = 0.02, 0.012, 0.002
"""Smoothing scales as shares of the image width: to fill unknown distances, and to align distances with image edges;
variance of display brightness from which the image has an edge."""
_ENCLOSED = 0.5
"""Share of known distances around a gap from which it is filled; at the border of unknown areas, distance is open."""


def apply_fog(surface: Image, view: ClearView, rays: Float[np.ndarray, "h w 3"], settings: WetSettings) -> Image:
    """Fade by exp(-extinction * distance) (Koschmieder 1924), linear light in and out; the sky is unchanged.

    `rays` are world directions, one meter of view depth long.
    """
    if settings.mist_km == 0:
        return surface
    through = np.exp(-settings.mist_km / 1000 * view.depth * np.linalg.norm(rays, axis=-1)).astype(np.float32)
    # Fill unknown pixels from their surroundings, and allow steps only at edges of the image.
    width = view.camera.width
    known = (view.depth > 0).astype(np.float32)
    sigma = max(1.0, _FILL_SHARE * width)
    around = cv2.GaussianBlur(known, (0, 0), sigma)
    mean = cv2.GaussianBlur(known * through, (0, 0), sigma) / np.maximum(around, 1e-6)
    filled = np.where(known > 0, through, np.where((around > _ENCLOSED) & (view.sky < 1), mean, 1)).astype(np.float32)
    guide = np.ascontiguousarray(view.image.mean(axis=-1))
    even = np.clip(guided_filter(filled, guide, max(1, round(_EDGE_SHARE * width)), _EDGE2), 0, 1)[..., None]
    level = rays * (1, 1, 0)
    level /= np.maximum(np.linalg.norm(level, axis=-1, keepdims=True), 1e-9)
    return (even * surface + (1 - even) * overcast_sky(level, settings)).astype(np.float32)
