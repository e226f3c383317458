"""Selection by a shape drawn over the image: all through, the front-most Gaussians, or down to a depth."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, no_type_check

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from ...kernels import kernel
from ...render.cpu.compositing import color_operator, color_operator_transpose
from ...render.cpu.projection import project
from ...render.cpu.splats import NEAR_M
from ...render.view import RenderView
from ...scene.camera import Camera
from ...scene.flags import BitMask
from ...scene.scene import DrawItem, Scene
from .candidates import candidates

Depths = Literal["all through", "front-most", "to a depth"]

_MIN_SHARE = 0.05  # behind one opaque surface a Gaussian has at most this share; overlapping neighbors on it have more


@dataclass(frozen=True)
class DepthMode:
    """Depth reach of a shape, and the test for a hit."""

    depths: Depths = "all through"
    depth_m: float = 20.0
    """Along the view axis from the camera; only used for "to a depth"."""
    touching: bool = False
    """True if a shape also selects Gaussians that it touches within one standard deviation, not only by center."""


ALL_THROUGH = DepthMode()


def select_in_screen_shape(
    scene: Scene, shot: RenderView, pixels: Bool[np.ndarray, "h w"], reach: DepthMode = ALL_THROUGH
) -> dict[str, BitMask]:
    """Find the Gaussians within a shape of the image of `shot`; `pixels` is its mask."""
    if not pixels.any():
        return {}
    depth = reach.depth_m if reach.depths == "to a depth" else np.inf
    find = _touched if reach.touching else _centered
    own = candidates(scene, shot.time_s)
    found = {key: BitMask.of(find(part, shot.camera, pixels, depth)) for key, part in own.items()}
    if reach.depths == "front-most":
        columns, rows = np.flatnonzero(pixels.any(axis=0)), np.flatnonzero(pixels.any(axis=1))
        box = int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1
        for key, shares in visible_shares(scene, shot, box).items():
            if key in found:
                found[key] = found[key] & BitMask.of(shares >= _MIN_SHARE)
    return found


def _centered(
    part: DrawItem, camera: Camera, pixels: Bool[np.ndarray, "h w"], depth_m: float
) -> Bool[np.ndarray, " n"]:
    flags = np.empty(len(part.gaussians), np.bool_)
    to_camera = np.ascontiguousarray((camera.world_to_camera @ part.to_world)[:3])
    intrinsics = float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)
    _find_centers(part.gaussians.means, to_camera, intrinsics, pixels, depth_m, flags)
    return flags


def _touched(part: DrawItem, camera: Camera, pixels: Bool[np.ndarray, "h w"], depth_m: float) -> Bool[np.ndarray, " n"]:
    splats = project([strip_sh(part)], camera)
    touching = np.empty(len(splats), np.bool_)
    _find_ellipses(splats.shapes, splats.colors, pixels, depth_m, touching)
    flags = np.zeros(len(part.gaussians), np.bool_)
    flags[splats.indices[touching]] = True
    return flags


def camera_depths(part: DrawItem, camera: Camera) -> Float64[np.ndarray, " n"]:
    """Depth of each Gaussian along the view axis in meters; negative behind the camera."""
    row = (camera.world_to_camera @ part.to_world)[2]
    return part.gaussians.means @ row[:3] + row[3]


@kernel(error_model="numpy")
@no_type_check
def _find_centers(means, m, intrinsics, pixels, depth, flags):
    """Flag Gaussian centers that project onto flagged pixels, between the near plane and a maximum depth."""
    fx, fy, cx, cy = intrinsics
    height, width = pixels.shape
    for i in range(len(means)):
        x, y, z = means[i, 0], means[i, 1], means[i, 2]
        pz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        flags[i] = False
        if NEAR_M < pz <= depth:
            near = 1 / pz
            u = fx * near * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) + cx
            v = fy * near * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) + cy
            if 0 <= u < width and 0 <= v < height:
                flags[i] = pixels[int(v), int(u)]


@kernel(error_model="numpy")
@no_type_check
def _find_ellipses(shapes, colors, pixels, depth, flags):
    """Flag splats whose center, or one of eight points on their ellipse of one standard deviation, is flagged."""
    height, width = pixels.shape
    for i in range(len(shapes)):
        flags[i] = False
        if not 0 < colors[i, 3] <= depth:
            continue
        reach, shear = np.sqrt(-0.5 / shapes[i, 3]), shapes[i, 2]
        rise = np.sqrt(-0.5 / shapes[i, 4])
        for k in range(9):
            along = 0.0 if k == 8 else np.cos(k * np.pi / 4) * reach
            across = 0.0 if k == 8 else np.sin(k * np.pi / 4) * rise
            u, v = shapes[i, 0] + along, shapes[i, 1] + shear * along + across
            if 0 <= u < width and 0 <= v < height and pixels[int(v), int(u)]:
                flags[i] = True
                break


# Drawn shapes as pixel masks

Point = tuple[float, float]
"""A position in the image: pixels right and down from its upper left corner."""

_SHIFT = 4  # fractional bits of OpenCV's fixed-point coordinates
_FARTHEST = 30_000.0  # clipping distance in pixels: OpenCV's coordinates end at 2^31 / 2^4


def rectangle(first: Point, second: Point, width: int, height: int) -> Bool[np.ndarray, "h w"]:
    """Pixels with centers between two opposite corners, in any order."""
    (left, right), (top, bottom) = (sorted(pair) for pair in zip(first, second, strict=True))
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    return np.logical_and.outer((top <= y) & (y <= bottom), (left <= x) & (x <= right))


def polygon(corners: Sequence[Point], width: int, height: int) -> Bool[np.ndarray, "h w"]:
    """Pixels with centers inside a closed line, by the even-odd rule."""
    # Each edge toggles everything to its right, in the rows that it crosses.
    turns = np.zeros((height, width + 1), np.uint8)
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], *corners[:1]], strict=True):
        low, high = sorted((y0, y1))
        rows = np.arange(*(min(max(math.ceil(y - 0.5), 0), height) for y in (low, high)))
        if len(rows):
            crossings = x0 + (rows + 0.5 - y0) * ((x1 - x0) / (y1 - y0))
            turns[rows, np.clip(np.ceil(crossings - 0.5), 0, width).astype(np.int64)] ^= 1
    return np.ascontiguousarray(np.bitwise_xor.accumulate(turns, axis=1)[:, :width]).view(np.bool_)


def stroke(points: Sequence[Point], radius_px: float, width: int, height: int) -> Bool[np.ndarray, "h w"]:
    """Pixels covered by a disc moved through the points."""
    picture = np.zeros((height, width), np.uint8)
    # OpenCV's fixed-point numbers, where pixel centers are integers
    near = np.clip(np.array(points, np.float64).reshape(-1, 2), -_FARTHEST, _FARTHEST)
    fixed = np.round((near - 0.5) * (1 << _SHIFT)).astype(np.int32)
    radius = max(1, round(radius_px * (1 << _SHIFT)))
    for center in fixed.tolist():
        cv2.circle(picture, center, radius, (1,), cv2.FILLED, shift=_SHIFT)
    for start, end in pairwise(fixed):
        along = (end - start).astype(np.float64)
        length = float(np.hypot(*along))
        if length > 0:  # the band between two discs
            side = radius / length * np.array([-along[1], along[0]])
            corners = np.round([start + side, end + side, end - side, start - side]).astype(np.int32)
            cv2.fillConvexPoly(picture, corners, (1,), shift=_SHIFT)
    return picture.view(np.bool_)


def outlines(pixels: Bool[np.ndarray, "h w"]) -> list[Float64[np.ndarray, "_ 2"]]:
    """Closed lines around the covered pixels and around holes, to half a pixel."""
    found, _ = cv2.findContours(pixels.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_TC89_L1)
    return [line.reshape(-1, 2) + 0.5 for line in found]


# Visible shares

_MAX_PIXELS = 120_000  # of the image for visible shares: coarser than the screen's, and several times faster


def visible_shares(
    scene: Scene, shot: RenderView, box: tuple[int, int, int, int]
) -> dict[str, Float32[np.ndarray, " n"]]:
    """Find the visible share of each Gaussian in a part of the image, 0..1, by keys of visible members.

    With its blending weights w (3DGS, Kerbl et al. 2023) over the pixels, the share is 2 sum w^2 / (opacity sum w). For
    w = T alpha with a T constant over the Gaussian, this equals T, the transmittance of everything nearer. `box`: left,
    top, right, bottom in pixels, the last two exclusive.
    """
    members = [member for member in scene.members if member.visible]
    owned = [(member.key, part) for member in members if (part := scene.part(member, shot.time_s)) is not None]
    weights = color_operator([strip_sh(part) for _, part in owned], _cut_out(shot.camera, box))
    ones = np.ones((weights.tiles.height, weights.tiles.width, 3), np.float32)
    gathered = color_operator_transpose(weights.splats.shapes, ones, weights.tiles)
    sums, squared = gathered[:, 0], gathered[:, 3]  # of each splat's weights, in one pass over the image
    opacities = np.exp(weights.splats.shapes[:, 5])
    shares = np.zeros(sum(len(part.gaussians) for _, part in owned), np.float32)
    is_visible = sums > 0
    visible = 2 * squared[is_visible] / (opacities[is_visible] * sums[is_visible])
    shares[weights.splats.indices[is_visible]] = np.minimum(visible, 1)
    ends = np.cumsum([len(part.gaussians) for _, part in owned])[:-1]
    return {key: own for (key, _), own in zip(owned, np.split(shares, ends), strict=True)}


def _cut_out(camera: Camera, box: tuple[int, int, int, int]) -> Camera:
    """Camera of a part of the image, with a limited number of pixels."""
    left, top, right, bottom = box
    scale = min(1.0, (_MAX_PIXELS / ((right - left) * (bottom - top))) ** 0.5)
    width, height = max(1, round((right - left) * scale)), max(1, round((bottom - top) * scale))
    across, down = width / (right - left), height / (bottom - top)
    cx, cy = (camera.cx - left) * across, (camera.cy - top) * down
    return replace(camera, width=width, height=height, fx=camera.fx * across, fy=camera.fy * down, cx=cx, cy=cy)


def strip_sh(part: DrawItem) -> DrawItem:
    """Return a gray item, for tests of position only: harmonics are most of a scene's memory; zeros use none yet."""
    count = len(part.gaussians)
    return part._replace(gaussians=part.gaussians.with_sh(np.zeros((count, 1, 3), np.float32)), colors=None)
