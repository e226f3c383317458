"""Check of a capture's poses against its lidar, and against matches between neighboring views.

A wrong convention (inverted matrices, OpenGL's axes, swapped cameras) prevents sharp reconstructions.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, TypeVar

import numpy as np
from jaxtyping import Float64

from . import pose_fit
from .capture import Capture, CaptureError, CaptureFrame
from .geometry import Pose, invert_pose, nearest_sweep
from .pose_fit import EdgeImage, EpipolarFit, FeatureMatches, ImageFeatures

# Results

Verdict = Literal["fits", "wrong", "doubtful"]


@dataclass(frozen=True, slots=True)
class PoseCheck:
    """Result of one check of one camera's poses."""

    sensor: str
    by: Literal["matches", "lidar"]
    verdict: Verdict
    """`wrong`: a common mistake explains the misfit. `doubtful`: the poses don't fit, and no common mistake does."""
    figure: float
    """Share of matches explained; or standard deviations above rotated poses."""
    expected: float
    """Minimum figure of a correct pose."""
    told: str
    """The finding as one sentence with its figures."""


def check_by_lidar(capture: Capture, sensor: str) -> PoseCheck | None:
    """Check that depth edges coincide with image edges; None if no sweep is near the camera's times."""
    seen = _sweep_pairs(capture, [view for view in capture if view.sensor == sensor])
    if not seen:
        return None
    views = [each.view for each in seen]
    figure = _stands_out(seen, _poses(views))
    others = {told: _stands_out(seen, poses) for told, poses in hypotheses(capture, views).items()}
    finding = (
        f"edges in the lidar's depth meet edges of the pictures {figure:.1f} standard deviations better than under "
        f"turned poses (expected over {STANDS_OUT:g}; views: {len(seen)})"
    )
    return _concluded(sensor, "lidar", figure, STANDS_OUT, others, STANDS_OUT + 2 / np.sqrt(len(seen)), finding)


def check_by_matches(capture: Capture, sensor: str) -> PoseCheck | None:
    """Check one camera by matches between its views; None with too few, or if the camera did not move."""
    pairs = _matched_pairs([view for view in capture if view.sensor == sensor])
    if not pairs:
        return None
    views = [view for first, second, _ in pairs for view in (first, second)]
    fits = _fits(pairs, _poses(views))
    explained = _explained(pairs, fits)
    others = {told: _explained(pairs, _fits(pairs, poses)) for told, poses in hypotheses(capture, views).items()}
    smaller = min(pose_fit.MATCH_WIDTH_PX, views[0].camera.width) / views[0].camera.width
    error_px = float(np.median([each.median_px for each in fits])) / smaller
    finding = (
        f"the poses explain {explained:.0%} of {sum(_sizes(pairs))} points matched between neighboring views "
        f"(expected over {EXPLAINED:.0%}), median epipolar error {error_px:.1f} px"
    )
    return _concluded(sensor, "matches", explained, EXPLAINED, others, EXPLAINED, finding)


def _concluded(
    sensor: str,
    by: Literal["matches", "lidar"],
    figure: float,
    expected: float,
    others: Mapping[str, float],
    convincing: float,
    finding: str,
) -> PoseCheck:
    """Result of a check; `others` are the figures under each mistake, and one that reaches `convincing` is accepted."""
    best = max(others, key=lambda told: others[told])
    verdict: Verdict = "doubtful"
    why = ": the poses or the calibration are wrong, and no usual mistake explains it."
    if figure >= expected:
        verdict, why = "fits", "."
    elif others[best] >= max(convincing, figure):
        verdict, why = "wrong", f": {best}."
    return PoseCheck(sensor, by, verdict, figure, expected, f"{sensor or 'the camera'}: {finding}{why}")


def check_poses(capture: Capture, on_progress: Callable[[float], None] | None = None) -> tuple[PoseCheck, ...]:
    """Check each camera by all available means; empty without poses or comparable data.

    `on_progress` is called with the completed fraction.
    """
    if not capture.has_poses:
        return ()
    checks: list[PoseCheck] = []
    for k, sensor in enumerate(capture.sensors, 1):
        found = (check(capture, sensor) for check in (check_by_matches, check_by_lidar))
        checks += [each for each in found if each is not None]
        if on_progress is not None:
            on_progress(k / len(capture.sensors))
    return tuple(checks)


STANDS_OUT = 1.5
"""Minimum fit of a correct pose, in standard deviations. Observed: 1.9 to 7.8 a view, wrong poses -2.9 to 2.7."""

_VIEWS = 4
_WITHIN_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _SweepPair:
    view: CaptureFrame
    edges: EdgeImage
    depth_edges: Float64[np.ndarray, "e 3"]


def _poses(views: Sequence[CaptureFrame]) -> list[Pose]:
    return [view.camera.world_to_camera for view in views]


def _stands_out(seen: Sequence[_SweepPair], poses: Sequence[Pose]) -> float:
    """Mean fit of world-to-camera poses; views with too few points count as 0."""
    fits = [
        pose_fit.lidar_edge_fit(each.edges, each.depth_edges, replace(each.edges.view.camera, world_to_camera=pose))
        for each, pose in zip(seen, poses, strict=True)
    ]
    return float(np.mean(np.nan_to_num(fits, nan=0.0)))


def _sweep_pairs(capture: Capture, views: Sequence[CaptureFrame]) -> list[_SweepPair]:
    """Some views over the drive, each with the sweep nearest in time; broken images are skipped."""
    seen: list[_SweepPair] = []
    for view in evenly_spread(views, _VIEWS):
        sweep = nearest_sweep(view, capture.sweeps)
        if sweep is None or abs(sweep.time_s - view.time_s) > _WITHIN_S:
            continue
        try:
            seen.append(_SweepPair(view, pose_fit.edge_image(view), pose_fit.depth_edges(sweep)))
        except CaptureError:
            continue
    return seen


EXPLAINED = 0.6
"""Minimum share of matches for correct poses, which explain 83 to 100 % in real drives, wrong ones up to 52 %."""

_PAIRS = 3
_STRIDES = (1, 2, 4, 8)


_ImagePair = tuple[CaptureFrame, CaptureFrame, FeatureMatches]


def _fits(pairs: Sequence[_ImagePair], poses: Sequence[Pose]) -> list[EpipolarFit]:
    """Fit of poses to the pairs; two poses a pair, in their order."""
    return [pose_fit.epipolar_fit(found, (poses[2 * k], poses[2 * k + 1])) for k, (_, _, found) in enumerate(pairs)]


def _explained(pairs: Sequence[_ImagePair], fits: Sequence[EpipolarFit]) -> float:
    return float(np.average([each.explained for each in fits], weights=_sizes(pairs)))


def _sizes(pairs: Sequence[_ImagePair]) -> list[int]:
    return [len(found.first) for _, _, found in pairs]


def _matched_pairs(views: Sequence[CaptureFrame]) -> list[_ImagePair]:
    """Match some evenly spread views with their neighbors or, if the camera did not move, with later views."""
    seen = lru_cache(maxsize=None)(_features)
    starts = evenly_spread(range(len(views) - 1), _PAIRS)
    found = (_matched_with_a_later_one(views, start, seen) for start in starts)
    return [pair for pair in found if pair is not None]


def _matched_with_a_later_one(
    views: Sequence[CaptureFrame], start: int, seen: Callable[[CaptureFrame], ImageFeatures | None]
) -> _ImagePair | None:
    for later in (start + stride for stride in _STRIDES if start + stride < len(views)):
        if np.allclose(views[start].camera.position, views[later].camera.position, rtol=0, atol=1e-9):
            continue  # without motion there is no epipolar geometry, only moving objects
        first, second = seen(views[start]), seen(views[later])
        found = None if first is None or second is None else pose_fit.match_features(first, second)
        if found is not None:
            return views[start], views[later], found
    return None


def _features(view: CaptureFrame) -> ImageFeatures | None:
    try:
        return pose_fit.find_features(view)
    except CaptureError:
        return None  # broken images are reported elsewhere


# Common mistakes

_FLIPPED = np.diag([1.0, -1.0, -1.0, 1.0])


def hypotheses(capture: Capture, views: Sequence[CaptureFrame]) -> dict[str, list[Pose]]:
    """Common mistakes for views of one camera: world to camera of the views under each, by the end of a sentence.

    Inverted poses, other axes, and poses of another camera of the rig.
    """
    given = _poses(views)
    mistakes = {
        "the matrices are camera to world, not world to camera": [invert_pose(pose) for pose in given],
        "the camera axes are OpenGL's (y up, z backward)": [_FLIPPED @ pose for pose in given],
        "the matrices are camera to world, with OpenGL's axes": [invert_pose(pose @ _FLIPPED) for pose in given],
    }
    others = [sensor for sensor in capture.sensors if sensor != views[0].sensor]
    return mistakes | {f"the poses are those of {other}": _poses_of(capture, other, views) for other in others}


def _poses_of(capture: Capture, sensor: str, views: Sequence[CaptureFrame]) -> list[Pose]:
    """Poses of another camera at the times of some views; without distinct times, at the same index."""
    own, other = ([v for v in capture if v.sensor == each] for each in (views[0].sensor, sensor))
    places = {view.name: k for k, view in enumerate(own)}
    nearest = [
        min(enumerate(other), key=lambda each: (abs(each[1].time_s - view.time_s), abs(each[0] - places[view.name])))[1]
        for view in views
    ]
    return _poses(nearest)


_Each = TypeVar("_Each")


def evenly_spread(row: Sequence[_Each], at_most: int) -> list[_Each]:
    """Choose up to `at_most` elements, evenly."""
    if not row:
        return []
    places = np.linspace(0, len(row) - 1, min(at_most, len(row))).round().astype(np.int64)
    return [row[k] for k in dict.fromkeys(places.tolist())]
