"""Comfort of the ride as it was driven: the paper's S, read as a measure of the executed motion."""

import numpy as np

from ..rollouts.rollout import Rollout
from .comfort_limits import PAPER, ComfortLimits, Motion


def executed_motion(rollout: Rollout) -> Motion:
    """Return the motion over each step of a run, one value a step that was driven.

    Acceleration is that over the step, jerk its change from the step before; acceleration across the heading (speed
    times yaw rate) and yaw rate are those at the step's end, the lateral jerk and the yaw acceleration their change
    over it. The first step has no jerk.
    """
    dt = rollout.step_s
    egos = [each.ego for each in rollout.steps]
    acceleration = np.array([each.acceleration_m_s2 for each in egos[1:]], np.float64)
    yaw_rate = np.array([each.yaw_rate_rad_s for each in egos], np.float64)
    lateral = np.array([each.speed_m_s for each in egos], np.float64) * yaw_rate
    jerk = np.full(len(acceleration), np.nan)
    jerk[1:] = np.diff(acceleration) / dt
    return Motion(
        acceleration, jerk, lateral[1:], np.diff(lateral) / dt, yaw_rate[1:], np.diff(yaw_rate) / dt
    )  # fmt: skip


def comfort_executed(rollout: Rollout, limits: ComfortLimits = PAPER) -> float | None:
    """Return the share of driven steps in which all values are within the limits, 0..1; None without a step.

    S = 1/F sum_i s_i (paper, equation of S); which motion the paper means is open, see `comfort_planned` for the other
    reading. F is the number of driven steps.
    """
    fine = executed_motion(rollout).comfortable(limits)
    return float(fine.mean()) if len(fine) else None
