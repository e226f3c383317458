"""HUGSIM's HD-score of a run and the parts that it is made of."""

from typing import Protocol, runtime_checkable

import msgspec
import numpy as np
from jaxtyping import Float64

from ..geometry import PlanarBox
from ..rollout import Rollout, RolloutStep, planned_frames, run_setting
from ..vehicle import Vehicle
from .collisions import CollisionSpace, LoggedTraffic, ego_box, future_times_s, planned_poses, pose_hits, with_start
from .comfort import is_plan_comfortable

_TTC_WEIGHT, _COMFORT_WEIGHT = 5.0, 2.0

_LOOK_AHEAD_S = (0.5, 1.0)

_FEWEST_POINTS = 2

_WHOLE_ROUTE = 0.9
"""Share of the route that counts as all of it."""


@runtime_checkable
class DrivableArea(Protocol):
    """Where there is road, such as `Drivable`."""

    def share_on_road(self, box: PlanarBox) -> Float64[np.ndarray, "2 2"]:
        """How much of each quarter of a box, front and rear by left and right, is on the road, 0..1."""
        ...


class HdScore(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The parts, each the mean over frames, 0..1, higher is better."""

    frames: int
    """Scored: those whose plan has two points or more, the last of which does not count."""
    nc: float
    """No collision: 1 where no planned pose, nor the present one, hits anybody or anything."""
    dac: float | None
    """Drivable area compliance: 0 where any pose has less than 0.3 of its footprint's quarters on the road, 0.5 below
    0.5 (which four quarters can't reach), else 1. None where the road is not known; the score takes it as 1 then."""
    ttc: float
    """1 where nothing is hit either with all poses moved on by what their speed makes in 0.5 s and in 1 s."""
    c: float
    """Comfort of the plan, all values within the paper's thresholds."""
    pdms: float
    """nc dac (5 ttc + 2 c) / 7 of each frame."""
    rc: float
    """Route completion: 1 from 0.9 of the route on. HUGSIM counts recorded poses from the start of the recording; here
    it is distance, from where the scenario begins."""
    hdscore: float
    """pdms times rc."""


def hd_score(
    rollout: Rollout, occupied: CollisionSpace | None = None, drivable: DrivableArea | None = None
) -> HdScore | None:
    """Score a run as HUGSIM's `score_calculator` does; None where no frame has a plan of two points.

    Deviations, each of them on the safe side of a trap there: all road users count, not only those named "car"; the
    background is tested as the simulation tests it, where HUGSIM's scorer looks at a slab 1.5 to 3 m above the ground.
    Without `occupied` the background does not count at all.
    """
    judge = _HdScorer(rollout, occupied, drivable)
    rows = [judge.frame(step) for step in planned_frames(rollout)]
    scored = np.array([row for row in rows if row is not None]).reshape(-1, 5)
    if not len(scored):
        return None
    nc, dac, ttc, c, pdms = (float(each) for each in scored.mean(axis=0))
    rc = min(1.0, max(step.route_completion for step in rollout.steps) / _WHOLE_ROUTE)
    return HdScore(
        frames=len(scored), nc=nc, dac=None if drivable is None else dac, ttc=ttc, c=c, pdms=pdms, rc=rc,
        hdscore=pdms * rc,
    )  # fmt: skip


class _HdScorer:
    def __init__(self, rollout: Rollout, occupied: CollisionSpace | None, drivable: DrivableArea | None) -> None:
        self._vehicle: Vehicle = run_setting(rollout).vehicle
        self._rollout, self._spacing_s = rollout, rollout.spacing_s
        self._traffic, self._occupied, self._drivable = LoggedTraffic(rollout), occupied, drivable

    def frame(self, step: RolloutStep) -> tuple[float, ...] | None:
        planned = planned_poses(step, "hugsim")
        if len(planned) < _FEWEST_POINTS:
            return None
        poses = with_start(step, planned)
        nc = 0.0 if self._hits(step, poses) else 1.0
        dac = self._compliance(poses)
        ttc = 1.0 if all(not self._hits(step, self._moved_on(poses, each)) for each in _LOOK_AHEAD_S) else 0.0
        c = float(is_plan_comfortable(poses, self._spacing_s))
        pdms = nc * dac * (_TTC_WEIGHT * ttc + _COMFORT_WEIGHT * c) / (_TTC_WEIGHT + _COMFORT_WEIGHT)
        return nc, dac, ttc, c, pdms

    def _hits(self, step: RolloutStep, poses: Float64[np.ndarray, "n 3"]) -> bool:
        times = [step.time_s, *future_times_s(self._rollout, step, len(poses) - 1, "hugsim")]
        return any(pose_hits(self._vehicle, poses, times, self._traffic, self._occupied))

    def _moved_on(self, poses: Float64[np.ndarray, "n 3"], time_s: float) -> Float64[np.ndarray, "n 3"]:
        """Move poses on at the speed with which they are reached; the first at that of the second."""
        velocity = np.diff(poses[:, :2], axis=0) / self._spacing_s
        moved = poses.copy()
        moved[:, :2] += time_s * np.concatenate([velocity[:1], velocity])
        return moved

    def _compliance(self, poses: Float64[np.ndarray, "n 3"]) -> float:
        if self._drivable is None:
            return 1.0
        boxes = [ego_box(self._vehicle, pose) for pose in poses]
        shares = [float(np.mean(self._drivable.share_on_road(box) > 0)) for box in boxes]
        if min(shares) < 0.3:
            return 0.0
        return 0.5 if min(shares) < 0.5 else 1.0
