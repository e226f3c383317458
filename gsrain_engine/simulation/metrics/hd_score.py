"""HUGSIM's HD-score and its components."""

import msgspec
import numpy as np
from jaxtyping import Float64

from ..obstacles import Drivable, OccupiedSpace
from ..rollout import Rollout, RolloutStep
from .collisions import LoggedTraffic, ego_box, future_times_s, planned_poses, pose_hits, with_start
from .comfort import is_plan_comfortable

_TTC_WEIGHT, _COMFORT_WEIGHT = 5.0, 2.0
_LOOK_AHEAD_S = (0.5, 1.0)


class HdScore(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Components, each the mean over frames, 0..1, higher is better."""

    frames: int
    """Number of scored frames: plans of at least two points, the last of which does not count."""
    nc: float
    """No collision: 1 if neither the planned poses nor the current one collide."""
    dac: float | None
    """Drivable area compliance: 0 if any pose has less than 0.3 of its footprint's quarters on the road, 0.5 below
    0.5 (which four quarters can't reach), else 1. None if the road is unknown; the score then uses 1."""
    ttc: float
    """Time to collision: 1 if also the poses advanced at their speed by 0.5 s and 1 s do not collide."""
    c: float
    """Comfort: 1 if all values of the plan are within the paper's limits."""
    pdms: float
    """nc dac (5 ttc + 2 c) / 7 of each frame."""
    rc: float
    """Route completion: 1 from 0.9 of the route on. HUGSIM counts recorded poses from the start of the recording; this
    counts distance from the start of the scenario."""
    hdscore: float
    """pdms times rc."""


def hd_score(
    rollout: Rollout, occupied: OccupiedSpace | None = None, drivable: Drivable | None = None
) -> HdScore | None:
    """Score a run like HUGSIM's `score_calculator`; None if no frame has a plan of two points.

    Deviations, each avoiding a pitfall of HUGSIM: all road users count, not only those named "car"; the background is
    tested as in the simulation, while HUGSIM's scorer tests a slab 1.5 to 3 m above the ground. Without `occupied` the
    background does not count.
    """
    scorer = _HdScorer(rollout, occupied, drivable)
    rows = [scorer.frame(step) for step in rollout.planned_frames]
    scored = np.array([row for row in rows if row is not None]).reshape(-1, 5)
    if not len(scored):
        return None
    nc, dac, ttc, c, pdms = (float(each) for each in scored.mean(axis=0))
    rc = min(1.0, max(step.route_completion for step in rollout.steps) / 0.9)
    known = None if drivable is None else dac
    return HdScore(frames=len(scored), nc=nc, dac=known, ttc=ttc, c=c, pdms=pdms, rc=rc, hdscore=pdms * rc)


class _HdScorer:
    def __init__(self, rollout: Rollout, occupied: OccupiedSpace | None, drivable: Drivable | None) -> None:
        self._vehicle = rollout.vehicle
        self._rollout, self._spacing_s = rollout, rollout.spacing_s
        self._traffic, self._occupied, self._drivable = LoggedTraffic(rollout), occupied, drivable

    def frame(self, step: RolloutStep) -> tuple[float, ...] | None:
        planned = planned_poses(step, "hugsim")
        if len(planned) < 2:
            return None
        poses = with_start(step, planned)
        nc = 0.0 if self._hits(step, poses) else 1.0
        dac = 1.0
        if self._drivable is not None:
            boxes = [ego_box(self._vehicle, pose) for pose in poses]
            on_road = min(float(np.mean(self._drivable.share_on_road(box) > 0)) for box in boxes)
            dac = 0.0 if on_road < 0.3 else 1.0 - 0.5 * (on_road < 0.5)
        ttc = 1.0 if all(not self._hits(step, self._moved_on(poses, each)) for each in _LOOK_AHEAD_S) else 0.0
        c = float(is_plan_comfortable(poses, self._spacing_s))
        pdms = nc * dac * (_TTC_WEIGHT * ttc + _COMFORT_WEIGHT * c) / (_TTC_WEIGHT + _COMFORT_WEIGHT)
        return nc, dac, ttc, c, pdms

    def _hits(self, step: RolloutStep, poses: Float64[np.ndarray, "n 3"]) -> bool:
        times = [step.time_s, *future_times_s(self._rollout, step, len(poses) - 1, "hugsim")]
        return any(pose_hits(self._vehicle, poses, times, self._traffic, self._occupied))

    def _moved_on(self, poses: Float64[np.ndarray, "n 3"], time_s: float) -> Float64[np.ndarray, "n 3"]:
        """Advance poses at the speed of the segment before each; the first at that of the second."""
        velocity = np.diff(poses[:, :2], axis=0) / self._spacing_s
        moved = poses.copy()
        moved[:, :2] += time_s * np.concatenate([velocity[:1], velocity])
        return moved
