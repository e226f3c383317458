"""The light that a scene was seen in, told from all its views at once: what sun and shadow look like in it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, Float32
from msgspec.structs import replace as replace_fields

from ...scene.geometry import linear_to_srgb, srgb_to_linear
from ..base import ClearView
from ..normals import view_rays
from .masks import SurfaceShares, smoothstep
from .noise import SmoothNoise, guided_filter
from .settings import WetSettings

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Of linear sRGB (IEC 61966-2-1)."""

DARKEST_EV = -10.0
"""Stops below white at which a pixel counts as black."""

MAX_CONTRAST_EV = 3.0
"""Sun and clear sky together over the sky alone: seven or eight to one. What is darker is dark by itself."""

_VIEWS, _STRIDE = 8, 4
"""So many views are looked at, spread evenly, and every so many-th pixel of each, both ways."""

_GRAY_ALBEDO = 0.35
"""Largest saturation (spread over maximum, linear) of ground that the light can be told from."""

_NEAR_M, _FAR_M = 1.5, 60.0

_BINS = 80

_UNTOLD_EV = -3.0
"""Ground where none is seen: a grey of 0.125."""


@dataclass(frozen=True, slots=True)
class IlluminationEstimate:
    """Light on level grey ground. Brightness in stops (EV) over white, linear light."""

    sun: float
    """How surely there are two kinds of ground, sunlit and shadowed: 0 to 1."""
    shadow_ev: float
    sunlit_ev: float
    """Mean brightness of both; equal where there is one kind only."""
    level_ev: float
    """Mean brightness of all ground."""
    shadow_tint_ev: tuple[float, float, float]
    sunlit_tint_ev: tuple[float, float, float]
    """Colour of both: stops of red, green and blue over their luminance."""


def estimate_illumination(views: Sequence[ClearView]) -> IlluminationEstimate:
    """Tell the light from at most eight views of a sequence; each is asked for once."""
    chosen = sorted({round(i) for i in np.linspace(0, len(views) - 1, min(len(views), _VIEWS))})
    samples = [_ground_samples(views[i]) for i in chosen]
    colors = np.concatenate([np.zeros((0, 3), np.float32), *(each[0] for each in samples)])
    weights = np.concatenate([np.zeros(0, np.float32), *(each[1] for each in samples)])
    if len(colors) < 100:
        return IlluminationEstimate(0.0, _UNTOLD_EV, _UNTOLD_EV, _UNTOLD_EV, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    levels = np.log2(np.maximum(colors @ LUMINANCE, 2**DARKEST_EV))
    return _two_kinds(colors, levels, weights)


def _ground_samples(view: ClearView) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Colours (linear) of level grey ground, and what area of it each stands for."""
    every = (slice(None, None, _STRIDE), slice(None, None, _STRIDE))
    light = srgb_to_linear(view.image[every])
    depth, brightest = view.depth[every], light.max(axis=-1)
    is_grey = light.max(axis=-1) - light.min(axis=-1) <= _GRAY_ALBEDO * np.maximum(brightest, 1e-4)
    is_free = (view.sky[every] < 0.05) & (view.vehicles[every] < 0.1)
    is_ground = (view.normals[every][..., 2] > 0.7) & (depth > _NEAR_M) & (depth < _FAR_M) & is_grey & is_free
    return light[is_ground].astype(np.float32), (depth[is_ground] ** 2).astype(np.float32)


def _two_kinds(
    colors: Float[np.ndarray, "n 3"], levels: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]
) -> IlluminationEstimate:
    """Part brightness in two where the variance between both parts is largest (Otsu 1979)."""
    counts, edges = np.histogram(levels, _BINS, (DARKEST_EV, 0.0), weights=weights)
    share = counts / counts.sum()
    middle = (edges[1:] + edges[:-1]) / 2
    below, mean = np.cumsum(share), float(share @ middle)
    spread = np.maximum(below * (1 - below), 1e-9)
    between = np.where(spread > 1e-6, (mean * below - np.cumsum(share * middle)) ** 2 / spread, 0)
    cut = int(np.argmax(between))
    is_sunlit = levels > edges[cut + 1]
    parts = [_mean(colors, levels, weights * which) for which in (~is_sunlit, is_sunlit)]
    (dark, dark_tint), (bright, bright_tint) = parts
    rarer = min(float(below[cut]), 1 - float(below[cut]))
    dark = max(dark, bright - MAX_CONTRAST_EV)
    sun = _ramp(0.8, 1.6, bright - dark) * _ramp(0.01, 0.04, rarer)
    _, tint = _mean(colors, levels, weights)
    dark_tint, bright_tint = (_between(tint, each, sun) for each in (dark_tint, bright_tint))
    return IlluminationEstimate(
        sun, mean + sun * (dark - mean), mean + sun * (bright - mean), mean, dark_tint, bright_tint
    )


def _mean(
    colors: Float[np.ndarray, "n 3"], levels: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]
) -> tuple[float, tuple[float, float, float]]:
    total = max(float(weights.sum()), 1e-9)
    color = np.maximum(weights @ colors / total, 2**DARKEST_EV)
    red, green, blue = (float(each) for each in np.log2(color / (color @ LUMINANCE)))
    return float(weights @ levels) / total, (red, green, blue)


def _between(
    start: tuple[float, float, float], end: tuple[float, float, float], share: float
) -> tuple[float, float, float]:
    red, green, blue = ((1 - share) * a + share * b for a, b in zip(start, end, strict=True))
    return red, green, blue


def _ramp(low: float, high: float, value: float) -> float:
    return float(np.clip((value - low) / (high - low), 0, 1))


# § Light of an overcast sky instead of the sun's: shadows lifted, sun lowered, its warmth taken away.

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

_IMAGE_EV, _FLATTENED_IMAGE, _IMAGE_SATURATION = -0.35, 0.2, 0.75
"""What a picture alone gets of a cloudy day: stops, share of its contrast in stops that goes, colour that stays."""

_IMAGE_WHITE_EV = (-1.2, 0.0)
"""Brightness over which contrast stays: a sky that is not sure, white before, is as bright as the cloud after."""

_CONTACT_SHADE, _CONTACT_SHARE = 0.5, 0.02


def composite_over_cloud(view: ClearView, surface: Image, settings: WetSettings) -> Image:
    """Surfaces (linear) before the overcast sky; mixed in display colour, as renderers and cameras mix edges."""
    rays = view_rays(view.camera)
    directions = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    share = view.sky[..., None]
    cloud = linear_to_srgb(overcast_sky(directions, settings))
    mixed = share * cloud + (1 - share) * linear_to_srgb(surface)
    return np.where(share > 0, srgb_to_linear(mixed), surface).astype(np.float32)


def overcast_surfaces(
    view: ClearView, light: IlluminationEstimate, settings: WetSettings, surfaces: SurfaceShares
) -> Image:
    """Everything but the sky under cloud, dry; linear light."""
    color = srgb_to_linear(remove_sky_color(view)).astype(np.float32)
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


def overcast_image(view: ClearView, settings: WetSettings) -> Image:
    """Everything but the sky under cloud, linear light, where nothing is known of the surfaces: light and colour alone.

    One curve for the whole picture, which keeps to the order of brightness: contrast shrinks about the picture's
    middle, by day the exposure falls, colours fade, and the light turns cooler. No pixel is taken for a road, a wall
    or a vehicle.
    """
    day = daylight(view)
    color = srgb_to_linear(remove_sky_color(view)).astype(np.float32)
    grey = (color @ LUMINANCE)[..., None]
    level = np.log2(np.maximum(grey, 2**DARKEST_EV)).astype(np.float32)
    lower = level[view.sky < 0.1]
    middle = float(np.median(lower)) if lower.size else 0.0
    flattened = settings.sun_removal * _FLATTENED_IMAGE * (1 - smoothstep(*_IMAGE_WHITE_EV, level))
    shift = day * (_IMAGE_EV - flattened * (level - middle)) + settings.exposure_ev
    tint = np.exp2(settings.coolness * CLOUD_TINT_EV)
    return np.maximum((grey + _IMAGE_SATURATION * (color - grey)) * tint * np.exp2(shift), 0).astype(np.float32)


def _no_brighter_than_cloud(light: Image, surfaces: SurfaceShares, settings: WetSettings) -> Image:
    """Bend brightness off below what cloud can give: white paper laid flat is as bright as the sky, a wall half."""
    most = srgb_to_linear(np.array(settings.sky_brightness)) * (_WHITE_WALL + (1 - _WHITE_WALL) * surfaces.up_facing)
    over = (light @ LUMINANCE) / (_WHITE * most)
    return (light / np.sqrt(1 + over**2)[..., None]).astype(np.float32)


def exposure_ev(light: IlluminationEstimate, settings: WetSettings) -> float:
    """Stops by which the camera opens up (or down) for the ground under cloud; the scene's, not a view's."""
    middle = (light.sunlit_ev + light.shadow_ev) / 2
    level = light.level_ev + settings.sun_removal * light.sun * (middle - light.level_ev)
    return settings.exposure_ev + float(np.clip(_EXPOSURE_SHARE * (DRY_GROUND_EV - level), -_EXPOSURE_EV, _EXPOSURE_EV))


def sunlit_share(level_ev: Plane, light: IlluminationEstimate, ground: Plane) -> Plane:
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
    return np.clip(guided_filter(told, level_ev, max(2, round(_EDGE_SHARE * width)), _EDGE_EV2), 0, 1)


def _tint(tint_ev: tuple[float, float, float], settings: WetSettings) -> Float32[np.ndarray, "3"]:
    """Stops a channel that turn the light's colour into cloud's."""
    away = np.clip(-np.array(tint_ev, np.float32), -_TINT_EV, _TINT_EV)
    return (_TINT_SHARE * away + settings.coolness * CLOUD_TINT_EV).astype(np.float32)


def _contact_shade(view: ClearView, surfaces: SurfaceShares) -> Plane:
    """Shade of the cloudy sky that vehicles keep from the ground beside them."""
    near = cv2.GaussianBlur(view.vehicles, (0, 0), max(1.0, _CONTACT_SHARE * view.camera.width))
    return (_CONTACT_SHADE * np.minimum(2 * near, 1) * surfaces.ground).astype(np.float32)


def _clipped_ground(view: ClearView, surfaces: SurfaceShares) -> Plane:
    """Where the sun left no drawing on the ground: dimmed, it would be as even as plastic."""
    return smoothstep(*_CLIPPED, view.image.min(axis=-1)) * surfaces.ground


def _grain(surfaces: SurfaceShares, seed: int) -> Plane:
    noise = SmoothNoise(seed + 2, 1.1)
    return noise.at(surfaces.points[..., 0] / _GRAIN_M, surfaces.points[..., 1] / _GRAIN_M)


# § The overcast sky: light by world direction, and how it takes the place of the clear one.

HORIZON_TO_ZENITH = 0.86
"""Display brightness overhead over that at the horizon. CIE's overcast sky (ISO 15469) is brighter overhead, but
rain-laden air is brighter where one looks through more of it."""

TINT = np.array([-0.045, 0.0, 0.04], np.float32)
"""Display colour of cloud over grey: 7000 K seen by a camera balanced for 5500 K, kept milder than the ratio."""

_CLOUD_HEIGHT_PERIODS = 5.0
"""Period of the cloud deck in its own height above the eye."""

_CLOUD_CONTRAST = 0.06

_FLAT = 0.12
"""Added to the rise of a direction, so that clouds don't shrink without end towards the horizon."""

_LOCAL_SHARE = 0.012
"""Size over which the clear sky's colour is averaged, as a share of the picture's width."""

_MIN_COVER = 0.05

_LIKE, _AMIDST = (0.04, 0.12), (0.3, 0.6)
"""Difference (display) up to which a colour is the sky's, and from which it is not; the same for sky around it."""

_NEAR_SKY, _ROUNDS, _MIN_GROWTH = (0.01, 0.06), 10, 2e-4
"""The same beside the sky; how often it may grow there, and the share of what is open that it must gain each time."""


def overcast_sky(directions: Float[np.ndarray, "h w 3"], settings: WetSettings) -> Image:
    """Light of the cloud deck by unit world direction (z up), linear. Below the horizon it is that of the horizon."""
    rise = np.clip(directions[..., 2], 0, 1).astype(np.float32)
    over = _CLOUD_HEIGHT_PERIODS * (rise + _FLAT)
    clouds = SmoothNoise(settings.seed).at(directions[..., 0] / over, directions[..., 1] / over)
    grey = settings.sky_brightness * (1 - (1 - HORIZON_TO_ZENITH) * rise**0.7)
    grey *= 1 + settings.clouds * _CLOUD_CONTRAST * clouds * np.minimum(1, 4 * rise + 0.3)
    display = np.minimum(grey[..., None] + settings.coolness * TINT, 1)
    return srgb_to_linear(display.astype(np.float32)).astype(np.float32)


def extend_sky_mask(view: ClearView) -> ClearView:
    """Count as sky what has its colour and stands in its midst, or beside it at a distance that is not known.

    Scenes keep scraps of sky before the sky, and masks of pictures end where twigs begin. Where distances are not
    known, only what stands in its midst counts: hills and walls beside a sky may have its colour.
    """
    rising = view_rays(view.camera)[..., 2] > 0
    is_open = (view.depth <= 0) & rising & view.has_surfaces
    share = view.sky
    for _ in range(_ROUNDS):
        behind, around = _local_sky(view.image, share)
        like = 1 - smoothstep(*_LIKE, np.abs(view.image - behind).max(axis=-1))
        near = np.where(is_open, smoothstep(*_NEAR_SKY, around), smoothstep(*_AMIDST, around))
        grown = np.maximum(share, like * near * rising).astype(np.float32)
        added, share = np.mean((grown - share)[is_open]) if is_open.any() else 0.0, grown
        if added < _MIN_GROWTH:
            break
    return replace(view, sky=share)


def match_sky_brightness(view: ClearView, settings: WetSettings, daylight: float) -> WetSettings:
    """Return settings whose cloud is, but for the share of daylight, no brighter than the clear sky of a picture.

    Where the light of a place is not known its own sky tells it: over a street at dusk no cloud is white.
    """
    sky = view.sky > 0.9
    if not sky.any():
        return settings
    own = float(np.median(view.image[sky].mean(axis=-1)))
    brightness = own + daylight * (settings.sky_brightness - own)
    return replace_fields(settings, sky_brightness=float(np.clip(brightness, 0.3, settings.sky_brightness)))


def remove_sky_color(view: ClearView) -> Image:
    """What stands before the sky, display colour: pixels that are partly sky are unmixed from its colour around them.

    Renderers and cameras alike mix edges: picture = sky share * sky + rest * surface, solved for the surface.
    """
    share = view.sky[..., None]
    behind, _ = _local_sky(view.image, view.sky)
    rest = np.maximum(1 - share, _MIN_COVER)
    return np.clip((view.image - share * behind) / rest, 0, 1).astype(np.float32)


def _local_sky(image: Image, share: Float32[np.ndarray, "h w"]) -> tuple[Image, Float32[np.ndarray, "h w"]]:
    """Colour of the clear sky around each pixel (display), and share of pixels there that show nothing else."""
    weight = (share > 0.9).astype(np.float32)
    sigma = max(1.0, _LOCAL_SHARE * share.shape[1])
    around = cv2.GaussianBlur(weight, (0, 0), sigma)
    colors = cv2.GaussianBlur(image * weight[..., None], (0, 0), sigma)
    return (colors / (around[..., None] + 1e-6)).astype(np.float32), around
