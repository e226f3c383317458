"""Comfort metrics (the paper's S) of executed and planned motion."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from ..rollout import Rollout
from .collisions import planned_poses, with_start


class ComfortLimits(NamedTuple):
    """Inclusive upper limits of comfortable motion."""

    braking_m_s2: float = -4.05
    acceleration_m_s2: float = 2.40
    """Acceleration and deceleration are along the heading, as is the jerk; the others count with either sign."""
    jerk_m_s3: float = 8.37
    lateral_m_s2: float = 4.89
    yaw_rate_rad_s: float = 0.95
    yaw_acceleration_rad_s2: float = 1.93
    whole_jerk_m_s3: float = float("inf")  # norm of the jerk along and across the heading


PAPER = ComfortLimits()
"""The paper's table, after HUGSIM: 8.37 bounds the jerk along the heading. HUGSIM's first version compared the upper
bound of the acceleration with 4.89 by mistake; this is the corrected one."""


class Motion(NamedTuple):
    """Motion of a vehicle per frame or plan point; NaN where unknown."""

    acceleration_m_s2: Float64[np.ndarray, " n"]
    jerk_m_s3: Float64[np.ndarray, " n"]
    lateral_m_s2: Float64[np.ndarray, " n"]
    lateral_jerk_m_s3: Float64[np.ndarray, " n"]
    yaw_rate_rad_s: Float64[np.ndarray, " n"]
    yaw_acceleration_rad_s2: Float64[np.ndarray, " n"]

    def comfortable(self, limits: ComfortLimits = PAPER) -> Bool[np.ndarray, " n"]:
        """Return where all values are within the limits; unknown values count as within."""
        over = (
            limits.braking_m_s2 - self.acceleration_m_s2,
            self.acceleration_m_s2 - limits.acceleration_m_s2,
            np.abs(self.jerk_m_s3) - limits.jerk_m_s3,
            np.abs(self.lateral_m_s2) - limits.lateral_m_s2,
            np.abs(self.yaw_rate_rad_s) - limits.yaw_rate_rad_s,
            np.abs(self.yaw_acceleration_rad_s2) - limits.yaw_acceleration_rad_s2,
            np.hypot(self.jerk_m_s3, self.lateral_jerk_m_s3) - limits.whole_jerk_m_s3,
        )
        return ~np.any(np.array(over) > 1e-9, axis=0)  # beyond rounding


def executed_motion(rollout: Rollout) -> Motion:
    """Return the motion of a run, one value per driven step.

    Acceleration is that over the step, jerk its change from the previous step; lateral acceleration (speed times yaw
    rate) and yaw rate are those at the step's end, lateral jerk and yaw acceleration their change over it. The first
    step has no jerk.
    """
    dt = rollout.step_s
    egos = [each.ego for each in rollout.steps]
    acceleration = np.array([each.acceleration_m_s2 for each in egos[1:]], np.float64)
    yaw_rate = np.array([each.yaw_rate_rad_s for each in egos], np.float64)
    lateral = np.array([each.speed_m_s for each in egos], np.float64) * yaw_rate
    jerk = np.full(len(acceleration), np.nan)
    jerk[1:] = np.diff(acceleration) / dt
    return Motion(acceleration, jerk, lateral[1:], np.diff(lateral) / dt, yaw_rate[1:], np.diff(yaw_rate) / dt)


def comfort_executed(rollout: Rollout, limits: ComfortLimits = PAPER) -> float | None:
    """Return the share of driven steps in which all values are within the limits, 0..1; None without a step.

    S = 1/F sum_i s_i (paper, equation of S); the paper leaves the motion open, see `comfort_planned` for the other
    reading. F is the number of driven steps.
    """
    fine = executed_motion(rollout).comfortable(limits)
    return float(fine.mean()) if len(fine) else None


NUPLAN = ComfortLimits(jerk_m_s3=4.13, whole_jerk_m_s3=8.37)
"""nuPlan's: 8.37 bounds the length of the jerk, 4.13 its part along the heading. (nuPlan also smooths with a
Savitzky-Golay filter at 10 Hz; plans and steps here are too coarse for that.)"""

# Planned comfort: HUGSIM's definition, used in its scores


def planned_motion(poses: Float64[np.ndarray, "n 3"], spacing_s: float) -> Motion:
    """Return the motion along poses (x, y, heading) at a time spacing, by finite differences.

    As in HUGSIM's scorer: the speed is the distance between poses over time, regardless of heading; the lateral
    acceleration is identically zero. Missing values at the end repeat the last one. Needs 4 poses.
    """
    speed = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1) / spacing_s
    turn = np.diff(poses[:, 2])
    turn = np.where(turn > np.pi, turn - 2 * np.pi, turn)
    turn = np.where(turn < -np.pi, turn + 2 * np.pi, turn)
    yaw_rate = turn / spacing_s
    acceleration = np.diff(speed) / spacing_s
    jerk, yaw_acceleration = np.diff(acceleration) / spacing_s, np.diff(yaw_rate) / spacing_s
    acceleration, jerk, yaw_rate, yaw_acceleration = (
        np.pad(each, (0, len(poses) - len(each)), "edge") for each in (acceleration, jerk, yaw_rate, yaw_acceleration)
    )
    zero = np.zeros(len(poses))
    return Motion(acceleration, jerk, zero, zero, yaw_rate, yaw_acceleration)


def is_plan_comfortable(poses: Float64[np.ndarray, "n 3"], spacing_s: float, limits: ComfortLimits = PAPER) -> bool:
    """Return whether a plan stays within the limits; `poses` start with the vehicle's own. True below 4 poses."""
    return len(poses) < 4 or bool(planned_motion(poses, spacing_s).comfortable(limits).all())


def comfort_planned(rollout: Rollout, limits: ComfortLimits = PAPER) -> float | None:
    """Return the share of frames whose plan is comfortable throughout, 0..1; None without a frame.

    The time between points is the plan's spacing (0.5 s). HUGSIM took 0.25 s until November 2025, which doubles
    every rate and makes most plans uncomfortable: earlier scores are not comparable.
    """
    fine = [
        is_plan_comfortable(with_start(step, poses), rollout.spacing_s, limits)
        for step in rollout.planned_frames
        if len(poses := planned_poses(step, "hugsim"))
    ]
    return sum(fine) / len(fine) if fine else None
