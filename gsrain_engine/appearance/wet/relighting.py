"""Light of an overcast sky instead of the sun's: shadows lifted, sun lowered, its warmth taken away."""

import cv2
import numpy as np
from jaxtyping import Float32

from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.appearance.normals.from_depth import view_rays
from gsrain_engine.scene.srgb import linear_to_srgb, srgb_to_linear

from .guided import guided
from .light import DARKEST_EV, LUMINANCE, SceneLight
from .noise import SmoothNoise
from .settings import WetSettings
from .sky import overcast_sky, without_sky
from .smoothstep import smoothstep
from .surfaces import Surfaces

Image = Float32[np.ndarray, "h w 3"]
Plane = Float32[np.ndarray, "h w"]

DRY_GROUND_EV = -2.7
"""Brightness that level dry ground gets under cloud: half of what a camera gives to grey, under a sky nearly white."""
_EXPOSURE_SHARE, _EXPOSURE_EV = 0.75, 1.5
"""How much of the way there the exposure goes, and at most how far."""
_FLATTENED_WALLS, _FLATTENED_PLANTS = 0.7, 0.4
"""Flattening relative to the ground's: brightness of walls and leaves tells their own colour as well."""
_PIVOT, _PIVOT_PLANTS = 0.5, 0.2
"""What is this much in the sun keeps its brightness: leaves are dark by themselves, so that theirs is lifted less."""
_SOFT_EDGE, _WIDE_EDGE = 0.3, 0.7
"""Half width of the ramp between shadow and sun, as a share of their distance: on the ground, and elsewhere."""
_SPECK_SHARE, _EDGE_SHARE, _EDGE_EV2 = 0.012, 0.006, 0.05
"""Sizes over which shadow is told and snapped to edges, as shares of the picture's width."""
_TINT_EV, _TINT_SHARE = 0.2, 0.7
"""Most stops that a channel is moved to take the light's colour away, and the share of the way there."""
CLOUD_TINT_EV = np.array([-0.05, 0.0, 0.07], np.float32)
_SATURATION, _SHADOW_DULLING = 0.9, 0.6
"""Colour that surfaces other than plants keep, and what ground in shadow loses: the blue of a clear sky."""
_BLUE = (-0.05, 0.1)
"""Blue over red, as a share of luminance, from which ground counts as blue."""
_WHITE, _WHITE_WALL = 0.85, 0.55
"""Albedo of the whitest things, and what an upright one gets of a cloudy sky and a dark ground."""
_LOST_EV, _GRAIN_M, _CLIPPED = 0.3, 12.0, (0.88, 0.98)
"""Unevenness of ground too bright for the camera, the period of its noise, and display values at which it is lost."""
_DAYLIGHT = (0.08, 0.22)
"""Median display brightness below the sky up to which a picture is of the night, and from which it is of the day."""
_PICTURE_EV, _FLATTENED_PICTURE, _PICTURE_SATURATION = -0.35, 0.2, 0.75
"""What a picture alone gets of a cloudy day: stops, share of its contrast in stops that goes, colour that stays."""
_PICTURE_WHITE_EV = (-1.2, 0.0)
"""Brightness over which contrast stays: a sky that is not sure, white before, is as bright as the cloud after."""
_CONTACT_SHADE, _CONTACT_SHARE = 0.5, 0.02


def before_cloud(view: ClearView, surface: Image, settings: WetSettings) -> Image:
    """Surfaces (linear) before the overcast sky; mixed in display colour, as renderers and cameras mix edges."""
    rays = view_rays(view.camera)
    directions = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    share = view.sky[..., None]
    cloud = linear_to_srgb(overcast_sky(directions, settings))
    mixed = share * cloud + (1 - share) * linear_to_srgb(surface)
    return np.where(share > 0, srgb_to_linear(mixed), surface).astype(np.float32)


def overcast_surfaces(view: ClearView, light: SceneLight, settings: WetSettings, surfaces: Surfaces) -> Image:
    """Everything but the sky under cloud, dry; linear light."""
    color = srgb_to_linear(without_sky(view)).astype(np.float32)
    grey = (color @ LUMINANCE)[..., None]
    level = np.log2(np.maximum(grey[..., 0], 2**DARKEST_EV)).astype(np.float32)
    sunlit = sunlit_share(level, light, surfaces.ground)
    flattening = _FLATTENED_WALLS + (1 - _FLATTENED_WALLS) * surfaces.ground
    flattening += surfaces.plants * (_FLATTENED_PLANTS - flattening)
    contrast = light.sunlit_ev - light.shadow_ev
    shift = (
        settings.sun_removal
        * light.sun
        * contrast
        * flattening
        * (_PIVOT + surfaces.plants * (_PIVOT_PLANTS - _PIVOT) - sunlit)
    )
    tints = [_tint(tint, settings) for tint in (light.shadow_tint_ev, light.sunlit_tint_ev)]
    tint = tints[0] + sunlit[..., None] * (tints[1] - tints[0])
    shift += _LOST_EV * _clipped_ground(view, surfaces) * _grain(surfaces, settings.seed)
    gain = np.exp2(shift + exposure_ev(light, settings)) * (1 - _contact_shade(view, surfaces))
    blue = smoothstep(*_BLUE, (color[..., 2] - color[..., 0]) / np.maximum(grey[..., 0], 1e-3))
    colorful = _SATURATION * (1 - light.sun * _SHADOW_DULLING * blue * (1 - sunlit) * surfaces.ground)
    colorful = (colorful + (1 - colorful) * surfaces.plants)[..., None]
    moved = np.maximum((grey + colorful * (color - grey)) * np.exp2(tint), 0) * gain[..., None]
    return _no_brighter_than_cloud(moved, surfaces, settings)


def daylight(view: ClearView) -> float:
    """Return from the brightness of a picture's lower parts whether it was taken by day: 0 at night, 1 by day."""
    lower = view.image[view.sky < 0.1].mean(axis=-1)
    return 0.0 if not lower.size else float(smoothstep(*_DAYLIGHT, np.median(lower, keepdims=True))[0])


def overcast_picture(view: ClearView, settings: WetSettings) -> Image:
    """Everything but the sky under cloud, linear light, where nothing is known of the surfaces: light and colour alone.

    One curve for the whole picture, which keeps to the order of brightness: contrast shrinks about the picture's
    middle, by day the exposure falls, colours fade, and the light turns cooler. No pixel is taken for a road, a wall
    or a vehicle.
    """
    day = daylight(view)
    color = srgb_to_linear(without_sky(view)).astype(np.float32)
    grey = (color @ LUMINANCE)[..., None]
    level = np.log2(np.maximum(grey, 2**DARKEST_EV)).astype(np.float32)
    lower = level[view.sky < 0.1]
    middle = float(np.median(lower)) if lower.size else 0.0
    flattened = settings.sun_removal * _FLATTENED_PICTURE * (1 - smoothstep(*_PICTURE_WHITE_EV, level))
    shift = day * (_PICTURE_EV - flattened * (level - middle)) + settings.exposure_ev
    tint = np.exp2(settings.coolness * CLOUD_TINT_EV)
    return np.maximum((grey + _PICTURE_SATURATION * (color - grey)) * tint * np.exp2(shift), 0).astype(np.float32)


def _no_brighter_than_cloud(light: Image, surfaces: Surfaces, settings: WetSettings) -> Image:
    """Bend brightness off below what cloud can give: white paper laid flat is as bright as the sky, a wall half."""
    most = srgb_to_linear(np.array(settings.sky_brightness)) * (_WHITE_WALL + (1 - _WHITE_WALL) * surfaces.upness)
    over = (light @ LUMINANCE) / (_WHITE * most)
    return (light / np.sqrt(1 + over**2)[..., None]).astype(np.float32)


def exposure_ev(light: SceneLight, settings: WetSettings) -> float:
    """Stops by which the camera opens up (or down) for the ground under cloud; the scene's, not a view's."""
    middle = (light.sunlit_ev + light.shadow_ev) / 2
    level = light.level_ev + settings.sun_removal * light.sun * (middle - light.level_ev)
    return settings.exposure_ev + float(np.clip(_EXPOSURE_SHARE * (DRY_GROUND_EV - level), -_EXPOSURE_EV, _EXPOSURE_EV))


def sunlit_share(level_ev: Plane, light: SceneLight, ground: Plane) -> Plane:
    """How sunlit each pixel is, 0 to 1, by its brightness between the scene's shadow and sun.

    On the ground a median takes road markings and specks along with what is around them. Walls have all sorts of
    colours: a wider ramp makes less of where theirs happens to lie. A guided filter (He, Sun and Tang 2013) keeps to
    edges.
    """
    middle, contrast = (light.sunlit_ev + light.shadow_ev) / 2, max(light.sunlit_ev - light.shadow_ev, 0.1)
    sharp, wide = (
        smoothstep(middle - half * contrast, middle + half * contrast, level_ev) for half in (_SOFT_EDGE, _WIDE_EDGE)
    )
    width = level_ev.shape[1]
    size = 2 * max(1, round(_SPECK_SHARE * width / 2)) + 1
    told = cv2.medianBlur(np.round(sharp * 255).astype(np.uint8), size).astype(np.float32) / 255
    told = wide + ground * (told - wide)
    return np.clip(guided(told, level_ev, max(2, round(_EDGE_SHARE * width)), _EDGE_EV2), 0, 1)


def _tint(tint_ev: tuple[float, float, float], settings: WetSettings) -> Float32[np.ndarray, "3"]:
    """Stops a channel that turn the light's colour into cloud's."""
    away = np.clip(-np.array(tint_ev, np.float32), -_TINT_EV, _TINT_EV)
    return (_TINT_SHARE * away + settings.coolness * CLOUD_TINT_EV).astype(np.float32)


def _contact_shade(view: ClearView, surfaces: Surfaces) -> Plane:
    """Shade of the cloudy sky that vehicles keep from the ground beside them."""
    near = cv2.GaussianBlur(view.vehicles, (0, 0), max(1.0, _CONTACT_SHARE * view.camera.width))
    return (_CONTACT_SHADE * np.minimum(2 * near, 1) * surfaces.ground).astype(np.float32)


def _clipped_ground(view: ClearView, surfaces: Surfaces) -> Plane:
    """Where the sun left no drawing on the ground: dimmed, it would be as even as plastic."""
    return smoothstep(*_CLIPPED, view.image.min(axis=-1)) * surfaces.ground


def _grain(surfaces: Surfaces, seed: int) -> Plane:
    noise = SmoothNoise(seed + 2, 1.1)
    return noise.at(surfaces.points[..., 0] / _GRAIN_M, surfaces.points[..., 1] / _GRAIN_M)
