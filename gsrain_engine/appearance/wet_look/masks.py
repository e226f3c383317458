"""Surface masks: shares of ground, plants, walls and vehicles per pixel, and the visible ground."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64

from ..base import ClearView, Image, Plane
from ..normals import view_rays, world_points
from .ground_plane import GroundHeights, GroundPlane, refine_plane

_SMOOTH_SHARE = 0.01  # smoothing of normals as a share of the image width, since normals of real scenes are rough
NEAR_GROUND_M, _DEPTH_NOISE = 0.2, 0.008
"""Height up to which a surface counts as ground: fixed part in meters, and additional height per meter of distance."""
_UP, _AGREEING = (0.35, 0.8), (0.75, 0.95)
"""Ramps of the upward normal component of rain-exposed surfaces, and of the mean normal's length for confidence."""
AMONG_LEAVES = (0.25, 0.6)  # ramp of the share of leaves around a pixel from which it counts as a leaf itself
UP_ELSEWHERE = 0.8  # wetness of level surfaces off the ground: ledges and roofs drain


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceShares:
    """Shares of surface classes per pixel, with positions and normals."""

    points: Image
    """World position, meters."""
    normals: Image
    """Smoothed locally, unit or 0."""
    up_facing: Plane
    """Exposure to rain from above, 0 to 1."""
    ground: Plane
    plants: Plane
    """Leaves and grass, on the ground or not."""
    vehicles: Plane
    """Without ground shadows, which scenes assign to vehicles."""


# Visible ground. World frame, meters.


@dataclass(frozen=True, slots=True, eq=False)
class VisibleGround:
    """Ground in a view. Where `share` is 0, the other maps except `above_m` are undefined."""

    plane: GroundPlane
    """Plane fitted to the visible ground, dominated by nearby ground."""
    share: Plane
    """Share of ground in each pixel, 0..1."""
    above_m: Plane
    """Height of each pixel's surface over the ground; valid wherever depth is known."""
    points_m: Float64[np.ndarray, "h w 3"]
    """Intersection of each pixel's ray with the smooth ground, in the world."""
    normals: Image
    """Normals of the smooth ground: unit, upwards."""
    sunk_m: Plane
    """Depth of each point below its surroundings."""


def surfaces_of(view: ClearView, ground: VisibleGround | None = None) -> SurfaceShares:
    """Classify surfaces by color, normals and, if known, height above the ground."""
    points = world_points(view.depth, view.camera).astype(np.float32)
    sigma_px = max(1.0, _SMOOTH_SHARE * view.camera.width)
    normals, sure = _smoothed(view.normals, sigma_px)
    up_facing = level = smoothstep(*_UP, normals[..., 2]) * sure
    if ground is not None:  # by height alone: normals of real scenes are rough
        slack = NEAR_GROUND_M + _DEPTH_NOISE * view.depth
        level = (1 - smoothstep(0.5, 1.5, np.abs(ground.above_m) / slack)) * (view.depth > 0)
        up_facing = np.maximum(UP_ELSEWHERE * up_facing, level)
    vehicles = view.vehicles * (1 - level)
    plants = vegetation_mask(view.image)
    # Dark gaps between leaves count as leaves, except on the ground.
    gaps = smoothstep(*AMONG_LEAVES, cv2.GaussianBlur(plants, (0, 0), sigma_px)) * (1 - level)
    return SurfaceShares(points, normals, up_facing, level, np.maximum(plants, gaps) * (1 - vehicles), vehicles)


def _smoothed(normals: Image, sigma_px: float) -> tuple[Image, Plane]:
    """Smoothed normals, unit or 0, and their confidence: the agreement of the averaged normals."""
    there = (np.abs(normals).sum(axis=-1) > 0).astype(np.float32)
    mean = cv2.GaussianBlur(normals, (0, 0), sigma_px)
    length = np.linalg.norm(mean, axis=-1).astype(np.float32)
    sure = smoothstep(*_AGREEING, length / np.maximum(cv2.GaussianBlur(there, (0, 0), sigma_px), 1e-3)) * there
    return there[..., None] * mean / np.maximum(length, 1e-6)[..., None], sure


def vegetation_mask(image: Float32[np.ndarray, "*n 3"]) -> Float32[np.ndarray, "*n"]:
    """Likeness of a display color to leaves and grass, 0..1: greener than blue and than a warm gray."""
    red, green, blue = (image[..., i] for i in range(3))
    brightest = np.maximum(image.max(axis=-1), 1e-3)
    return smoothstep(0.08, 0.3, (green - blue) / brightest) * smoothstep(-0.06, 0.06, (green - red) / brightest)


def smoothstep(low: float, high: float, x: Float[np.ndarray, "*n"]) -> Float32[np.ndarray, "*n"]:
    """Rise smoothly from 0 at `low` to 1 at `high`."""
    t = np.clip((x - low) / (high - low), 0, 1).astype(np.float32)
    return t * t * (3 - 2 * t)


_NEAR_M, _NOISE_SHARE = 0.12, 0.006
"""Largest error of a pixel's height: fixed part in meters, and additional error per meter of distance."""
_MIN_UP = (0.35, 0.6)  # ramp of the upward component of a ground surface's normal
_SCATTER = 1.5  # factor of the ground points' scatter in the height tolerance
_ROUGH_UP = 6.0  # decrease of the ramp `_MIN_UP` per meter of scatter, since normals from rough depth are unreliable
_SMOOTH_GROUND_SHARE = 0.008  # smoothing of normals, as a share of the image width
_GRASSY = (0.05, 0.4)
"""Share of leaves around a ground pixel from which it reflects less, and from which it reflects nothing."""
_MIN_PIXELS = 64
_STEPS = 3
_FARTHEST = 0.35  # largest move of a pixel's point onto the smooth ground, as a share of its depth


def find_visible_ground(view: ClearView, heights: GroundHeights, start: GroundPlane) -> VisibleGround | None:
    """Find the ground in a view by the height map; None if the view shows hardly any."""
    points = world_points(view.depth, view.camera)
    rays, normals = view_rays(view.camera), heights.normals(points)
    above = points[..., 2] - heights.sampled(heights.fine_m, points)
    near = _NEAR_M + _SCATTER * heights.scatter_m + _NOISE_SHARE * view.depth
    low, high = (each - _ROUGH_UP * heights.scatter_m for each in _MIN_UP)
    level = 1 - smoothstep(0.5, 1.5, np.abs(above) / near)
    sigma = max(1.0, _SMOOTH_GROUND_SHARE * view.camera.width)
    up = cv2.GaussianBlur(np.sum(view.normals * normals, axis=-1), (0, 0), sigma)
    plants = smoothstep(*_GRASSY, cv2.GaussianBlur(vegetation_mask(view.image), (0, 0), sigma))
    share = level * smoothstep(low, high, up) * (1 - plants) * (view.depth > 0) * (1 - view.sky)
    share *= 1 - view.vehicles * (1 - level)  # scenes assign the shadows under vehicles to them
    share *= np.sum(rays * normals, axis=-1) < 0
    visible = share > 0.5
    if np.count_nonzero(visible) < _MIN_PIXELS:
        return None
    # Intersect rays with the smooth ground: reflections need it instead of the bumpy depth.
    farthest = (_FARTHEST * view.depth).astype(np.float64)
    moved = np.zeros_like(farthest)
    for _ in range(_STEPS):
        there = points + moved[..., None] * rays
        over = there[..., 2] - heights.sampled(heights.smooth_m, there)
        moved = np.clip(moved - over / np.minimum(rays[..., 2], -1e-2), -farthest, farthest)
    on_ground = points + moved[..., None] * rays
    share *= 1 - smoothstep(0.5, 1.0, np.abs(moved) / np.maximum(farthest, 1e-6))
    share = cv2.blur(cv2.medianBlur(share.astype(np.float32), 5), (3, 3)) * (view.depth > 0)
    few = on_ground[visible][:: max(1, np.count_nonzero(visible) // 20000)]
    plane = refine_plane(start, few, float(near[visible].mean()))
    sunk_m = heights.sampled(heights.sunk_m, on_ground)
    return VisibleGround(plane, share, above.astype(np.float32), on_ground, heights.normals(on_ground), sunk_m)
