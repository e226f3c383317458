"""Light of raindrops in front of a photographed place: what surrounds the line of sight, refracted and reflected."""

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from gsrain_engine.render.camera_response import light_of_display, tone_curve
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.geometry import LUMINANCE
from gsrain_engine.scene.water_surface import reflectance
from gsrain_engine.water.refraction import WATER_INDEX

_RINGS, _RAYS = 24, 32
_GRID = (32, 16)  # directions across and down the picture: the light changes slowly over it
_MINIFIED = 16
_CROWNS_DEG = 34.0  # ours: trees and walls that are cut off by the picture's upper edge reach up to that elevation
_HIGHLIGHTS = 1.5
"""Compression of highlights by the camera, c: a sky of gray 221 has 1.9 times the light that the tone curve says."""


def drop_rays() -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, " n"]]:
    """Return directions from which rays reach a camera over a drop, and their shares of the drop's disk.

    The third axis is the line of sight. A ray at a distance b of the radius from the center, sin i = b, leaves a sphere
    of index n turned by 2 (i - r), sin r = b / n, with (1 - F)^2 of its light, F by Fresnel; a share F is reflected at
    pi - 2 i. Light that is reflected inside of the drop is left out.
    """
    distances = np.sqrt((np.arange(_RINGS) + 0.5) / _RINGS)
    incident = np.arcsin(distances)
    lost = np.array([reflectance(float(np.cos(each)), WATER_INDEX) for each in incident])
    turned = np.concatenate([2 * (incident - np.arcsin(distances / WATER_INDEX)), np.pi - 2 * incident])
    shares = np.concatenate([(1 - lost) ** 2, lost]) / (_RINGS * _RAYS)
    around = (np.arange(_RAYS) + 0.5) * 2 * np.pi / _RAYS
    across = np.sin(turned)[:, None]
    rays = [across * np.cos(around), across * np.sin(around), np.repeat(np.cos(turned)[:, None], _RAYS, axis=1)]
    return np.stack(rays, axis=-1).reshape(-1, 3), np.repeat(shares, _RAYS)


def light_before(
    picture: Float32[np.ndarray, "h w 3"], sky: Float64[np.ndarray, "3"], camera: Camera, curve: str
) -> Float32[np.ndarray, "h w 3"]:
    """Return the display color (gray levels) of a drop before each pixel of a level camera's picture without rain.

    The light of each ray, see `drop_rays`, is that of the picture. To its sides, below it and up to an elevation of
    `_CROWNS_DEG` the picture's edge goes on; above is an overcast sky (Moon and Spencer 1942), (1 + 2 sin e) / 3 of its
    zenith at an elevation e, which has the display color `sky` halfway up to the picture's upper edge.
    """
    linear = _scene_light(picture, curve).astype(np.float32)
    small = cv2.resize(linear, None, fx=1 / _MINIFIED, fy=1 / _MINIFIED, interpolation=cv2.INTER_AREA)
    rays, shares = drop_rays()
    columns, rows = (
        (np.arange(n) + 0.5) * side / n for n, side in zip(_GRID, (camera.width, camera.height), strict=True)
    )
    x, y = np.meshgrid((columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy)
    ahead = np.stack([x, y, np.ones_like(x)], axis=-1)
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    right = np.cross(np.array([0.0, 1.0, 0.0]), ahead)
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    light = _environment(
        np.einsum("nk,krcj->rcnj", rays, np.stack([right, np.cross(ahead, right), ahead])), small, sky, camera, curve
    )
    drop = np.einsum("rcnj,n->rcj", light, shares)
    shown = 255 * tone_curve(np.clip(drop, 0, 1), curve)
    size = (camera.width, camera.height)
    return cv2.resize(shown.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)


def _scene_light(levels: np.ndarray, curve: str) -> np.ndarray:
    """Linear light L of gray levels by the inverse tone curve, highlights with L (1 + c Y^2), Y the luminance."""
    light = light_of_display(levels.astype(np.float64) / 255, curve)
    luminance = (light @ LUMINANCE)[..., None]
    return light * (1 + _HIGHLIGHTS * luminance**2)


def _environment(
    directions: Float64[np.ndarray, "r c n 3"],
    small: Float32[np.ndarray, "a b 3"],
    sky: Float64[np.ndarray, "3"],
    camera: Camera,
    curve: str,
) -> Float64[np.ndarray, "r c n 3"]:
    """Linear light from directions (camera axes) around a level camera: its minified picture, the sky above it."""
    height, width = small.shape[:2]
    side = np.arctan2(max(camera.cx, camera.width - camera.cx), camera.fx)
    azimuth = np.clip(np.arctan2(directions[..., 0], directions[..., 2]), -side, side)
    upward = -directions[..., 1]
    tangent = upward / np.sqrt(np.maximum(1 - upward**2, 1e-9))
    x, y = camera.cx + camera.fx * np.tan(azimuth), camera.cy - camera.fy * tangent / np.cos(azimuth)
    column = np.clip(x / camera.width * width, 0, width - 1).astype(np.int64)
    row = np.clip(y / camera.height * height, 0, height - 1).astype(np.int64)
    low = np.sin(np.arctan2(camera.cy / 2, camera.fy))
    overcast = _scene_light(sky, curve) * ((1 + 2 * np.clip(upward, 0, 1)) / (1 + 2 * low))[..., None]
    open_sky = upward > np.sin(np.radians(_CROWNS_DEG))
    return np.where((open_sky & (y < 0))[..., None], overcast, small[row, column])
