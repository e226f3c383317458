"""What a learner may do in a step: turn pedals and wheel, or say where it wants to be."""

import numpy as np
from gymnasium import spaces
from jaxtyping import Float64

from ..vehicle.state import Control
from ..vehicle.vehicle import Vehicle

PLAN_POINTS = 6
"""Points of a plan, 0.5 s apart: three seconds, as UniAD's."""
_REACH_M = 200.0


def control_space() -> spaces.Box:
    """Return the space of controls: acceleration and steering rate as shares of what the vehicle can do.

    Shape (2,), -1..1: full braking to full acceleration, and the steering rate to the right to that to the left.
    """
    return spaces.Box(-1.0, 1.0, (2,), np.float32)


def plan_space() -> spaces.Box:
    """Return the space of plans: points in the vehicle's frame, (6, 2) metres (x forward, y left), 0.5 s apart."""
    return spaces.Box(-_REACH_M, _REACH_M, (PLAN_POINTS, 2), np.float32)


def control_of(action: Float64[np.ndarray, "2"], vehicle: Vehicle) -> Control:
    pedal, wheel = (float(each) for each in np.clip(action, -1.0, 1.0))
    most = vehicle.most_acceleration_m_s2 if pedal > 0 else vehicle.most_braking_m_s2
    return Control(pedal * most, wheel * vehicle.most_steer_rate_rad_s)
