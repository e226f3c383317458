"""Actors to begin a training with: what lidar saw of each moving thing, gathered in the thing's own frame."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float32, Float64

from gsrain_engine.datasets.capture import Capture, TrackedBox, View
from gsrain_engine.datasets.geometry.lidar_depth import lidar_depth
from gsrain_engine.datasets.pixels.completed_depth import completed_depth
from gsrain_engine.datasets.pixels.moving_masks import box_outline, can_move, inside_box, moves
from gsrain_engine.scene.members import Actor

from .initial_gaussians import SURFACE_OPACITY, round_gaussians
from .point_colors import point_colors

LEAST_POINTS = 60
"""Lidar points that an actor needs: fewer are a cloud, not a shape."""
_MARGIN_M = 0.1
_LIFT_M = 0.12
"""Points lower than this in the box may be of the road."""
_LEAST_SPACING_M = 0.04
_MOST_VIEWS = 24


def actor_layers(capture: Capture, views: Sequence[View], least_points: int = LEAST_POINTS) -> tuple[Actor, ...]:
    """Make an actor of each moving vehicle or person that lidar saw enough of, on the track of its box.

    Its points are those of all sweeps, in its own frame, where it has the same place in each; vehicles are completed
    by their mirror image, since one side is seldom seen. Colours are those of the views that see it, at their times.

    Args:
        capture: With sweeps and boxes; without either there are no actors.
        views: Without distortion.
        least_points: Things with fewer are left out.
    """
    actors: list[Actor] = []
    for box in capture.boxes:
        if not (can_move(box) and moves(box)):
            continue
        points = points_of_box(capture, box)
        if len(points) < least_points:
            continue
        points, is_mirrored = _with_mirror_image(points)
        colors, seen = _colors(capture, box, points, views)
        if not seen.any():
            continue
        partner = np.where(is_mirrored, np.arange(len(points)) - is_mirrored.argmax(), -1)
        borrowed = ~seen & (partner >= 0)  # what no view shows looks like the other side
        colors[borrowed] = colors[partner[borrowed]]
        known = seen | (borrowed & seen[partner])
        colors[~known] = np.median(colors[known], axis=0)
        gaussians = round_gaussians(points, colors, SURFACE_OPACITY)
        actors.append(
            Actor(id=box.id, class_name=box.class_name, size_lwh=box.size_lwh, gaussians=gaussians, track=box.track)
        )
    return tuple(actors)


def points_of_box(capture: Capture, box: TrackedBox) -> Float64[np.ndarray, "p 3"]:
    """Lidar points on a thing in its own frame (x forward, y left, z up, origin at the bottom centre), thinned."""
    found = [np.zeros((0, 3))]
    for sweep in capture.sweeps:
        pose = box.track.pose(sweep.time_s)
        if pose is not None:
            points = sweep.points_m.astype(np.float64)
            local = (points[inside_box(points, box, sweep.time_s, _MARGIN_M)] - pose[:3, 3]) @ pose[:3, :3]
            found.append(local[local[:, 2] > _LIFT_M])
    return _thinned(np.concatenate(found))


def _thinned(points: Float64[np.ndarray, "p 3"]) -> Float64[np.ndarray, "q 3"]:
    """One point a cell of the least spacing, the first."""
    _, first = np.unique(np.floor(points / _LEAST_SPACING_M).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(first)]


def _with_mirror_image(points: Float64[np.ndarray, "p 3"]) -> tuple[Float64[np.ndarray, "q 3"], Bool[np.ndarray, " q"]]:
    """Append each point's mirror image across the thing's plane of symmetry."""
    both = np.concatenate([points, points * [1, -1, 1]])
    return both, np.arange(len(both)) >= len(points)


def _colors(
    capture: Capture, box: TrackedBox, points: Float64[np.ndarray, "p 3"], views: Sequence[View]
) -> tuple[Float32[np.ndarray, "p 3"], Bool[np.ndarray, " p"]]:
    """Colours from the views that see the box, each brought into the thing's own frame at its time."""
    own: list[View] = []
    depths: list[Float32[np.ndarray, "_ _"]] = []
    seen = [view for view in views if len(box_outline(view, box))]
    seen.sort(key=lambda view: float(np.linalg.norm(_pose(box, view)[:3, 3] - view.camera.position)))
    for view in seen[:_MOST_VIEWS]:
        nearest = min(capture.sweeps, key=lambda sweep: abs(sweep.time_s - view.time_s))
        own.append(replace(view, camera=view.camera.moved(np.linalg.inv(_pose(box, view))), mask_source=None))
        depths.append(completed_depth(lidar_depth(view, [nearest])))
    if not own:
        return np.full((len(points), 3), 0.5, np.float32), np.zeros(len(points), np.bool_)
    return point_colors(points, own, depths)


def _pose(box: TrackedBox, view: View) -> Float64[np.ndarray, "4 4"]:
    pose = box.track.pose(view.time_s)
    assert pose is not None  # only views in which the box is there come here
    return pose
