"""Light of single photographs under rain clouds: sun and shadows are softened by the wet look's relighting."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from ..datasets.geometry import scaled_camera
from ..fields import option_names
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..rain.wetness import SOFTENED_ABOVE_MM_H
from ..render.guided_filter import color_guided_fit, guided_fit
from ..render.photograph import PhotoLight, maps_between
from ..scene.camera import Camera
from ..scene.geometry import linear_to_srgb, srgb_to_linear
from .base import ClearView, Image, Plane
from .normals import view_directions
from .wet_look.illumination import (
    DARKEST_EV,
    LUMINANCE,
    IlluminationEstimate,
    daylight,
    estimate_illumination,
    extend_sky_mask,
    local_sky,
    overcast_sky,
    overcast_surfaces,
    remove_sky_color,
)
from .wet_look.masks import smoothstep, surfaces_of
from .wet_look.settings import WetSettings

Colors = UInt8[np.ndarray, "h w 3"]
Flags = Bool[np.ndarray, "h w"]
FullColors = UInt8[np.ndarray, "tall wide 3"]  # of a photograph next to a small view of it
FullPlane = Float32[np.ndarray, "tall wide"]

_MIN_SUN = 0.1  # least confidence in the sun with which light is softened
_MIN_SKY = 0.001  # least share of the picture that is certain sky


class LightOfPhoto:
    """Light of one photograph: that of the day on which it was taken, and of an overcast one."""

    def __init__(self, photo: Colors, camera: Camera, surfaces: Callable[[], ClearView] | None = None) -> None:
        """Take a photograph and its camera with its lens, and what measures its surfaces; None if nothing does.

        The surfaces are a view of any size, without distortion, with its certain sky.
        """
        self._photo, self._camera, self._measure = photo, camera, surfaces

    def light_in(self, rainfall: RainSimulation, time_s: float) -> PhotoLight:
        """Decide how the photograph is lit at a time of a rain."""
        if rainfall.rain.keep_light:
            return PhotoLight(f"{option_names(RainSettings)['keep_light']}")
        if rainfall.state_at(time_s).intensity_mm_h <= SOFTENED_ABOVE_MM_H:
            return PhotoLight(f"at most {SOFTENED_ABOVE_MM_H:g} mm/h")
        if self._measure is None:
            return PhotoLight("no distances")
        return self._judged

    def drawn(self, light: PhotoLight) -> Colors:
        """Return the photograph in a light of `light_in`."""
        return self._softened.pixels if light.is_softened else self._photo

    def sky(self, light: PhotoLight) -> Flags | None:
        """Return the sky that is closed in a light of `light_in`; None if none is."""
        return self._softened.sky if light.is_softened else None

    @cached_property
    def _view(self) -> ClearView:
        assert self._measure is not None
        return self._measure()

    @cached_property
    def _illumination(self) -> IlluminationEstimate:
        return estimate_illumination([self._view])

    @cached_property
    def _judged(self) -> PhotoLight:
        if daylight(self._view) <= _BY_DAY[0]:
            return PhotoLight("by night")
        if (self._view.sky > 0.9).mean() < _MIN_SKY:
            return PhotoLight("no certain sky")
        sun = sun_of(self._view, self._illumination)
        return PhotoLight("", sun) if sun >= _MIN_SUN else PhotoLight("already overcast")

    @cached_property
    def _softened(self) -> "SoftenedPhoto":
        return softened_photo(self._photo, self._camera, self._view, self._illumination, self._judged.sun)


def whole_sky(sure: Flags, image: Colors, measured: Flags) -> Flags:
    """Add what is connected with certain sky, deep blue and not measured: gaps between bright clouds.

    `measured` are the pixels of which a distance is known, and those around them.
    """
    red, blue = image[..., 0].astype(np.float32) / 255, image[..., 2].astype(np.float32) / 255
    deep, least = _DEEP_BLUE
    may_be = (sure | ((blue - red > deep) & (blue > least))) & ~measured
    joined = cv2.morphologyEx(may_be.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    _, parts = cv2.connectedComponents(joined, connectivity=4)
    return may_be & np.isin(parts, np.unique(parts[sure & may_be])) & (joined > 0)


# Sun of one photograph

_BY_DAY = (0.2, 0.6)
"""Ramp of `daylight` over which a photograph counts as one by day."""
_CAST_EV, _SAME_COLOR_EV = 1.6, 0.6
"""Least step of a cast shadow's edge, and largest difference of its sides' colors (red or blue over green), in stops.
Edges of materials of one color are weaker: concrete is up to three times as bright as asphalt."""
_LIT_EV, _DEEP_EV = -3.5, -7.5
"""Least brightness of the sunlit side of such an edge, and of its shadow: darker are things, not their shadows."""
_EDGES = (0.012, 0.020)
"""Ramp of the share of level ground next to edges of cast shadows. Overcast streets have 0.004 (RainSense), sunlit ones
0.02 and more (DGP, nuScenes, KITTI)."""
_OVER_SKY_EV = (-1.6, -1.1)
"""Ramp of the brightness of sunlit ground over that of the sky. Under an even sky it is the albedo; gray stone's is
0.35, which is -1.5."""
_STEP_SHARE, _SPECK_SHARE = 0.0125, 0.01
"""Distance of an edge's sides, and size of specks that have none, as shares of the image width."""
_LEVEL, _NEAR_M, _FAR_M = 0.8, 1.5, 40.0  # ground on which shadows are looked for


def sun_of(view: ClearView, light: IlluminationEstimate) -> float:
    """Confidence that the sun shines in a view, 0 to 1; 0 by night and under clouds.

    A single view of an overcast street also has bright and dark ground, of its materials. The sun's is as bright as
    the sky, or has sharp edges without a change of color.
    """
    day = float(smoothstep(*_BY_DAY, np.array([daylight(view)]))[0])
    if day * light.sun == 0:
        return 0.0
    over_sky = 0.0
    clear = view.sky > 0.9
    if clear.any():
        sky_ev = float(np.log2(max(np.median(srgb_to_linear(view.image[clear]) @ LUMINANCE), 2**DARKEST_EV)))
        over_sky = _ramp(_OVER_SKY_EV, light.sunlit_ev - sky_ev)
    return day * light.sun * max(over_sky, _ramp(_EDGES, _shadow_edges(view)))


def _shadow_edges(view: ClearView) -> float:
    """Share of level ground next to an edge of a cast shadow, of all pairs of its pixels in a row or column."""
    size = 2 * max(round(_SPECK_SHARE * view.camera.width / 2), 1) + 1
    smooth = cv2.medianBlur(np.rint(view.image * 255).astype(np.uint8), size)
    colors_ev = np.log2(np.maximum(srgb_to_linear(smooth / np.float32(255)), 2**DARKEST_EV)).astype(np.float32)
    level_ev, over_green = colors_ev.mean(axis=-1), colors_ev[..., [0, 2]] - colors_ev[..., 1:2]
    upward = cv2.blur(np.ascontiguousarray(view.normals[..., 2]), (7, 7)) > _LEVEL
    ground = upward & (view.depth > _NEAR_M) & (view.depth < _FAR_M) & (view.sky < 0.05) & (view.vehicles < 0.1)
    step = max(round(_STEP_SHARE * view.camera.width), 2)
    pairs = edges = 0
    for down, across in ((0, step), (step, 0)):
        height, width = ground.shape
        one, other = (slice(height - down), slice(width - across)), (slice(down, None), slice(across, None))
        both = ground[one] & ground[other]
        bright, dark = np.maximum(level_ev[one], level_ev[other]), np.minimum(level_ev[one], level_ev[other])
        is_same = np.abs(over_green[one] - over_green[other]).max(axis=-1) < _SAME_COLOR_EV
        is_edge = (bright - dark > _CAST_EV) & is_same & (bright > _LIT_EV) & (dark > _DEEP_EV)
        pairs += np.count_nonzero(both)
        edges += np.count_nonzero(both & is_edge)
    return edges / max(pairs, 1)


def _ramp(ends: tuple[float, float], value: float) -> float:
    return float(np.clip((value - ends[0]) / (ends[1] - ends[0]), 0, 1))


# Relighting

_SETTINGS = WetSettings()
_EDGE_SHARE, _SPREAD = 0.01, 0.03
"""Radius of the fits as a share of the image width, and deviation of brightness (display) that is an edge."""
_SKY_SHARE, _SKY_SPREAD = 0.02, 0.03  # the same of the sky's edge
_BLACK = 0.02  # display brightness below which ratios are drawn to 1: noise has no color
_RATIOS, _TINTS = (0.25, 1.7), (0.92, 1.08)
"""Ratios of display brightness, within which noise of shadows doesn't show, and those of a color over it."""
_WHITE, _WHITE_RATIO = (0.6, 0.95), 0.8
"""Display brightness of white things off the ground, and the least share of it that they keep."""
_GRAIN_SHARE = 0.004  # size of a photograph's grain as a share of the image width
_TWIG_SHARE, _CLEAR = 0.006, (0.96, 0.82)
"""Width of thin things before the sky as a share of the image width; share of the brightness of the sky next to them,
and of the broader sky, from which a pixel has nothing in front of it."""
_NEXT_TO, _AS_BRIGHT = 0.2, (0.75, 0.95)
"""Share of sky from which, and ramp of brightness over the sky's over which, a pixel at its edge is sky."""
_DEEP_BLUE = (0.15, 0.45)  # least blue over red, and blue (display), of sky that is darker than what is certain


class SoftenedPhoto(NamedTuple):
    """Photograph under clouds."""

    pixels: Colors
    sky: Flags
    """Pixels of the closed sky."""


def softened_photo(
    photo: Colors, camera: Camera, view: ClearView, light: IlluminationEstimate, sun: float
) -> SoftenedPhoto:
    """Return a photograph under clouds, by the confidence in its sun; all else stays, such as its grain.

    The wet look relights the small view; ratios of its colors, fitted by the brightness around each pixel, relight
    the photograph. The sky gives way to clouds; twigs and wires in front of it stay.

    Args:
        photo: In the camera's own lens and size.
        camera: Camera of the photograph, with its lens.
        view: The same without distortion, of any size, with its surfaces and sky.
        light: Illumination of the view.
        sun: Share of the softening, 0 to 1.
    """
    view = extend_sky_mask(view)
    surfaces = surfaces_of(view)
    relit = linear_to_srgb(overcast_surfaces(view, _without_cast(light), _SETTINGS, surfaces))
    own = remove_sky_color(view)
    ratio = ((relit + _BLACK) / (own + _BLACK)).astype(np.float32)
    # White walls, plates and vehicles end up bright, as exposure would have them without the sun.
    white = smoothstep(*_WHITE, own.min(axis=-1)) * (1 - surfaces.ground)
    ratio = np.maximum(ratio, (_WHITE_RATIO * white)[..., None])
    behind, _ = local_sky(view.image, view.sky)
    cloud = linear_to_srgb(overcast_sky(view_directions(view.camera), _SETTINGS)).astype(np.float32)
    known, sky = (view.sky < 0.5).astype(np.float32), view.sky
    small = view.image
    if camera.lens is not None:
        maps = maps_between(scaled_camera(camera, view.camera.width, view.camera.height), view.camera)
        ratio, behind, cloud, known, sky = (
            cv2.remap(each, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for each in (ratio, behind, cloud, known, sky)
        )
        size = view.camera.width, view.camera.height
        small = cv2.resize(photo, size, interpolation=cv2.INTER_AREA).astype(np.float32) / np.float32(255)
    return _relit(photo, small, ratio, known > 0.5, sky, behind, cloud, sun)


def _without_cast(light: IlluminationEstimate) -> IlluminationEstimate:
    """Leave only that color of sun and shadow which differs: warm from blue. What both have is the camera's balance."""
    (red, _, blue), (deep_red, _, deep_blue) = light.sunlit_tint_ev, light.shadow_tint_ev
    half = max((red - blue) - (deep_red - deep_blue), 0.0) / 4
    return replace(light, sunlit_tint_ev=(half, 0.0, -half), shadow_tint_ev=(-half, 0.0, half))


def _relit(
    photo: FullColors, small: Image, ratio: Image, known: Flags, sky: Plane, behind: Image, cloud: Image, sun: float
) -> SoftenedPhoto:
    """Multiply a photograph by ratios of a small one; `behind` is the color of its sky, and `cloud` the new one."""
    height, width = photo.shape[:2]
    colors = [np.ascontiguousarray(photo[..., i]).astype(np.float32) / np.float32(255) for i in range(3)]
    level = np.asarray(cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY), np.uint8)
    # The grain of the photograph is no guide: ratios that follow it would remove it next to shadows.
    smooth = cv2.medianBlur(level, 2 * max(round(_GRAIN_SHARE * width / 2), 1) + 1).astype(np.float32) / np.float32(255)
    share, front = _sky_and_front(colors, level, small, sky, behind)
    bright, radius = _brightness(small), max(round(_EDGE_SHARE * small.shape[1]), 2)
    fits = [guided_fit(each, bright, radius, _SPREAD, known).at([smooth]) for each in _planes(ratio)]
    gray = sum(np.float32(weight) * each for weight, each in zip(LUMINANCE, fits, strict=True))
    out = np.empty_like(photo)
    for i, (own, clouds) in enumerate(zip(colors, _planes(cloud), strict=True)):
        clouds = cv2.resize(clouds, (width, height))
        gain = np.clip(fits[i], np.maximum(_RATIOS[0], gray * _TINTS[0]), np.minimum(_RATIOS[1], gray * _TINTS[1]))
        lit = np.minimum(gain * own, clouds)  # nothing outshines the clouds
        lit += share * (front * clouds - lit)
        out[..., i] = np.rint(np.clip(own + np.float32(sun) * (lit - own), 0, 1) * 255)
    return SoftenedPhoto(out, share > 0.9)


def _sky_and_front(
    colors: Sequence[FullPlane], level: UInt8[np.ndarray, "tall wide"], small: Image, sky: Plane, behind: Image
) -> tuple[FullPlane, FullPlane]:
    """Share of sky in each pixel of a photograph, and share of its light that passes what is in front of it there."""
    height, width = level.shape
    fit = color_guided_fit(sky, small, max(round(_SKY_SHARE * small.shape[1]), 2), _SKY_SPREAD)
    share = np.clip((fit.at(colors) - np.float32(0.1)) / np.float32(0.8), 0, 1)
    bright = level.astype(np.float32) / np.float32(255)
    of_sky = bright / np.maximum(cv2.resize(_brightness(behind), (width, height)), np.float32(0.05))
    share = np.maximum(share, np.minimum(share / np.float32(_NEXT_TO), 1) * smoothstep(*_AS_BRIGHT, of_sky))
    # What is darker than the sky stands in front of it; clouds are broader than wires and twigs.
    side = 2 * max(round(_TWIG_SHARE * width / 2), 1) + 1
    open_sky = cv2.morphologyEx(level, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8)).astype(np.float32)
    thin = bright * np.float32(255) / np.maximum(open_sky, 1)
    return share, np.clip(np.minimum(thin / np.float32(_CLEAR[0]), of_sky / np.float32(_CLEAR[1])), 0, 1)


def _planes(image: Image) -> list[Plane]:
    return [np.ascontiguousarray(image[..., i]) for i in range(3)]


def _brightness(image: Image) -> Plane:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.float32)
