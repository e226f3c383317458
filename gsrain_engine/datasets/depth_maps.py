"""Depth priors for training: measured depth, completed depth, sky masks, and the road plane."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.spatial import KDTree

from ..scene.camera import Camera
from .capture import Capture, CaptureFrame, LidarSweep, TrackedBox
from .completed_depth import completed_depth
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


def static_sweeps(capture: Capture, moving: Sequence[TrackedBox] | None = None) -> tuple[LidarSweep, ...]:
    """Return the lidar sweeps without points on moving objects, whose positions differ between views."""
    moving = moving_boxes(capture) if moving is None else moving
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
