"""Within what a ride is comfortable: the paper's table of thresholds, and nuPlan's reading of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

_ROUNDING = 1e-9


class ComfortLimits(NamedTuple):
    """Largest values of the motion; equal is still comfortable."""

    braking_m_s2: float = -4.05
    acceleration_m_s2: float = 2.40
    """Both along the heading."""
    jerk_m_s3: float = 8.37
    """Along the heading, either sign."""
    lateral_m_s2: float = 4.89
    """Acceleration across the heading, either sign."""
    yaw_rate_rad_s: float = 0.95
    yaw_acceleration_rad_s2: float = 1.93
    whole_jerk_m_s3: float = float("inf")
    """Length of the jerk along and across the heading together."""


PAPER = ComfortLimits()
"""The paper's table, after HUGSIM: 8.37 bounds the jerk along the heading. HUGSIM's first version compared the upper
bound of the acceleration with 4.89 by mistake; this is the corrected one."""
NUPLAN = ComfortLimits(jerk_m_s3=4.13, whole_jerk_m_s3=8.37)
"""nuPlan's: 8.37 bounds the length of the jerk, 4.13 its part along the heading. (nuPlan also smooths with a
Savitzky-Golay filter at 10 Hz; plans and steps here are too coarse for that.)"""


class Motion(NamedTuple):
    """How a vehicle moves, value by value of a frame or a plan; NaN where a value is not known."""

    acceleration_m_s2: Float64[np.ndarray, " n"]
    jerk_m_s3: Float64[np.ndarray, " n"]
    lateral_m_s2: Float64[np.ndarray, " n"]
    lateral_jerk_m_s3: Float64[np.ndarray, " n"]
    yaw_rate_rad_s: Float64[np.ndarray, " n"]
    yaw_acceleration_rad_s2: Float64[np.ndarray, " n"]

    def comfortable(self, limits: ComfortLimits = PAPER) -> Bool[np.ndarray, " n"]:
        """Return where all values are within the limits; what is not known counts as within."""
        over = (
            limits.braking_m_s2 - self.acceleration_m_s2,
            self.acceleration_m_s2 - limits.acceleration_m_s2,
            np.abs(self.jerk_m_s3) - limits.jerk_m_s3,
            np.abs(self.lateral_m_s2) - limits.lateral_m_s2,
            np.abs(self.yaw_rate_rad_s) - limits.yaw_rate_rad_s,
            np.abs(self.yaw_acceleration_rad_s2) - limits.yaw_acceleration_rad_s2,
            np.hypot(self.jerk_m_s3, self.lateral_jerk_m_s3) - limits.whole_jerk_m_s3,
        )
        return ~np.any(np.array(over) > _ROUNDING, axis=0)
