"""Panoramas and stereo images, composed of several views from one place.

A panorama is equirectangular, with the world's up on top and the camera's heading in the middle. It is sampled from the
faces of a cube; faces overlap a little and fade into each other, so that no seam shows.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int64

from ..scene.camera import Camera, look_at
from .export_settings import Projection
from .renderer import Frame
from .view import RenderView

EYES_APART_M = 0.065
"""Distance between the eyes of a stereo image: the mean of adults (Dodgson 2004: 63 mm), rounded as cameras have it."""

_EDGE = 1.05  # tangent of half a face's angle: 45 degrees and a margin
_FADE = 0.1  # width of the fade between two faces, in the same tangent
_DENSITY = 1.25  # pixels of a face per pixel of the panorama, at the middle of the face
_UP = np.array([0.0, 0.0, 1.0])


def views_of(shot: RenderView, projection: Projection) -> list[RenderView]:
    """Views that `compose` makes a frame of: six faces of a cube, two eyes, or the view itself."""
    if projection == "360":
        return [_with_camera(shot, each) for each in _faces(shot.camera)]
    if projection == "stereo":
        return [_with_camera(shot, each) for each in _eyes(shot.camera)]
    return [shot]


def compose(frames: Sequence[Frame], projection: Projection, width: int, height: int) -> Frame:
    """Compose the frames of `views_of` to one; depth in a panorama is the distance in meters."""
    if projection == "stereo":
        left, right = frames
        depths = None if left.depth is None or right.depth is None else np.hstack([left.depth, right.depth])
        return Frame(np.hstack([left.rgba, right.rgba]), depths)
    lookup = _lookup(width, height, frames[0].rgba.shape[0])
    rgba = np.zeros((height * width, 4), np.float32)
    depth = np.zeros(height * width, np.float32)
    for face, frame in zip(lookup, frames, strict=True):
        rgba[face.pixels] += face.weights[:, None] * _bilinear(frame.rgba, face.x, face.y)
        if frame.depth is not None:
            rows, columns = np.rint(face.y).astype(np.int64), np.rint(face.x).astype(np.int64)
            found = frame.depth[rows.clip(0, len(frame.depth) - 1), columns.clip(0, len(frame.depth) - 1)]
            is_here = face.weights >= 0.5
            depth[face.pixels[is_here]] = (found * face.stretch)[is_here]
    has_depth = frames[0].depth is not None
    return Frame(rgba.reshape(height, width, 4), depth.reshape(height, width) if has_depth else None)


def _with_camera(shot: RenderView, camera: Camera) -> RenderView:
    """The view with another camera; which drops exist follows the output's angular resolution."""
    focal_px = shot.focal_px or float(np.sqrt(shot.camera.fx * shot.camera.fy))
    if camera.width == camera.height and camera.fx != shot.camera.fx:  # a face of a panorama
        focal_px = shot.camera.width / (2 * np.pi)
    return replace(shot, camera=camera, focal_px=focal_px)


def _eyes(camera: Camera) -> list[Camera]:
    """Left and right eye with parallel axes, each half as wide, side by side."""
    half, eyes = camera.width // 2, list[Camera]()
    for side in (-1, 1):
        pose = camera.world_to_camera.copy()
        pose[0, 3] -= side * EYES_APART_M / 2
        eyes.append(replace(camera, width=half, cx=camera.cx - (camera.width - half) / 2, world_to_camera=pose))
    return eyes


def _faces(camera: Camera) -> list[Camera]:
    """Cameras of the cube's faces, in the order of `_face_axes`."""
    size = int(np.ceil(_DENSITY * 2 * _EDGE * camera.width / (2 * np.pi)))
    ahead = camera.world_to_camera[2, :3] * [1, 1, 0]
    if np.linalg.norm(ahead) < 1e-6:  # straight up or down: the image's upper edge shows the heading
        ahead = -camera.world_to_camera[1, :3] * [1, 1, 0] * np.sign(camera.world_to_camera[2, 2])
    ahead = ahead / np.linalg.norm(ahead)
    right, eye = np.cross(ahead, _UP), camera.position
    axes = np.stack([ahead, right, _UP])
    focal = size / (2 * _EDGE)
    return [
        Camera(
            size,
            size,
            focal,
            focal,
            size / 2,
            size / 2,
            look_at(eye, eye + forward @ axes, up @ axes),
            camera.exposure_s,
        )
        for forward, up in _face_axes()
    ]


def _face_axes() -> list[tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]]:
    """Line of sight and upper edge of each face, along ahead, right and up."""
    up, ahead = (0, 0, 1), (1, 0, 0)
    faces = [(ahead, up), ((0, 1, 0), up), ((-1, 0, 0), up), ((0, -1, 0), up), (up, (-1, 0, 0)), ((0, 0, -1), ahead)]
    return [(np.array(forward, np.float64), np.array(above, np.float64)) for forward, above in faces]


class _FaceSamples(NamedTuple):
    """Pixels of a panorama that sample a face, and where."""

    pixels: Int64[np.ndarray, " n"]
    x: Float32[np.ndarray, " n"]
    """Columns of the face, from the center of the first."""
    y: Float32[np.ndarray, " n"]
    weights: Float32[np.ndarray, " n"]
    stretch: Float32[np.ndarray, " n"]
    """Distance over depth."""


@lru_cache(maxsize=2)
def _lookup(width: int, height: int, size: int) -> tuple[_FaceSamples, ...]:
    longitude = (np.arange(width) + 0.5) / width * 2 * np.pi - np.pi
    latitude = np.pi / 2 - (np.arange(height) + 0.5) / height * np.pi
    flat, rise = np.cos(latitude)[:, None], np.broadcast_to(np.sin(latitude)[:, None], (height, width))
    sights = np.stack([flat * np.cos(longitude), flat * np.sin(longitude), rise], axis=-1).reshape(-1, 3)
    found, total = list[tuple[np.ndarray, ...]](), np.zeros(len(sights))
    for forward, up in _face_axes():
        right = -np.cross(forward, up)  # ahead, right, up are left-handed
        depth = sights @ forward
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = sights @ right / depth, -(sights @ up) / depth
        away = np.maximum(np.abs(x), np.abs(y))
        pixels = np.flatnonzero((depth > 0) & (away < _EDGE))
        weights = np.clip((_EDGE - away[pixels]) / _FADE, 0, 1)
        total[pixels] += weights
        found.append((pixels, x[pixels], y[pixels], weights, 1 / depth[pixels]))
    faces = list[_FaceSamples]()
    for pixels, x, y, weights, stretch in found:
        columns, rows = (((each / _EDGE + 1) * size / 2 - 0.5).astype(np.float32) for each in (x, y))
        shares = (weights / total[pixels]).astype(np.float32)
        faces.append(_FaceSamples(pixels, columns, rows, shares, stretch.astype(np.float32)))
    return tuple(faces)


def _bilinear(
    image: Float32[np.ndarray, "h w c"], x: Float32[np.ndarray, " n"], y: Float32[np.ndarray, " n"]
) -> Float32[np.ndarray, "n c"]:
    """Sample an image between its pixels' centers."""
    high = image.shape[1] - 1
    x, y = np.clip(x, 0, high), np.clip(y, 0, high)
    left, top = np.minimum(x.astype(np.int64), high - 1), np.minimum(y.astype(np.int64), high - 1)
    u, v = (x - left.astype(np.float32))[:, None], (y - top.astype(np.float32))[:, None]
    upper = (1 - u) * image[top, left] + u * image[top, left + 1]
    lower = (1 - u) * image[top + 1, left] + u * image[top + 1, left + 1]
    return (1 - v) * upper + v * lower
