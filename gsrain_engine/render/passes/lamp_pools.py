"""Light of lamps on level ground, toward one camera: reflections in a film of water, and pools of moving headlights.

The ground is divided into cells that have equal size in the picture, and each becomes a flat Gaussian in front of the
ground, so that vehicles and poles hide it as they hide the road, on all back ends.
"""

from math import cos, exp, pi, sin, sqrt
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Float64

from ...kernels import kernel, range_of
from ...scene.camera import Camera
from ...scene.gaussians import SH_C0, Gaussians
from ...scene.geometry import linear_to_srgb
from ...scene.lamps import LitLamps
from ...scene.lens import view_bounds
from ...scene.noise import layered_noise, smooth_noise
from ...scene.scene import DrawItem
from ...scene.water_surface import WATER_INDEX, reflectance, unshadowed
from ..frame_input import FrameInput
from .base import FrameParts

_COLUMNS = 220
_STEP = 0.035  # relative depth of a cell
_NEAR, _FAR_M = 0.7, 130.0  # horizontal distances: the near one in heights of the camera
_BEFORE_M = 0.65  # of a cell before the ground, so that cells of the road do not cover it
_SPREAD = 0.63  # standard deviation of a Gaussian in cells
_OVERLAP = 2 * np.pi * _SPREAD**2  # Gaussians that cover a point, in sums of their weights
_MAX_ALPHA, _MIN_LIGHT = 0.93, 0.002
_FILM_SLOPE, _POOL_SLOPE = 0.105, 0.035
"""Standard deviation of the slope of a film over asphalt, and of puddles, in rain."""
_POOL_SHARE = 0.25
_GROUND_ALBEDO, _WET_ALBEDO = 0.075, 0.022
"""Of asphalt, for headlights."""


class LampPools:
    """Light of the lamps on the ground, in scenes with level ground."""

    name, factor = "lamp pools", None

    def active(self, frame: FrameInput) -> bool:
        has_ground = frame.scene.ground_m is not None and not frame.is_photograph
        return bool(frame.lamps) and has_ground and frame.is_image

    def add(self, frame: FrameInput, parts: FrameParts) -> None:
        scene, camera, time_s = frame.scene, frame.view.camera, frame.time_s
        assert scene.ground_m is not None
        fixed = scene.lamps_at(time_s, [lamp for lamp in frame.lamps if lamp.mount == "scene"])
        moving = scene.lamps_at(time_s, [lamp for lamp in frame.lamps if lamp.mount != "scene"])
        mirrors = frame.reflecting_ground is None
        found = lamp_reflections(fixed, moving, camera, scene.ground_m, frame.wetness, mirrors=mirrors)
        parts.items += [] if found is None else [found]


def lamp_reflections(
    fixed: LitLamps, moving: LitLamps, camera: Camera, ground_m: float, wetness: float, *, mirrors: bool = True
) -> DrawItem | None:
    """Gaussians with the light that level ground at a height (m) sends to a camera; None if there is none.

    Light of `fixed` lamps on dry ground is part of the scene's own colors: they only add reflections in water, by
    wetness (0..1). Facets of water have Gaussian slopes, with Fresnel's law and Smith's shadowing; `moving` lamps light
    matte asphalt, too. Without `mirrors` water reflects nothing.
    """
    lamps = LitLamps(*(np.concatenate(pair) for pair in zip(fixed, moving, strict=True)))
    height = float(camera.position[2]) - ground_m
    forward = camera.world_to_camera[2, :3]
    if not len(lamps.positions_m) or height < 0.1 or np.hypot(forward[0], forward[1]) < 0.3:
        return None
    half = np.arctan(0.5 * np.hypot(camera.width, camera.height) / camera.fx)
    half = min((half if camera.is_pinhole else view_bounds(camera).angle_rad) + 0.05, np.pi)
    edges = np.arctan2(forward[1], forward[0]) + np.linspace(-half, half, _COLUMNS + 1)
    azimuths = 0.5 * (edges[1:] + edges[:-1])
    distances = _NEAR * height * np.exp(_STEP * np.arange(int(np.log(_FAR_M / (_NEAR * height)) / _STEP)))
    rows = np.concatenate(
        [lamps.positions_m - [0, 0, ground_m], lamps.directions, lamps.intensities,
         np.stack([lamps.cos_inner, lamps.cos_outer], axis=1)], axis=1,
    )  # fmt: skip
    eye = np.array([camera.position[0], camera.position[1], height])
    light = np.zeros((len(distances), _COLUMNS, 3))
    albedo = _GROUND_ALBEDO + wetness * (_WET_ALBEDO - _GROUND_ALBEDO)
    water = np.zeros((len(distances), _COLUMNS, 3))
    _light_cells(light, water, distances, azimuths, eye, rows, len(fixed.positions_m), albedo, mirrors and wetness > 0)
    r, k = np.nonzero((light + water).max(axis=2) > _MIN_LIGHT)
    if not len(r):
        return None
    flat = distances[r, None] * np.stack([np.cos(azimuths[k]), np.sin(azimuths[k])], axis=1)
    film = wetness * _film(flat + eye[:2])[:, None]
    display = linear_to_srgb(1 - np.exp(-(light[r, k] + film * water[r, k])))
    found = display.max(axis=1) > 0.01
    return _cells(flat[found], azimuths[k[found]], 2 * half / _COLUMNS, display[found], camera.position, height)


def _film(points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    """Share of ground that is covered by water, about 0.6 on average: patches and the grain of asphalt."""
    broad = layered_noise(points, 4.6, 431, 2) - 0.5
    grain = smooth_noise(points, 0.07, 433) - 0.5
    return np.clip(0.66 + 0.8 * broad + 0.4 * grain, 0.05, 1)


def _cells(
    flat: Float64[np.ndarray, "n 2"],
    azimuths: Float64[np.ndarray, " n"],
    turn: float,
    display: Float[np.ndarray, "n 3"],
    eye: Float64[np.ndarray, "3"],
    height: float,
) -> DrawItem:
    """Flat Gaussians that add display colors to what is behind them."""
    distance = np.linalg.norm(flat, axis=1)
    nearer = 1 - _BEFORE_M / np.hypot(distance, height)
    means = eye + nearer[:, None] * np.concatenate([flat, np.full((len(flat), 1), -height)], axis=1)
    alpha = np.minimum(display.max(axis=1), _MAX_ALPHA)
    opacity = np.minimum(-np.log1p(-alpha) / _OVERLAP, 0.99)
    turned = np.zeros((len(flat), 4), np.float32)
    turned[:, 0], turned[:, 3] = np.cos(azimuths / 2), np.sin(azimuths / 2)
    size = _SPREAD * (nearer * distance)[:, None] * np.array([_STEP, turn])
    scales = np.concatenate([size, np.full((len(flat), 1), 1e-3)], axis=1)
    colors = display / display.max(axis=1, keepdims=True)
    gaussians = Gaussians(
        means.astype(np.float32), scales.astype(np.float32), turned, opacity.astype(np.float32),
        ((colors - 0.5) / SH_C0).astype(np.float32)[:, None], antialiased=True,
    )  # fmt: skip
    return DrawItem(gaussians, np.eye(4))


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _light_cells(portion, light, water, distances, azimuths, eye, rows, fixed, albedo, wet):
    """Matte light and light by full cover of water from cells of the ground (z = 0) to the eye, linear."""
    for i in range_of(portion, len(distances)):
        r = distances[i]
        length = sqrt(r * r + eye[2] * eye[2])
        view = eye[2] / length
        for k in range(len(azimuths)):
            c, s = cos(azimuths[k]), sin(azimuths[k])
            x, y = eye[0] + r * c, eye[1] + r * s
            ox, oy = -r * c / length, -r * s / length
            for n in range(len(rows)):
                lx, ly, lz = rows[n, 0] - x, rows[n, 1] - y, rows[n, 2]
                squared = lx * lx + ly * ly + lz * lz
                if lz <= 0.05 or squared < 0.01:
                    continue
                d = sqrt(squared)
                lx, ly, lz = lx / d, ly / d, lz / d
                cosine = -(lx * rows[n, 3] + ly * rows[n, 4] + lz * rows[n, 5])
                part = min(max((cosine - rows[n, 10]) / max(rows[n, 9] - rows[n, 10], 1e-6), 0.0), 1.0)
                irradiance = part * part * (3 - 2 * part) / squared
                if irradiance <= 0:
                    continue
                if n >= fixed:
                    matte = albedo / pi * irradiance * lz
                    for channel in range(3):
                        light[i, k, channel] += matte * rows[n, 6 + channel]
                if not wet:
                    continue
                share = irradiance * reflected(ox, oy, view, lx, ly, lz)
                for channel in range(3):
                    water[i, k, channel] += share * rows[n, 6 + channel]


@kernel(error_model="numpy")
@no_type_check
def reflected(ox, oy, view, lx, ly, lz):
    """Radiance of wet ground by the irradiance of a lamp on a plane that faces it.

    F p G / (4 cos o h^4) with the density p of slopes, Fresnel's F, Smith's G and the half vector's height h (Cox and
    Munk 1954; Walter et al. 2007). `view` and `lz` are upward components of unit vectors to eye and lamp.
    """
    hx, hy, hz = ox + lx, oy + ly, view + lz
    size = sqrt(hx * hx + hy * hy + hz * hz)
    if size < 1e-6 or hz < 1e-6:
        return 0.0
    tilt = (hx * hx + hy * hy) / (hz * hz)
    cosine = min((hx * lx + hy * ly + hz * lz) / size, 1.0)
    if tilt > 12 * _FILM_SLOPE * _FILM_SLOPE * 1.5:
        return 0.0
    h = hz / size
    density = 0.0
    for slope, share in ((_FILM_SLOPE, 1 - _POOL_SHARE), (_POOL_SLOPE, _POOL_SHARE)):
        facets = exp(-0.5 * tilt / (slope * slope)) / (2 * pi * slope * slope)
        density += share * facets * unshadowed(view, slope) * unshadowed(lz, slope)
    return reflectance(cosine, WATER_INDEX) * density / (4 * view * h * h * h * h)
