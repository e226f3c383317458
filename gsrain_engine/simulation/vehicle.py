"""The ego vehicle: dimensions, state, kinematic bicycle model and bounding box. World frame, meters, z up."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from .geometry import PlanarBox
from .vehicle_settings import Vehicle

HUGSIM_VEHICLE = Vehicle(length_m=3.0, width_m=1.6, height_m=1.5, wheelbase_m=2.7, rear_overhang_m=1.5)
"""HUGSIM's ego: a box (w 1.6, h 1.5, l 3.0) centered on the point that it steers, a front camera."""


@dataclass(frozen=True, slots=True)
class VehicleState:
    """Pose and speed of a vehicle at the center of its rear axle."""

    x_m: float
    y_m: float
    yaw_rad: float
    """Counterclockwise from the world's x axis; not wrapped."""
    speed_m_s: float = 0.0
    """Speed along the heading; 0 or more."""
    steer_rad: float = 0.0
    """Front wheels, left positive."""

    def to_world(self, points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Transform points from the vehicle's frame (x forward, y left) to the world."""
        return points @ self._turn.T + (self.x_m, self.y_m)

    def from_world(self, points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Transform points from the world to the vehicle's frame (x forward, y left)."""
        return (points - (self.x_m, self.y_m)) @ self._turn

    def rig_to_world(self, height_m: float) -> Float64[np.ndarray, "4 4"]:
        """Return the pose of a rig (x forward, y left, z up) in the world, at a height above the vehicle's origin."""
        matrix = np.eye(4)
        matrix[:2, :2] = self._turn
        matrix[:3, 3] = self.x_m, self.y_m, height_m
        return matrix

    @property
    def _turn(self) -> Float64[np.ndarray, "2 2"]:
        cosine, sine = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.array([[cosine, -sine], [sine, cosine]])


class Control(NamedTuple):
    """Control input of a vehicle for one step."""

    acceleration_m_s2: float
    """Negative values brake."""
    steer_rate_rad_s: float
    """Front wheels, left positive."""


# Kinematic bicycle model


def limit_control(vehicle: Vehicle, state: VehicleState, control: Control, dt_s: float) -> Control:
    """Clip a control to the vehicle's limits and to standstill."""
    low = max(-vehicle.most_braking_m_s2, -state.speed_m_s / dt_s)
    high = min(vehicle.most_acceleration_m_s2, (vehicle.top_speed_m_s - state.speed_m_s) / dt_s)
    limit = vehicle.most_steer_rate_rad_s
    rate = float(np.clip(control.steer_rate_rad_s, -limit, limit))
    steer = float(np.clip(state.steer_rad + rate * dt_s, -vehicle.most_steer_rad, vehicle.most_steer_rad))
    return Control(float(np.clip(control.acceleration_m_s2, low, max(low, high))), (steer - state.steer_rad) / dt_s)


def grip_share(vehicle: Vehicle, state: VehicleState, acceleration_m_s2: float, grip_m_s2: float) -> float:
    """Return the share of the demanded acceleration, along and across the heading, that tires transmit, 0..1.

    Both share a friction circle with the radius `grip_m_s2` (Rajamani 2012, section 13.6).
    """
    across = state.speed_m_s**2 * np.tan(state.steer_rad) / vehicle.wheelbase_m
    demanded = float(np.hypot(acceleration_m_s2, across))
    return 1.0 if demanded <= grip_m_s2 else grip_m_s2 / demanded


def step_bicycle(
    vehicle: Vehicle, state: VehicleState, control: Control, dt_s: float, turn_share: float = 1.0
) -> VehicleState:
    """Return the state after a time step under a constant control.

    The center of the rear axle follows its heading, which turns by v tan(steer) / wheelbase (Rajamani 2012, sec. 2.2,
    with the reference at the rear axle). Speed and steering are taken at the midpoint of the step: exact for straight
    lines under constant acceleration and for circles at constant speed, second order otherwise. Where the tires slip,
    the vehicle turns by `turn_share` of that only.
    """
    control = limit_control(vehicle, state, control, dt_s)
    speed = state.speed_m_s + 0.5 * control.acceleration_m_s2 * dt_s
    steer = state.steer_rad + 0.5 * control.steer_rate_rad_s * dt_s
    turn = turn_share * speed * np.tan(steer) / vehicle.wheelbase_m * dt_s
    # The chord of an arc has sin(half) / half of the arc's length.
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
    """Return the yaw rate, rad/s, left positive: v tan(steer) / wheelbase, if the tires do not slip."""
    return float(state.speed_m_s * np.tan(state.steer_rad) / vehicle.wheelbase_m)


def vehicle_box(vehicle: Vehicle, state: VehicleState) -> PlanarBox:
    """Return the bounding box of a vehicle on the ground. World frame, meters."""
    x = state.x_m + vehicle.middle_m * np.cos(state.yaw_rad)
    y = state.y_m + vehicle.middle_m * np.sin(state.yaw_rad)
    return PlanarBox(float(x), float(y), state.yaw_rad, vehicle.length_m, vehicle.width_m)
