"""Controllers: protocol, settings, pure pursuit and preparation of plans for tracking."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from .geometry import arc_lengths, points_along, wrap_angle
from .vehicle import Control, Vehicle, VehicleState
from .vehicle_settings import HeadingReference


@runtime_checkable
class Controller(Protocol):
    """Turns plans into controls. Deterministic: the same states and plans give the same controls on any machine."""

    def control(
        self, vehicle: Vehicle, state: VehicleState, plan: Float64[np.ndarray, "n 2"], spacing_s: float
    ) -> Control:
        """Return the control that leads to `plan[k]` in (k + 1) spacings from now.

        `plan` is in the vehicle's current frame (x forward, y left, meters), n >= 1.
        """
        ...


# Pure pursuit

_SHORTEST_M, _AHEAD_S = 4.0, 1.0
"""Look-ahead distance: the larger of a minimum in m and a time in s at the current speed."""

_SETTLE_S = 0.5  # time to reach the target steering angle
_SPEED_POINTS = 2  # index of the plan point that sets the acceleration: one second ahead reduces noise


class PurePursuit:
    """Steers along the arc through the rear axle and a look-ahead point on the plan (Coulter 1992)."""

    def control(
        self, vehicle: Vehicle, state: VehicleState, plan: Float64[np.ndarray, "n 2"], spacing_s: float
    ) -> Control:
        points = np.concatenate([np.zeros((1, 2)), plan])
        along = arc_lengths(points)
        point = min(_SPEED_POINTS, len(plan))
        time_s = point * spacing_s
        acceleration = 2 * (float(along[point]) - state.speed_m_s * time_s) / time_s**2
        reach = max(_SHORTEST_M, _AHEAD_S * state.speed_m_s)
        (ahead,) = points_along(points, along, np.array([reach]))
        distance2 = float(ahead @ ahead)
        curvature = 2 * float(ahead[1]) / distance2 if distance2 > 0.25 else 0.0
        steer = float(np.arctan(vehicle.wheelbase_m * curvature))
        return Control(acceleration, (steer - state.steer_rad) / _SETTLE_S)


def make_reachable(
    plan: Float64[np.ndarray, "n 2"], speed_m_s: float, braking_m_s2: float, spacing_s: float
) -> tuple[Float64[np.ndarray, "n 2"], bool]:
    """Move points that are too near forward along the plan's line, and straight on beyond its end.

    A tracker turns around toward points that it has already passed, so a plan for an immediate stop would steer the
    vehicle off the road. A plan within 0.1 m of the vehicle is such a stop, with noise. `plan` is in the vehicle's
    frame (x forward, y left). Also returns whether even the last point is nearer than full braking allows.
    """
    if np.linalg.norm(plan, axis=1).max() < SHORTEST_M:
        plan = np.zeros_like(plan)
    line = np.concatenate([np.zeros((1, 2)), plan])
    along = arc_lengths(line)
    times = np.minimum(spacing_s * np.arange(1, len(plan) + 1), speed_m_s / braking_m_s2)
    shortest = speed_m_s * times - 0.5 * braking_m_s2 * times**2
    near = along[1:] < shortest
    heading = float(directions(np.diff(line, axis=0))[-1])
    beyond = np.maximum(shortest - along[-1], 0.0)[:, None] * (np.cos(heading), np.sin(heading))
    moved = points_along(line, along, shortest) + beyond
    return np.where(near[:, None], moved, plan), bool(near[-1])


# Reference states

SHORTEST_M = 0.1
"""Minimum distance between points that define a direction; closer points are jitter around a stop."""


def tracked_states(plan: Float64[np.ndarray, "n 2"], reference: HeadingReference) -> Float64[np.ndarray, "points 5"]:
    """Return the current state and the states at the points of a plan: x, y, heading, 0, 0.

    Vehicle frame (x forward, y left, meters), headings in radians, left positive; speed and steering have no reference.
    The first row is the vehicle itself at the origin.
    """
    states = np.zeros((len(plan) + 1, 5))
    states[1:, :2] = plan
    steps = np.diff(states[:, :2], axis=0)
    if reference == "hugsim":
        # HUGSIM's published heading: arctan2(forward, right) folded into +-90 degrees, right positive. For a straight
        # plan it is 90 degrees instead of 0 (fixed by HUGSIM's pull request 57). Its sign is that of the lateral step,
        # so tiny deviations to the left and right give opposite headings.
        right = np.arctan2(steps[:, 0], -steps[:, 1])
        right = np.where(right > np.pi / 2, right - np.pi, right)
        states[1:, 2] = -np.where(right < -np.pi / 2, right + np.pi, right)
    else:
        # Halfway between the adjacent steps; the last extrapolates the turn.
        found = directions(steps)
        turns = np.diff(found) if len(found) > 1 else np.zeros(1)
        states[1:, 2] = found + 0.5 * np.append(turns, turns[-1])[: len(found)]
    return states


def directions(steps: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    """Return the unwrapped directions of steps, radians from x; stops and reversals keep the one before, at first 0."""
    found = np.empty(len(steps))
    before = 0.0
    for i, (x, y) in enumerate(steps):
        turn = wrap_angle(float(np.arctan2(y, x)) - before)
        if np.hypot(x, y) >= SHORTEST_M and abs(turn) <= np.pi / 2:
            before += turn
        found[i] = before
    return found
