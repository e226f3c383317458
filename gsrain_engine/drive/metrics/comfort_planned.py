"""Comfort of the ride as it was planned: HUGSIM's reading, which is what its scores contain."""

import numpy as np
from jaxtyping import Float64

from ..rollouts.rollout import Rollout
from ..rollouts.run_setting import planned_frames
from .comfort_limits import PAPER, ComfortLimits, Motion
from .planned_poses import PlanReading, planned_poses, with_start

_FEWEST = 4
"""Fewer poses than this have no jerk; they count as comfortable."""


def planned_motion(poses: Float64[np.ndarray, "n 3"], spacing_s: float) -> Motion:
    """Return the motion along poses (x, y, heading) that are so far apart in time, by finite differences.

    As HUGSIM's scorer: the speed is the distance between poses over the time, whatever the heading; the acceleration
    across the heading is identically zero. Missing values at the end repeat the last one. Needs 4 poses.
    """
    speed = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1) / spacing_s
    turn = np.diff(poses[:, 2])
    turn = np.where(turn > np.pi, turn - 2 * np.pi, turn)
    turn = np.where(turn < -np.pi, turn + 2 * np.pi, turn)
    yaw_rate = turn / spacing_s
    acceleration = np.diff(speed) / spacing_s
    zero = np.zeros(len(poses))
    return Motion(
        _filled(acceleration, poses), _filled(np.diff(acceleration) / spacing_s, poses), zero, zero,
        _filled(yaw_rate, poses), _filled(np.diff(yaw_rate) / spacing_s, poses),
    )  # fmt: skip


def is_plan_comfortable(poses: Float64[np.ndarray, "n 3"], spacing_s: float, limits: ComfortLimits = PAPER) -> bool:
    """Whether a plan stays within the limits throughout; `poses` begin with the vehicle's own. Fewer than 4 do."""
    return len(poses) < _FEWEST or bool(planned_motion(poses, spacing_s).comfortable(limits).all())


def comfort_planned(rollout: Rollout, limits: ComfortLimits = PAPER, reading: PlanReading = "hugsim") -> float | None:
    """Return the share of frames whose plan is comfortable throughout, 0..1; None without a frame.

    The time between points is the plan's own spacing (0.5 s). HUGSIM took 0.25 s until November 2025, which doubles
    every rate and makes most plans uncomfortable: scores from before are not comparable.
    """
    fine = [
        is_plan_comfortable(with_start(step, poses), rollout.spacing_s, limits)
        for step in planned_frames(rollout)
        if len(poses := planned_poses(step, reading))
    ]
    return sum(fine) / len(fine) if fine else None


def _filled(values: Float64[np.ndarray, " m"], poses: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    return np.pad(values, (0, len(poses) - len(values)), "edge")
