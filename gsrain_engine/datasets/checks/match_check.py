"""Poses against what neighbouring views of one camera share: epipolar distances, and points in front of both."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float64

from ..capture import Capture, CaptureError, View
from . import epipolar_fit
from .epipolar_fit import EpipolarFit, Features, Matches
from .pose_hypotheses import hypotheses
from .pose_verdict import PoseCheck, judged, spread

EXPLAINED = 0.6
"""Share of matches from which poses are right. Right ones explain 83-100 % in real drives, wrong ones up to 52 %."""

_PAIRS = 3
_STRIDES = (1, 2, 4, 8)


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    views: tuple[View, View]
    found: Matches


def check_by_matches(capture: Capture, sensor: str) -> PoseCheck | None:
    """Check one camera; None where too little can be matched, or it stood still."""
    pairs = _matched_pairs([view for view in capture if view.sensor == sensor])
    if not pairs:
        return None
    views = [view for pair in pairs for view in pair.views]
    fits = _fits(pairs, [view.camera.world_to_camera for view in views])
    explained = _explained(pairs, fits)
    others = {other.told: _explained(pairs, _fits(pairs, other.poses)) for other in hypotheses(capture, views)}
    verdict, why = judged(explained, EXPLAINED, others, EXPLAINED)
    smaller = min(epipolar_fit.WIDTH_PX, views[0].camera.width) / views[0].camera.width
    error_px = float(np.median([each.median_px for each in fits])) / smaller
    points = sum(len(pair.found.first) for pair in pairs)
    told = (
        f"{sensor or 'the camera'}: the poses explain {explained:.0%} of {points} points matched between neighbouring "
        f"views (expected over {EXPLAINED:.0%}), median epipolar error {error_px:.1f} px{why}"
    )
    return PoseCheck(sensor, "matches", verdict, explained, EXPLAINED, told)


def _fits(pairs: Sequence[_Pair], poses: Sequence[Float64[np.ndarray, "4 4"]]) -> list[EpipolarFit]:
    """How poses explain the pairs; two poses a pair, in their order."""
    return [epipolar_fit.fit(pair.found, (poses[2 * k], poses[2 * k + 1])) for k, pair in enumerate(pairs)]


def _explained(pairs: Sequence[_Pair], fits: Sequence[EpipolarFit]) -> float:
    return float(np.average([each.explained for each in fits], weights=[len(pair.found.first) for pair in pairs]))


def _matched_pairs(views: Sequence[View]) -> list[_Pair]:
    """Match some views, spread over the row, with their neighbours; where the camera stood still, with later ones."""
    seen = lru_cache(maxsize=None)(_features)
    starts = spread(range(len(views) - 1), _PAIRS)
    found = (_matched_with_a_later_one(views, start, seen) for start in starts)
    return [pair for pair in found if pair is not None]


def _matched_with_a_later_one(
    views: Sequence[View], start: int, seen: Callable[[View], Features | None]
) -> _Pair | None:
    for later in (start + stride for stride in _STRIDES if start + stride < len(views)):
        if _at_one_place(views[start], views[later]):
            continue
        first, second = seen(views[start]), seen(views[later])
        found = None if first is None or second is None else epipolar_fit.matches(first, second)
        if found is not None:
            return _Pair((views[start], views[later]), found)
    return None


def _at_one_place(first: View, second: View) -> bool:
    """Whether a camera stood still: then there is no epipolar geometry, and what moves in the picture moves itself."""
    return bool(np.allclose(first.camera.position, second.camera.position, rtol=0, atol=1e-9))


def _features(view: View) -> Features | None:
    try:
        return epipolar_fit.features(view)
    except CaptureError:
        return None  # a broken picture is somebody else's finding
