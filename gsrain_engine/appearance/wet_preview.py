"""A plain wet look of one view, without weights: overcast light, grey sky, wet ground. A preview, not the transfer."""

import numpy as np
from jaxtyping import Float, Float32

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.srgb import linear_to_srgb, srgb_to_linear

from .normals import view_rays, world_points

Image = Float[np.ndarray, "h w 3"]
Plane = Float[np.ndarray, "h w"]

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Of linear sRGB (IEC 61966-2-1)."""

SKY_HORIZON = np.array([0.80, 0.82, 0.84])
SKY_ZENITH = np.array([0.60, 0.63, 0.67])
"""Display colours of an overcast sky. It is brighter at the horizon here because rain-laden air is; CIE's standard
overcast sky, brighter overhead, holds for dry cloud."""
SKY_TEXTURE = 0.15
"""Share of the clear sky's own brightness pattern that stays as cloud structure."""

OVERCAST_EXPOSURE = 0.7
"""Brightness of surfaces after the sun is gone and the camera has opened up."""
OVERCAST_CONTRAST = 0.82
"""Exponent on luminance around mid-grey (0.18): lifts shadows, lowers what stood in the sun."""
OVERCAST_TINT = np.array([0.92, 1.0, 1.09])
"""Daylight from cloud (about 7000 K) relative to sun and sky together (about 5500 K), kept milder than the ratio."""
OVERCAST_SATURATION = 0.85

WET_DARKENING = 0.5
WET_SATURATION = 0.35
"""At full wetness: total reflection inside the film keeps light in; dark colours lose more (Lekner and Dorf 1988)."""
WALL_WETNESS = 0.3
"""How wet what does not face up gets, compared with the ground."""
FILM_REFLECTANCE = 0.02
"""Of water at normal incidence (refractive index 1.33)."""
GRAZING_REFLECTANCE = 0.28
"""Of a rough wet road seen flat; a still water surface would reach 1."""
REFLECTED_SKY = 0.5
"""Share of what a road reflects that is sky; the rest are darker houses and trees, here left black."""
GROUND_BAND_M = (0.25, 0.6)
"""Heights above the ground up to which up-facing surfaces count as ground, and from which they don't."""


def wet_preview(
    color: Float32[np.ndarray, "h w 3"],
    depth: Float32[np.ndarray, "h w"],
    upness: Float32[np.ndarray, "h w"],
    sky_mask: Float32[np.ndarray, "h w"],
    camera: Camera,
    *,
    ground_m: float | None = None,
    strength: float = 1.0,
) -> Float32[np.ndarray, "h w 3"]:
    """Return the view as it could look in rain. No view's own statistics enter, so views agree with each other.

    Args:
        color: Display colour (sRGB-encoded) 0..1.
        depth: Along the view axis in metres, 0 where unknown.
        upness: World-up component of the unit normal, -1..1, 0 where unknown.
        sky_mask: Share of sky, 0..1.
        camera: In the world (metres, z up); tells how flat a pixel looks onto the ground.
        ground_m: World height of the ground; None counts every up-facing surface as ground.
        strength: 0 changes nothing, 1 is the full look.
    """
    clear = srgb_to_linear(np.clip(color.astype(np.float64), 0, 1))
    rays = view_rays(camera)
    rise = rays[..., 2] / np.linalg.norm(rays, axis=-1)
    ground = ground_share(depth, upness, camera, ground_m)
    surface = _wetted(_overcast(clear), WALL_WETNESS + (1 - WALL_WETNESS) * ground)
    surface = _filmed(surface, ground, np.maximum(-rise, 0))
    sky = sky_mask[..., None].astype(np.float64)
    wet = sky * _overcast_sky(clear, rise) + (1 - sky) * surface
    return np.clip(linear_to_srgb((1 - strength) * clear + strength * wet), 0, 1).astype(np.float32)


def ground_share(
    depth: Float32[np.ndarray, "h w"], upness: Float32[np.ndarray, "h w"], camera: Camera, ground_m: float | None
) -> Float32[np.ndarray, "h w"]:
    """How much each pixel shows up-facing ground, 0 to 1."""
    share = _smoothstep(0.6, 0.9, upness.astype(np.float64))
    if ground_m is not None:
        height_m = world_points(depth, camera)[..., 2] - ground_m
        share = share * (1 - _smoothstep(*GROUND_BAND_M, height_m))
    return np.where(depth > 0, share, 0).astype(np.float32)


def _overcast(light: Image) -> Image:
    """Surfaces under cloud: less contrast, cooler, less colourful. Linear light in and out."""
    luminance = (light @ LUMINANCE)[..., None]
    flat = 0.18 * (np.maximum(luminance, 1e-6) / 0.18) ** OVERCAST_CONTRAST
    dull = luminance + OVERCAST_SATURATION * (light - luminance)
    return OVERCAST_EXPOSURE * OVERCAST_TINT * dull * flat / np.maximum(luminance, 1e-6)


def _wetted(light: Image, wetness: Plane) -> Image:
    """Darken and saturate by wetness 0..1. Linear light in and out."""
    w = wetness[..., None]
    luminance = (light @ LUMINANCE)[..., None]
    return np.maximum((1 - WET_DARKENING * w) * (luminance + (1 + WET_SATURATION * w) * (light - luminance)), 0)


def _filmed(light: Image, ground: Plane, cosine: Plane) -> Image:
    """Reflect the grey sky in the ground's water: Schlick's (1994) form of Fresnel's law, held back by roughness."""
    fresnel = FILM_REFLECTANCE + (GRAZING_REFLECTANCE - FILM_REFLECTANCE) * (1 - cosine) ** 5
    share = (fresnel * ground)[..., None]
    return (1 - share) * light + share * REFLECTED_SKY * srgb_to_linear(SKY_HORIZON)


def _overcast_sky(clear: Image, rise: Plane) -> Image:
    """Soft grey between horizon and zenith, with a little of the clear sky's pattern. Linear light."""
    height = np.clip(rise, 0, 1)[..., None] ** 0.6
    grey = srgb_to_linear((1 - height) * SKY_HORIZON + height * SKY_ZENITH)
    return grey * (1 + SKY_TEXTURE * ((clear @ LUMINANCE)[..., None] / 0.5 - 1))


def _smoothstep(low: float, high: float, x: Plane) -> Plane:
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
