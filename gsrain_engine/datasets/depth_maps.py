"""Depth priors for training: measured depth, completed depth, sky masks, and the road plane."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64
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
    depth, told = _between(sparse_m, rows, columns)
    if road_m is None:
        depth = _above(_below(depth))
    else:
        depth = _above(depth)
        depth = np.where(told, depth, np.minimum(depth, road_m))
    if sky is not None:
        depth[sky] = 0
    return depth


def _between(
    sparse: Float32[np.ndarray, "h w"], rows: np.ndarray, columns: np.ndarray
) -> tuple[Float32[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Depth inside the mesh of the measured pixels, 0 elsewhere; and a mask of pixels interpolated on one surface."""
    height, width = sparse.shape
    values = sparse[rows, columns].astype(np.float64)
    corners = np.stack([columns, rows], axis=1).astype(np.float64)
    try:
        mesh = Delaunay(corners)
    except QhullError:  # all points on one line
        return sparse.copy(), sparse > 0
    at = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(np.float64)
    triangle = mesh.find_simplex(at)
    inside = np.flatnonzero(triangle >= 0)
    believed, reaches = _believed(mesh, values, _LONGEST_EDGE * width)
    tri = triangle[inside]
    members = mesh.simplices[tri]
    weights = _barycentric(mesh, tri, at[inside])
    linear = 1 / np.maximum((weights / values[members]).sum(axis=1), 1e-9)
    nearest = values[members[np.arange(len(tri)), weights.argmax(axis=1)]]
    depth = np.zeros(height * width)
    depth[inside] = np.where(believed[tri], linear, np.where(reaches[tri], nearest, 0))
    told = np.zeros(height * width, np.bool_)
    told[inside] = believed[tri]
    return depth.reshape(height, width).astype(np.float32), told.reshape(height, width)


def _believed(
    mesh: Delaunay, values: Float64[np.ndarray, " p"], longest: float
) -> tuple[Bool[np.ndarray, " t"], Bool[np.ndarray, " t"]]:
    """Masks of triangles on one surface, and of triangles small enough to be used."""
    corners, depths = mesh.points[mesh.simplices], values[mesh.simplices]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    reaches = edges <= longest
    return reaches & (depths.max(axis=1) <= _LARGEST_RATIO * depths.min(axis=1)), reaches


def _barycentric(mesh: Delaunay, triangle: np.ndarray, at: Float64[np.ndarray, "p 2"]) -> Float64[np.ndarray, "p 3"]:
    turn = mesh.transform[triangle]
    first = np.einsum("pij,pj->pi", turn[:, :2], at - turn[:, 2])
    return np.clip(np.concatenate([first, 1 - first.sum(axis=1, keepdims=True)], axis=1), 0, 1)


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
