"""Depth priors for training: measured depth, completed depth, sky masks, and the road plane."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64
from scipy.ndimage import distance_transform_edt, minimum_filter1d
from scipy.spatial import Delaunay, KDTree, QhullError

from ..scene.camera import Camera
from .capture import Capture, CaptureFrame, LidarSweep, TrackedBox
from .geometry import lidar_depth
from .masks import moving_boxes, pixel_rays, points_in_box
from .sky_masks import sky_masks


@dataclass(frozen=True, slots=True, eq=False)
class DepthPriors:
    """Maps of the depth along the view axis and of the sky, one a view."""

    measured: tuple[Float32[np.ndarray, "_ _"], ...]
    """0 without a measurement; without moving objects."""
    completed: tuple[Float32[np.ndarray, "_ _"], ...]
    """0 in the sky and where undetermined."""
    skies: tuple[Bool[np.ndarray, "_ _"], ...]

    @property
    def median_depth(self) -> float:
        """Median of the measured depths; 0 without any."""
        known = np.concatenate([np.zeros(0, np.float32), *(depth[depth > 0] for depth in self.measured)])
        return float(np.median(known)) if len(known) else 0.0

    def of(self, indices: Iterable[int]) -> "DepthPriors":
        chosen = list(indices)
        return DepthPriors(*(tuple(all_[i] for i in chosen) for all_ in (self.measured, self.completed, self.skies)))


def depth_priors(capture: Capture, views: Sequence[CaptureFrame]) -> DepthPriors:
    """Compute priors of some undistorted views of a capture."""
    measured = measured_depths(capture, views)
    skies = sky_masks(views, measured, capture.up)
    completed = completed_depths(capture, views, measured, skies)
    return DepthPriors(tuple(measured), tuple(completed), tuple(skies))


# Measured depth

_MAX_SWEEPS = 9
"""Maximum number of sweeps, nearest in time, for a view's depth: more sweeps fill more pixels until poses drift."""

_MARGIN_M = 0.15


def static_sweeps(capture: Capture) -> tuple[LidarSweep, ...]:
    """Return the lidar sweeps without points on moving objects, whose positions differ between views."""
    moving = moving_boxes(capture)
    return tuple(_without(sweep, moving) for sweep in capture.sweeps)


def _without(sweep: LidarSweep, moving: Sequence[TrackedBox]) -> LidarSweep:
    points = sweep.points_m.astype(np.float64)
    static = np.ones(len(points), np.bool_)
    for box in moving:
        static &= ~points_in_box(points, box, sweep.time_s, _MARGIN_M)
    kept = None if sweep.intensities is None else sweep.intensities[static]
    return replace(sweep, points_m=sweep.points_m[static], intensities=kept)


def measured_depths(
    capture: Capture, views: Sequence[CaptureFrame], sweeps: Sequence[LidarSweep] | None = None
) -> list[Float32[np.ndarray, "_ _"]]:
    """Depth along the view axis in each view, 0 without a measurement.

    Takes the view's own depth, otherwise lidar, otherwise the capture's points; all 0 without any of them. Excludes
    moving objects; `sweeps` default to `static_sweeps`.
    """
    sweeps = static_sweeps(capture) if sweeps is None else sweeps
    if not sweeps and capture.points_m is not None and len(capture.points_m):
        sweeps = (LidarSweep(0.0, capture.points_m.astype(np.float32), np.zeros(3)),)
    depths: list[Float32[np.ndarray, "_ _"]] = []
    for view in views:
        own = view.depth
        if own is None and sweeps:
            nearest = sorted(sweeps, key=lambda sweep: abs(sweep.time_s - view.time_s))[:_MAX_SWEEPS]
            own = lidar_depth(view, nearest)
        depths.append(np.zeros((view.camera.height, view.camera.width), np.float32) if own is None else own)
    return depths


def completed_depths(
    capture: Capture,
    views: Sequence[CaptureFrame],
    measured: Sequence[Float32[np.ndarray, "_ _"]],
    skies: Sequence[Bool[np.ndarray, "_ _"]] | None = None,
) -> list[Float32[np.ndarray, "_ _"]]:
    """Depth of all pixels but the sky's, from `measured_depths`; all 0 without measurements.

    Keeps a view's own depth image unchanged. With triangulated points only, sparse on roads, a plane represents the
    road.
    """
    drop = None
    if not capture.sweeps and capture.points_m is not None and len(capture.points_m):
        drop = camera_height_above_road(capture.points_m, views, capture.up)
    completed: list[Float32[np.ndarray, "_ _"]] = []
    for view, depth, sky in zip(views, measured, skies or [None] * len(views), strict=True):
        if view.depth_source is not None:  # a depth camera or a mesh has no gaps to fill
            completed.append(depth if sky is None else np.where(sky, np.float32(0), depth))
        else:
            road = None if drop is None else road_depth(view.camera, drop, capture.up)
            completed.append(completed_depth(depth, sky, road))
    return completed


# Completion of sparse depth, so that every pixel below the sky has an initial surface

_LARGEST_RATIO = 1.25  # maximum ratio of the depths of a triangle's corners on one surface
_LONGEST_EDGE = 0.12  # maximum edge of a valid triangle, as a fraction of the image width
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_FOOT = 0.12  # fraction of the rows above the lowest depth that determine the plane continued below it


def completed_depth(
    sparse_m: Float32[np.ndarray, "h w"],
    sky: Bool[np.ndarray, "h w"] | None = None,
    road_m: Float32[np.ndarray, "h w"] | None = None,
) -> Float32[np.ndarray, "h w"]:
    """Depth along the view axis at all pixels but the sky's, in the unit of `sparse_m`; 0 if undetermined.

    Inverse depth is interpolated linearly over Delaunay triangles, which is exact on planes; triangles that bridge two
    surfaces take the nearest point. Below the lowest points the road plane is continued; above the highest, surfaces
    are assumed to be upright, with the depth of the point below.

    Args:
        sparse_m: Measured depth, 0 if unknown.
        sky: Pixels that have no depth.
        road_m: Depth of the road in each pixel if known better than from this view's measurements (see
            `road_depth`); it limits all extrapolated depths.
    """
    rows, columns = np.nonzero(sparse_m > 0)
    if len(rows) < 3:
        return np.zeros_like(sparse_m)
    depth, interpolated = _between(sparse_m, rows, columns)
    if road_m is None:
        depth = _above(_below(depth))
    else:
        depth = _above(depth)
        depth = np.where(interpolated, depth, np.minimum(depth, road_m))
    if sky is not None:
        depth[sky] = 0
    return depth


def _between(
    sparse: Float32[np.ndarray, "h w"], rows: np.ndarray, columns: np.ndarray
) -> tuple[Float32[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Depth inside the mesh of the measured pixels, 0 elsewhere; and a mask of pixels interpolated on one surface."""
    surrounded = cv2.erode((sparse > 0).astype(np.uint8), _CROSS, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    needed = ~surrounded[rows, columns]  # triangles at the others are half a pixel's square
    corners, values = np.stack([rows, columns], axis=1)[needed], sparse[rows, columns][needed].astype(np.float64)
    try:
        mesh = Delaunay(corners.astype(np.float64))
    except QhullError:  # all points on one line
        return sparse.copy(), sparse > 0
    believed, reaches = _believed(mesh, values, _LONGEST_EDGE * sparse.shape[1])
    chosen = np.concatenate([np.flatnonzero(reaches & ~believed), np.flatnonzero(believed)])  # the last take the edges
    members, is_believed = mesh.simplices[chosen], believed[chosen]
    triangle, row, column = _pixels_of(corners[members])
    weights = _barycentric(corners[members], triangle, np.stack([row, column], axis=1))
    found = values[members[triangle, weights.argmax(axis=1)]]
    on_one = is_believed[triangle]
    found[on_one] = 1 / (weights[on_one] / values[members[triangle[on_one]]]).sum(axis=1)
    depth, interpolated = np.zeros_like(sparse), surrounded
    depth[row, column] = found
    interpolated[row, column] |= on_one
    return np.where(sparse > 0, sparse, depth), interpolated


def _believed(
    mesh: Delaunay, values: Float64[np.ndarray, " p"], longest: float
) -> tuple[Bool[np.ndarray, " t"], Bool[np.ndarray, " t"]]:
    """Masks of triangles on one surface, and of triangles small enough to be used."""
    corners, depths = mesh.points[mesh.simplices], values[mesh.simplices]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    reaches = edges <= longest
    return reaches & (depths.max(axis=1) <= _LARGEST_RATIO * depths.min(axis=1)), reaches


def _pixels_of(corners: Int64[np.ndarray, "t 3 2"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangle, row and column of each pixel on triangles or their edges, by triangles, from (row, column) corners."""
    top, bottom = corners[..., 0].min(axis=1), corners[..., 0].max(axis=1)
    triangle, row = _counted_up(top, bottom)
    first, last = corners[triangle, :, 1].max(axis=1), corners[triangle, :, 1].min(axis=1)
    for i in range(3):
        start, end = corners[triangle, i - 1], corners[triangle, i]
        down, across = (end - start).T
        crosses = (
            (down != 0) & (np.minimum(start[:, 0], end[:, 0]) <= row) & (row <= np.maximum(start[:, 0], end[:, 0]))
        )
        steps = (row - start[:, 0]) * across * np.sign(down)
        size = np.maximum(np.abs(down), 1)
        first = np.where(crosses, np.minimum(first, start[:, 1] - -steps // size), first)
        last = np.where(crosses, np.maximum(last, start[:, 1] + steps // size), last)
    span, column = _counted_up(first, last)
    return triangle[span], row[span], column


def _counted_up(first: Int64[np.ndarray, " n"], last: Int64[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
    """Index and value of all whole numbers of ranges, ends included; a range may be empty."""
    counts = np.maximum(last - first + 1, 0)
    index = np.repeat(np.arange(len(counts)), counts)
    return index, np.arange(len(index)) - (np.cumsum(counts) - counts - first)[index]


def _barycentric(
    corners: Int64[np.ndarray, "t 3 2"], triangle: Int64[np.ndarray, " p"], at: Int64[np.ndarray, "p 2"]
) -> Float64[np.ndarray, "p 3"]:
    """Weights of the corners of each pixel's triangle."""
    first, second = (corners[:, 1:] - corners[:, :1]).transpose(1, 0, 2)
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    offset = at - corners[triangle, 0]
    b = (offset[:, 0] * second[triangle, 1] - offset[:, 1] * second[triangle, 0]) / area[triangle]
    c = (first[triangle, 0] * offset[:, 1] - first[triangle, 1] * offset[:, 0]) / area[triangle]
    return np.stack([1 - b - c, b, c], axis=1)


def _below(depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Continue the plane of the lowest measured rows, fitted over the whole width, to the lower edge."""
    height, width = depth.shape
    known = depth > 0
    lowest = np.where(known.any(axis=0), height - 1 - known[::-1].argmax(axis=0), -1)
    row = np.arange(height)[:, None]
    near_foot = known & (row > lowest[None, :] - _FOOT * height)
    if near_foot.sum() < 30:
        return depth
    v, u = np.nonzero(near_foot)
    system = np.stack([u / width, v / height, np.ones(len(u))], axis=1)
    inverse = 1.0 / depth[v, u]
    use, plane = np.ones(len(u), np.bool_), np.zeros(3)
    for _ in range(4):  # rejects objects on the road
        plane = np.linalg.lstsq(system[use], inverse[use], rcond=None)[0]
        residual = np.abs(system @ plane - inverse)
        use = residual <= max(2.0 * float(np.median(residual[use])), 1e-6)
    if plane[1] <= 0:  # not a ground plane, whose depth decreases downward
        return depth
    whole = plane[0] * np.arange(width)[None, :] / width + plane[1] * row / height + plane[2]
    fill = ~known & (row > lowest[None, :]) & (whole > inverse.min())
    return np.where(fill, 1 / np.where(fill, whole, 1), depth).astype(np.float32)


def _above(depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Extend the highest depth of each column upright to the upper edge; gaps take the nearest known depth."""
    height, width = depth.shape
    known = depth > 0
    if not known.any():
        return depth
    top = np.where(known.any(axis=0), known.argmax(axis=0), height)
    at_top = np.where(top < height, depth[np.minimum(top, height - 1), np.arange(width)], np.inf)
    at_top = minimum_filter1d(at_top, max(width // 60, 3))
    upright = np.broadcast_to(at_top.astype(np.float32), depth.shape)
    is_above = (np.arange(height)[:, None] < top[None, :]) & np.isfinite(upright)
    filled = np.where(is_above & ~known, upright, depth)
    nearest = np.asarray(distance_transform_edt(filled <= 0, return_distances=False, return_indices=True))
    return filled[nearest[0], nearest[1]].astype(np.float32)


# Road plane

_LOWEST = 0.03  # fraction of the points near the cameras that lie below the road because of triangulation errors
_MIN_POINTS = 50


def camera_height_above_road(
    points: Float64[np.ndarray, "p 3"], views: Sequence[CaptureFrame], up: tuple[float, float, float]
) -> float | None:
    """Height of the cameras above the road in the world's unit, from the lowest points near them.

    None if there are too few points, or none below the cameras.
    """
    eyes = np.array([view.camera.position for view in views])
    distance, nearest = KDTree(eyes).query(points)
    near = distance <= 2 * np.median(distance)
    below = (eyes[nearest] - points)[near] @ (np.array(up) / np.linalg.norm(up))
    if len(below) < _MIN_POINTS:
        return None
    drop = float(np.quantile(below, 1 - _LOWEST))
    return drop if drop > 0 else None


def road_depth(camera: Camera, drop: float, up: tuple[float, float, float]) -> Float32[np.ndarray, "h w"]:
    """Depth along the view axis of the plane at distance `drop` below the camera; inf above the horizon."""
    falling = -(pixel_rays(camera) @ (np.array(up) / np.linalg.norm(up)))
    return np.where(falling > 1e-3, drop / np.maximum(falling, 1e-3), np.inf).astype(np.float32)
