"""Light of single photographs under rain clouds: sun and shadows are softened by the wet look's relighting."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from ..datasets.geometry import scaled_camera
from ..fields import option_names
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
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

SOFTENED_ABOVE_MM_H = 2.5
"""Intensity above which the light is softened: that of moderate rain (American Meteorological Society, Glossary of
Meteorology). The sun may shine through a lighter one."""
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

    def sky(self, light: PhotoLight) -> Bool[np.ndarray, "h w"] | None:
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


# Sun of one photograph

_BY_DAY = (0.2, 0.6)
"""Ramp of `daylight` over which a photograph counts as one by day."""
_CAST_EV, _SAME_COLOR_EV = 1.6, 0.6
"""Least step of a cast shadow's edge, and largest difference of its sides' colors (red or blue over green), in stops.
Edges of materials of one color are weaker: concrete is up to three times as bright as asphalt."""
_LIT_EV, _DEEP_EV = -3.5, -7.5
"""Least brightness of the sunlit side of such an edge, and of its shadow: darker are things, not their shadows."""
_EDGES = (0.010, 0.020)
"""Ramp of the share of level ground next to edges of cast shadows. Overcast streets have 0.006 and less (RainSense),
sunlit ones 0.02 and more (DGP, nuScenes, KITTI)."""
_OVER_SKY_EV = (-1.6, -1.1)
"""Ramp of the brightness of sunlit ground over that of the sky. Under an even sky it is the albedo: 0.35 is gray stone."""
_STEP_SHARE = 0.01  # distance of an edge's sides as a share of the image width
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
    smooth = cv2.medianBlur(np.rint(view.image * 255).astype(np.uint8), 5)
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
_RATIOS = (0.25, 3.0)
_THIN = 0.05  # display brightness by which wires and twigs before the sky are darker than it


class SoftenedPhoto(NamedTuple):
    """Photograph under clouds."""

    pixels: Colors
    sky: Bool[np.ndarray, "h w"]
    """Pixels of the closed sky."""


def softened_photo(
    photo: Colors, camera: Camera, view: ClearView, light: IlluminationEstimate, sun: float
) -> SoftenedPhoto:
    """Return a photograph under clouds, by the confidence in its sun; all else stays, such as its grain.

    The wet look relights the small view; ratios of its colors, fitted by the brightness around each pixel, relight
    the photograph. The sky gives way to clouds with what is in front of it: twigs and wires are differences to the
    clear sky.

    Args:
        photo: In the camera's own lens and size.
        camera: Camera of the photograph, with its lens.
        view: The same without distortion, of any size, with its surfaces and sky.
        light: Illumination of the view.
        sun: Share of the softening, 0 to 1.
    """
    view = extend_sky_mask(view)
    relit = linear_to_srgb(overcast_surfaces(view, light, _SETTINGS, surfaces_of(view)))
    ratio = ((relit + _BLACK) / (remove_sky_color(view) + _BLACK)).astype(np.float32)
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


def _relit(
    photo: Colors,
    small: Image,
    ratio: Image,
    known: np.ndarray,
    sky: Plane,
    behind: Image,
    cloud: Image,
    sun: float,
) -> SoftenedPhoto:
    height, width = photo.shape[:2]
    radius = max(round(_EDGE_SHARE * small.shape[1]), 2)
    bright = _brightness(small)
    colors = photo.astype(np.float32) / np.float32(255)
    guide = _brightness(colors)
    fits = [guided_fit(np.ascontiguousarray(ratio[..., i]), bright, radius, _SPREAD, known) for i in range(3)]
    sky_fit = color_guided_fit(sky, small, max(round(_SKY_SHARE * small.shape[1]), 2), _SKY_SPREAD)
    share = sky_fit.at([np.ascontiguousarray(colors[..., i]) for i in range(3)])
    share = np.clip((share - np.float32(0.1)) / np.float32(0.8), 0, 1)
    out = np.empty_like(photo)
    for i in range(3):
        own = np.ascontiguousarray(colors[..., i])
        back, front = (cv2.resize(np.ascontiguousarray(e[..., i]), (width, height)) for e in (behind, cloud))
        rest = np.minimum(own - share * back, 1 - share)
        rest = np.where(rest < 0, np.minimum(rest + share * np.float32(_THIN), 0), rest)
        lit = np.clip(fits[i].at([guide]), *_RATIOS) * rest + share * front
        out[..., i] = np.rint(np.clip(own + np.float32(sun) * (lit - own), 0, 1) * 255)
    return SoftenedPhoto(out, share > 0.9)


def _brightness(image: Image) -> Plane:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.float32)
