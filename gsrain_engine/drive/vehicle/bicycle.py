"""The kinematic bicycle model: how a vehicle moves on under a control, within its limits."""

import numpy as np

from .state import Control, VehicleState
from .vehicle import Vehicle


def limited(vehicle: Vehicle, state: VehicleState, control: Control, dt_s: float) -> Control:
    """Return what of a control a vehicle can do: within its limits, and no further than to standstill."""
    low = max(-vehicle.most_braking_m_s2, -state.speed_m_s / dt_s)
    high = min(vehicle.most_acceleration_m_s2, (vehicle.top_speed_m_s - state.speed_m_s) / dt_s)
    most = vehicle.most_steer_rate_rad_s
    rate = float(np.clip(control.steer_rate_rad_s, -most, most))
    steer = float(np.clip(state.steer_rad + rate * dt_s, -vehicle.most_steer_rad, vehicle.most_steer_rad))
    return Control(float(np.clip(control.acceleration_m_s2, low, max(low, high))), (steer - state.steer_rad) / dt_s)


def moved_on(vehicle: Vehicle, state: VehicleState, control: Control, dt_s: float) -> VehicleState:
    """Return where a vehicle is after a time under a constant control, and how fast.

    The rear axle's middle follows its heading, which turns by v tan(steer) / wheelbase (Rajamani 2012, sec. 2.2, with
    the reference at the rear axle). Speed and steering are taken at the middle of the step: exact for straight lines
    under constant acceleration and for circles at constant speed, of second order else.
    """
    control = limited(vehicle, state, control, dt_s)
    speed = state.speed_m_s + 0.5 * control.acceleration_m_s2 * dt_s
    steer = state.steer_rad + 0.5 * control.steer_rate_rad_s * dt_s
    turn = speed * np.tan(steer) / vehicle.wheelbase_m * dt_s
    # The chord of an arc: its length over the arc's is sin(half) / half.
    distance = speed * dt_s * float(np.sinc(turn / (2 * np.pi)))
    heading = state.yaw_rad + 0.5 * turn
    return VehicleState(
        float(state.x_m + distance * np.cos(heading)),
        float(state.y_m + distance * np.sin(heading)),
        float(state.yaw_rad + turn),
        float(max(0.0, state.speed_m_s + control.acceleration_m_s2 * dt_s)),
        float(state.steer_rad + control.steer_rate_rad_s * dt_s),
    )


def yaw_rate(vehicle: Vehicle, state: VehicleState) -> float:
    """Return how fast a vehicle turns to the left, rad/s: v tan(steer) / wheelbase."""
    return float(state.speed_m_s * np.tan(state.steer_rad) / vehicle.wheelbase_m)
