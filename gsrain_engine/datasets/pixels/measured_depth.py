"""What a capture knows of the distance to the static scene: depth pictures, lidar, or points on surfaces."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float32

from ..capture import Capture, Sweep, TrackedBox, View
from ..geometry.lidar_depth import lidar_depth
from .completed_depth import completed_depth
from .moving_masks import inside_box, moving_boxes
from .road_plane import road_depth, road_drop

_MOST_SWEEPS = 9
"""So many sweeps, the nearest in time, tell a view's depth: more find more, until poses drift."""
_MARGIN_M = 0.15


def static_sweeps(capture: Capture, moving: Sequence[TrackedBox] | None = None) -> tuple[Sweep, ...]:
    """Return the lidar sweeps without the points on what moves, which would lie elsewhere in every view."""
    moving = moving_boxes(capture) if moving is None else moving
    return tuple(_without(sweep, moving) for sweep in capture.sweeps)


def _without(sweep: Sweep, moving: Sequence[TrackedBox]) -> Sweep:
    points = sweep.points_m.astype(np.float64)
    static = np.ones(len(points), np.bool_)
    for box in moving:
        static &= ~inside_box(points, box, sweep.time_s, _MARGIN_M)
    kept = None if sweep.intensities is None else sweep.intensities[static]
    return replace(sweep, points_m=sweep.points_m[static], intensities=kept)


def measured_depths(
    capture: Capture, views: Sequence[View], sweeps: Sequence[Sweep] | None = None
) -> list[Float32[np.ndarray, "_ _"]]:
    """Depth along the view axis in each view, 0 where nothing was measured.

    The view's own depth where it has one, else lidar, else the capture's points; all 0 where there is none of them.
    What moves is left out, see `static_sweeps`, which `sweeps` are.
    """
    sweeps = static_sweeps(capture) if sweeps is None else sweeps
    if not sweeps and capture.points_m is not None and len(capture.points_m):
        sweeps = (Sweep(0.0, capture.points_m.astype(np.float32), np.zeros(3)),)
    depths: list[Float32[np.ndarray, "_ _"]] = []
    for view in views:
        own = view.depth
        if own is None and sweeps:
            nearest = sorted(sweeps, key=lambda sweep: abs(sweep.time_s - view.time_s))[:_MOST_SWEEPS]
            own = lidar_depth(view, nearest)
        depths.append(np.zeros((view.camera.height, view.camera.width), np.float32) if own is None else own)
    return depths


def completed_depths(
    capture: Capture,
    views: Sequence[View],
    measured: Sequence[Float32[np.ndarray, "_ _"]],
    skies: Sequence[Bool[np.ndarray, "_ _"]] | None = None,
) -> list[Float32[np.ndarray, "_ _"]]:
    """Depth of all pixels but the sky's, from `measured_depths`; all 0 where there was nothing.

    Depth pictures of a view's own are whole as they are.

    A plane stands in for the road where only triangulated points are known, which roads have few of.
    """
    drop = None
    if not capture.sweeps and capture.points_m is not None and len(capture.points_m):
        drop = road_drop(capture.points_m, views, capture.up)
    completed: list[Float32[np.ndarray, "_ _"]] = []
    for view, depth, sky in zip(views, measured, skies or [None] * len(views), strict=True):
        if view.depth_source is not None:  # a depth camera, or a mesh: it tells all there is
            completed.append(depth if sky is None else np.where(sky, np.float32(0), depth))
        else:
            road = None if drop is None else road_depth(view.camera, drop, capture.up)
            completed.append(completed_depth(depth, sky, road))
    return completed
