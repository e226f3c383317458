"""Illumination: estimate of sun and shadow over all views, overcast relighting, and the overcast sky."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from msgspec.structs import replace as replace_fields

from ...render.guided_filter import guided_filter
from ...scene import geometry
from ...scene.geometry import linear_to_srgb, srgb_to_linear
from ..base import ClearView, Image, Plane
from ..normals import view_directions, view_rays
from .masks import SurfaceShares, smoothstep
from .noise import smooth_noise_at
from .settings import WetSettings

LUMINANCE = geometry.LUMINANCE.astype(np.float32)
"""Luminance weights of linear sRGB (IEC 61966-2-1)."""
DARKEST_EV = -10.0
"""Stops below white at which a pixel counts as black."""
MAX_CONTRAST_EV = 3.0
"""Largest contrast of sun plus clear sky over sky alone: seven or eight to one. Darker pixels are dark materials."""
_VIEWS, _STRIDE = 8, 4  # number of views sampled, spread evenly, and pixel stride in both directions
_GRAY_ALBEDO = 0.35  # largest saturation (spread over maximum, linear) of ground used for the estimate
_NEAR_M, _FAR_M = 1.5, 60.0
_BINS = 80
_FEWEST_SAMPLES = 100
_UNKNOWN_EV = -3.0  # default for scenes without visible ground: a gray of 0.125
Samples = Float[np.ndarray, " n"]
ColorSamples = Float[np.ndarray, "n 3"]
Ramp = Callable[[Float32[np.ndarray, "*n"]], Float32[np.ndarray, "*n"]]
Tint = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class IlluminationEstimate:
    """Light on level gray ground. Brightness in stops (EV) over white, linear light."""

    sun: float
    """Confidence that there is both sunlit and shadowed ground, 0 to 1."""
    shadow_ev: float
    sunlit_ev: float
    """Mean brightness of both; equal if there is only one kind."""
    level_ev: float
    """Mean brightness of all ground."""
    shadow_tint_ev: Tint
    sunlit_tint_ev: Tint
    """Color of both: stops of red, green and blue over their luminance."""


def estimate_illumination(views: Sequence[ClearView]) -> IlluminationEstimate:
    """Estimate the illumination from at most eight views of a sequence; each is read once."""
    chosen = sorted({round(i) for i in np.linspace(0, len(views) - 1, min(len(views), _VIEWS))})
    samples = [_ground_samples(views[i]) for i in chosen]
    colors = np.concatenate([np.zeros((0, 3), np.float32), *(each[0] for each in samples)])
    weights = np.concatenate([np.zeros(0, np.float32), *(each[1] for each in samples)])
    return illumination_of(colors, weights)


def illumination_of(colors: ColorSamples, weights: Samples) -> IlluminationEstimate:
    """Estimate the illumination from colors (linear) of level gray ground, each with the area that it stands for."""
    if len(colors) < _FEWEST_SAMPLES:
        return IlluminationEstimate(0.0, _UNKNOWN_EV, _UNKNOWN_EV, _UNKNOWN_EV, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    return _two_kinds(colors, np.log2(np.maximum(colors @ LUMINANCE, 2**DARKEST_EV)), weights)


def is_gray(colors: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
    """Mask of colors (linear) that are gray enough for ground of the estimate."""
    brightest = colors.max(axis=-1)
    return brightest - colors.min(axis=-1) <= _GRAY_ALBEDO * np.maximum(brightest, 1e-4)


def _ground_samples(view: ClearView) -> tuple[ColorSamples, Samples]:
    """Colors (linear) of level gray ground, weighted by the area of each sample."""
    every = (slice(None, None, _STRIDE), slice(None, None, _STRIDE))
    light = srgb_to_linear(view.image[every])
    depth = view.depth[every]
    is_free = (view.sky[every] < 0.05) & (view.vehicles[every] < 0.1)
    is_ground = (view.normals[every][..., 2] > 0.7) & (depth > _NEAR_M) & (depth < _FAR_M) & is_gray(light) & is_free
    return light[is_ground].astype(np.float32), (depth[is_ground] ** 2).astype(np.float32)


def _two_kinds(colors: ColorSamples, levels: Samples, weights: Samples) -> IlluminationEstimate:
    """Split brightness into two classes of maximal between-class variance (Otsu 1979)."""
    counts, edges = np.histogram(levels, _BINS, (DARKEST_EV, 0.0), weights=weights)
    share = counts / counts.sum()
    middle = (edges[1:] + edges[:-1]) / 2
    below, mean = np.cumsum(share), float(share @ middle)
    spread = np.maximum(below * (1 - below), 1e-9)
    between = np.where(spread > 1e-6, (mean * below - np.cumsum(share * middle)) ** 2 / spread, 0)
    cut = int(np.argmax(between))
    is_sunlit = levels > edges[cut + 1]
    dark, dark_color = _mean(colors, levels, weights * ~is_sunlit)
    bright, bright_color = _mean(colors, levels, weights * is_sunlit)
    rarer = min(float(below[cut]), 1 - float(below[cut]))
    dark = max(dark, bright - MAX_CONTRAST_EV)
    sun = _ramp(0.8, 1.6, bright - dark) * _ramp(0.01, 0.04, rarer)
    _, color = _mean(colors, levels, weights)

    def tint(of: Tint) -> Tint:
        red, green, blue = ((1 - sun) * a + sun * b for a, b in zip(color, of, strict=True))
        return red, green, blue

    shadow_ev, sunlit_ev = (mean + sun * (each - mean) for each in (dark, bright))
    return IlluminationEstimate(sun, shadow_ev, sunlit_ev, mean, tint(dark_color), tint(bright_color))


def _mean(colors: ColorSamples, levels: Samples, weights: Samples) -> tuple[float, Tint]:
    """Weighted mean brightness, and color in stops of red, green and blue over their luminance."""
    total = max(float(weights.sum()), 1e-9)
    color = np.maximum(weights @ colors / total, 2**DARKEST_EV)
    red, green, blue = (float(each) for each in np.log2(color / (color @ LUMINANCE)))
    return float(weights @ levels) / total, (red, green, blue)


def _ramp(low: float, high: float, value: float) -> float:
    return float(np.clip((value - low) / (high - low), 0, 1))


# Overcast relighting: shadows lifted, sunlight dimmed, its warmth removed

DRY_GROUND_EV = -2.7
"""Target brightness of level dry ground under cloud: half of a camera's middle gray, under an almost white sky."""
_EXPOSURE_SHARE, _EXPOSURE_EV = 0.75, 1.5
"""Share of the difference to the target that exposure corrects, and its limit in stops."""
_FLATTENED_WALLS, _FLATTENED_PLANTS = 0.8, 0.75
"""Flattening relative to the ground's, since the brightness of walls and leaves also depends on their own color."""
_PIVOT, _PIVOT_PLANTS = 0.5, 0.2
"""Sunlit share at which brightness is unchanged; lower for leaves, which are dark themselves and so are lifted less."""
_SOFT_EDGE, _WIDE_EDGE = 0.3, 0.7
"""Half width of the ramp between shadow and sun, as a share of their contrast: on the ground, and elsewhere."""
_SPECK_SHARE, _EDGE_SHARE, EDGE_EV2 = 0.012, 0.006, 0.2
"""Median size and guided filter radius of the sunlit share, as shares of the image width, and the filter's variance."""
_BROAD_SHARE, BROAD_EV2 = 0.04, 2.0
"""Radius as a share of the image width, and variance, of the broad brightness of walls and leaves. It alone is divided
into sun and shadow: finer contrasts are those of the materials, which a wet day keeps."""
_MATERIAL_EV = (-2.5, -0.8)
"""Stops below the ground's shadow over which brightness stops to be a shadow that clouds would lift: black stays."""
_TINT_EV, _TINT_SHARE = 0.35, 0.9
"""Largest correction of a channel towards neutral light in stops, and the share of it that is applied."""
CLOUD_TINT_EV = np.array([-0.03, 0.0, 0.04], np.float32)
_SATURATION, _SHADOW_DULLING = 1.0, 0.6
"""Color that surfaces other than plants keep, and the blue of the clear sky that shadowed ground loses."""
_BLUE = (-0.05, 0.1)  # blue minus red, as a share of luminance, over which ground turns from neutral to blue
_WHITE, _WHITE_WALL = 0.95, 0.62
"""Albedo of the whitest materials, and share of light that an upright one gets from cloudy sky and dark ground."""
_LOST_EV, _GRAIN_M, _CLIPPED = 0.3, 12.0, (0.88, 0.98)
"""Grain added to clipped ground in stops, period of its noise, and display values over which ground is clipped."""
_DAYLIGHT = (0.08, 0.22)
"""Median display brightness below the sky up to which an image is of the night, and from which it is of the day."""
_IMAGE_EV, _FLATTENED_IMAGE, _IMAGE_SATURATION = -0.35, 0.2, 0.75
"""Overcast look without known surfaces: stops, share of contrast that is removed, saturation that is kept."""
_IMAGE_WHITE_EV = (-1.2, 0.0)
"""Brightness over which contrast is kept, so that white areas that may be sky end up as bright as the clouds."""
_CONTACT_SHADE, _CONTACT_SHARE = 0.5, 0.02


def composite_over_cloud(view: ClearView, surface: Image, settings: WetSettings) -> Image:
    """Composite surfaces (linear) over the overcast sky, in display color, as renderers and cameras mix edges."""
    share = view.sky[..., None]
    cloud = linear_to_srgb(overcast_sky(view_directions(view.camera), settings))
    mixed = share * cloud + (1 - share) * linear_to_srgb(surface)
    return np.where(share > 0, srgb_to_linear(mixed), surface).astype(np.float32)


def overcast_surfaces(
    view: ClearView, light: IlluminationEstimate, settings: WetSettings, surfaces: SurfaceShares
) -> Image:
    """Surfaces under overcast light, dry and without the sky; linear light."""
    color = srgb_to_linear(remove_sky_color(view)).astype(np.float32)
    gray = (color @ LUMINANCE)[..., None]
    level = np.log2(np.maximum(gray[..., 0], 2**DARKEST_EV)).astype(np.float32)
    # Ground overexposed by the sun would be as even as plastic when it is dimmed.
    clipped = smoothstep(*_CLIPPED, view.image.min(axis=-1)) * surfaces.ground
    x, y = (surfaces.points[..., i] / _GRAIN_M for i in (0, 1))
    grain_ev = _LOST_EV * clipped * smooth_noise_at(x, y, settings.seed + 2, 1.1)
    # Ambient occlusion of the ground next to vehicles.
    near = cv2.GaussianBlur(view.vehicles, (0, 0), max(1.0, _CONTACT_SHARE * view.camera.width))
    shade = (_CONTACT_SHADE * np.minimum(2 * near, 1) * surfaces.ground).astype(np.float32)
    dimming_ev = grain_ev + np.log2(np.maximum(1 - shade, 1e-3))
    return overcast_colors(color, sunlit_share(level, light, surfaces.ground), light, settings, surfaces, dimming_ev)


def overcast_colors(
    color: Image,
    sunlit: Plane,
    light: IlluminationEstimate,
    settings: WetSettings,
    surfaces: SurfaceShares,
    dimming_ev: Plane | float = 0.0,
) -> Image:
    """Colors of surfaces under overcast light, linear in and out, by the share of sunlight on them in the clear image.

    `dimming_ev` is added to their brightness, in stops.
    """
    gray = (color @ LUMINANCE)[..., None]
    level = np.log2(np.maximum(gray[..., 0], 2**DARKEST_EV)).astype(np.float32)
    flattening = _FLATTENED_WALLS + (1 - _FLATTENED_WALLS) * surfaces.ground
    flattening += surfaces.plants * (_FLATTENED_PLANTS - flattening)
    contrast = settings.sun_removal * light.sun * (light.sunlit_ev - light.shadow_ev)
    shift = contrast * flattening * (_PIVOT + surfaces.plants * (_PIVOT_PLANTS - _PIVOT) - sunlit)
    low, high = (light.shadow_ev + each for each in _MATERIAL_EV)
    shift = np.where(shift > 0, shift * smoothstep(low, high, level), shift).astype(np.float32)
    in_shadow, in_sun = (_tint(tint, settings) for tint in (light.shadow_tint_ev, light.sunlit_tint_ev))
    tint = in_shadow + sunlit[..., None] * (in_sun - in_shadow)
    gain = np.exp2(shift + dimming_ev + exposure_ev(light, settings))
    blue = smoothstep(*_BLUE, (color[..., 2] - color[..., 0]) / np.maximum(gray[..., 0], 1e-3))
    colorful = _SATURATION * (1 - light.sun * _SHADOW_DULLING * blue * (1 - sunlit) * surfaces.ground)
    colorful = (colorful + (1 - colorful) * surfaces.plants)[..., None]
    lit = np.maximum((gray + colorful * (color - gray)) * np.exp2(tint), 0) * gain[..., None]
    # Compress brightness to that of the clouds: a level white surface is as bright as the sky, a wall half.
    brightest = srgb_to_linear(np.array(settings.sky_brightness))
    over = (lit @ LUMINANCE) / (_WHITE * (brightest * (_WHITE_WALL + (1 - _WHITE_WALL) * surfaces.up_facing)))
    return (lit / np.sqrt(1 + over**2)[..., None]).astype(np.float32)


def daylight(view: ClearView) -> float:
    """Daylight estimate from the brightness of an image's lower parts: 0 at night, 1 by day."""
    lower = view.image[view.sky < 0.1].mean(axis=-1)
    return 0.0 if not lower.size else float(smoothstep(*_DAYLIGHT, np.median(lower, keepdims=True))[0])


def overcast_image(view: ClearView, settings: WetSettings) -> Image:
    """Overcast look of a view without known surfaces, except its sky: light and color alone, linear.

    One monotonic curve for the whole image: contrast shrinks about the image's median, exposure falls by day, colors
    fade, and the light turns cooler. No pixel is classified as road, wall or vehicle.
    """
    day = daylight(view)
    color = srgb_to_linear(remove_sky_color(view)).astype(np.float32)
    gray = (color @ LUMINANCE)[..., None]
    level = np.log2(np.maximum(gray, 2**DARKEST_EV)).astype(np.float32)
    lower = level[view.sky < 0.1]
    middle = float(np.median(lower)) if lower.size else 0.0
    flattened = settings.sun_removal * _FLATTENED_IMAGE * (1 - smoothstep(*_IMAGE_WHITE_EV, level))
    shift = day * (_IMAGE_EV - flattened * (level - middle)) + settings.exposure_ev
    tint = np.exp2(settings.coolness * CLOUD_TINT_EV)
    return np.maximum((gray + _IMAGE_SATURATION * (color - gray)) * tint * np.exp2(shift), 0).astype(np.float32)


def exposure_ev(light: IlluminationEstimate, settings: WetSettings) -> float:
    """Exposure change in stops for the ground under cloud; one value per scene, for all views."""
    middle = (light.sunlit_ev + light.shadow_ev) / 2
    level = light.level_ev + settings.sun_removal * light.sun * (middle - light.level_ev)
    return settings.exposure_ev + float(np.clip(_EXPOSURE_SHARE * (DRY_GROUND_EV - level), -_EXPOSURE_EV, _EXPOSURE_EV))


def sunlit_share(level_ev: Plane, light: IlluminationEstimate, ground: Plane) -> Plane:
    """Share of sunlight on each pixel, 0 to 1, from its brightness between the scene's shadow and sun levels.

    On the ground, a median makes road markings and specks follow their surroundings. Walls have many colors, so a wider
    ramp makes their brightness count less, and only their broad brightness counts. Guided filters (He, Sun and Tang
    2013) follow edges.
    """
    width, (sharp_ramp, wide_ramp) = level_ev.shape[1], sun_ramps(light)
    broad = guided_filter(level_ev, level_ev, max(2, round(_BROAD_SHARE * width)), BROAD_EV2)
    sharp, wide = sharp_ramp(level_ev), wide_ramp(broad)
    size = 2 * max(1, round(_SPECK_SHARE * width / 2)) + 1
    share = cv2.medianBlur(np.round(sharp * 255).astype(np.uint8), size).astype(np.float32) / 255
    share = guided_filter(share, level_ev, max(2, round(_EDGE_SHARE * width)), EDGE_EV2)
    return np.clip(wide + ground * (share - wide), 0, 1)


def sun_ramps(light: IlluminationEstimate) -> tuple[Ramp, Ramp]:
    """Sunlit share of brightness in stops, of level ground, and of surfaces of many colors."""
    middle, contrast = (light.sunlit_ev + light.shadow_ev) / 2, max(light.sunlit_ev - light.shadow_ev, 0.1)
    sharp, wide = _SOFT_EDGE * contrast, _WIDE_EDGE * contrast
    return partial(smoothstep, middle - sharp, middle + sharp), partial(smoothstep, middle - wide, middle + wide)


def _tint(tint_ev: Tint, settings: WetSettings) -> Float32[np.ndarray, "3"]:
    """Stops per channel that turn the light's color into that of clouds."""
    away = np.clip(-np.array(tint_ev, np.float32), -_TINT_EV, _TINT_EV)
    return (_TINT_SHARE * away + settings.coolness * CLOUD_TINT_EV).astype(np.float32)


# Overcast sky: light by world direction, and its sky mask

HORIZON_TO_ZENITH = 0.86
"""Display brightness of the zenith relative to the horizon. CIE's overcast sky (ISO 15469) is brighter at the zenith,
but rain-laden air is brighter along longer lines of sight."""
TINT = np.array([-0.02, 0.0, 0.018], np.float32)
"""Display color of clouds relative to gray, slightly cool: cameras balance most of it."""
_CLOUD_HEIGHT_PERIODS = 5.0  # period of the cloud deck, in units of its height above the eye
_CLOUD_CONTRAST = 0.06
_FLAT = 0.12  # added to the rise of a direction, so that clouds don't shrink without limit towards the horizon
_LOCAL_SHARE = 0.012  # scale over which the clear sky's color is averaged, as a share of the image width
_MIN_COVER = 0.05
_BURNT, _BURNT_FROM_M = 0.97, 8.0
"""Display value and distance above the horizon from which overexposed pixels next to the sky are taken for sky."""
_LIKE, _AMIDST = (0.04, 0.12), (0.3, 0.6)
"""Ramps of the sky mask: color difference (display) from sky to other, and share of sky around a pixel."""
_NEAR_SKY, _ROUNDS, _MIN_GROWTH = (0.01, 0.06), 10, 2e-4
"""Ramp of the share of sky around a pixel of unknown depth; most growth rounds, and least growth per round."""


def overcast_sky(directions: Float[np.ndarray, "h w 3"], settings: WetSettings) -> Image:
    """Light of the cloud deck by unit world direction (z up), linear. Below the horizon it is the horizon's."""
    rise = np.clip(directions[..., 2], 0, 1).astype(np.float32)
    over = _CLOUD_HEIGHT_PERIODS * (rise + _FLAT)
    clouds = smooth_noise_at(directions[..., 0] / over, directions[..., 1] / over, settings.seed)
    gray = settings.sky_brightness * (1 - (1 - HORIZON_TO_ZENITH) * rise**0.7)
    gray *= 1 + settings.clouds * _CLOUD_CONTRAST * clouds * np.minimum(1, 4 * rise + 0.3)
    display = np.minimum(gray[..., None] + settings.coolness * TINT, 1)
    return srgb_to_linear(display.astype(np.float32)).astype(np.float32)


def extend_sky_mask(view: ClearView) -> ClearView:
    """Grow the sky mask to pixels of its color amidst the sky, or next to it at unknown depth.

    Scenes contain sky-colored Gaussians in front of the sky, and image masks end at twigs. If no depth is known, only
    pixels amidst the sky count, since hills and walls next to it may have its color.
    """
    rising = view_rays(view.camera)[..., 2] > 0
    is_white = (view.image.min(axis=-1) > _BURNT) & (view.depth > _BURNT_FROM_M)  # depth is often filled in there
    is_open = ((view.depth <= 0) | is_white) & rising & view.has_surfaces
    share = view.sky
    for _ in range(_ROUNDS):
        behind, around = local_sky(view.image, share)
        like = 1 - smoothstep(*_LIKE, np.abs(view.image - behind).max(axis=-1))
        near = np.where(is_open, smoothstep(*_NEAR_SKY, around), smoothstep(*_AMIDST, around))
        grown = np.maximum(share, like * near * rising).astype(np.float32)
        added, share = np.mean((grown - share)[is_open]) if is_open.any() else 0.0, grown
        if added < _MIN_GROWTH:
            break
    return replace(view, sky=share)


def match_sky_brightness(view: ClearView, settings: WetSettings, daylight: float) -> WetSettings:
    """Return settings whose clouds are no brighter than the image's clear sky, except for the share of daylight.

    Without known illumination, the image's own sky is the reference: at dusk no cloud is white.
    """
    sky = view.sky > 0.9
    if not sky.any():
        return settings
    own = float(np.median(view.image[sky].mean(axis=-1)))
    brightness = own + daylight * (settings.sky_brightness - own)
    return replace_fields(settings, sky_brightness=float(np.clip(brightness, 0.3, settings.sky_brightness)))


def remove_sky_color(view: ClearView) -> Image:
    """Display color of surfaces in front of the sky; partly covered pixels are unmixed from the sky's local color.

    Renderers and cameras mix edges alike: image = sky share * sky + rest * surface, solved for the surface.
    """
    share = view.sky[..., None]
    behind, _ = local_sky(view.image, view.sky)
    rest = np.maximum(1 - share, _MIN_COVER)
    return np.clip((view.image - share * behind) / rest, 0, 1).astype(np.float32)


def local_sky(image: Image, share: Plane) -> tuple[Image, Plane]:
    """Color of the clear sky around each pixel (display), and the share of pure sky pixels there."""
    weight = (share > 0.9).astype(np.float32)
    sigma = max(1.0, _LOCAL_SHARE * share.shape[1])
    around = cv2.GaussianBlur(weight, (0, 0), sigma)
    colors = cv2.GaussianBlur(image * weight[..., None], (0, 0), sigma)
    return (colors / (around[..., None] + 1e-6)).astype(np.float32), around
