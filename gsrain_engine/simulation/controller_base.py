"""What turns a plan into controls."""

from typing import Annotated, Literal, NamedTuple, Protocol, runtime_checkable

import msgspec
import numpy as np
from jaxtyping import Float64
from msgspec import Meta

from .geometry import wrap_angle
from .vehicle import Control, Vehicle, VehicleState


@runtime_checkable
class Controller(Protocol):
    """Follows a plan. The same states and plans give the same controls, on any machine: nothing goes by the clock."""

    def reset(self) -> None:
        """Forget what it knows of the drive before."""
        ...

    def control(
        self, vehicle: Vehicle, state: VehicleState, plan: Float64[np.ndarray, "n 2"], spacing_s: float
    ) -> Control:
        """Return what to do now to be at `plan[k]` (k + 1) spacings from now.

        `plan` is in the vehicle's present frame (x forward, y left, metres), n >= 1.
        """
        ...


# § Which controller steers, and how hard it may.


class ControllerSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What turns plans into controls."""

    kind: Annotated[
        Literal["ilqr", "pure-pursuit"],
        Meta(title="Controller", description="nuPlan's tracker, as HUGSIM uses it, or the plain geometric one."),
    ] = "ilqr"
    heading_reference: Annotated[
        Literal["tangent", "hugsim"],
        Meta(
            title="Heading reference",
            description="Heading that the tracker wants: the plan's own, or HUGSIM's published arctan2 of swapped "
            "arguments, with all else as published too, to reproduce its numbers.",
        ),
    ] = "tangent"
    iterations: Annotated[int, Meta(ge=1, le=1000, title="Iterations")] = 100
    most_acceleration_m_s2: Annotated[
        float,
        Meta(gt=0, le=20, title="Most acceleration", description="That the tracker asks for; nuPlan's.",
             extra={"unit": "m/s2"}),
    ] = 3.0  # fmt: skip
    most_braking_m_s2: Annotated[
        float,
        Meta(
            gt=0,
            le=20,
            title="Most braking",
            description="That the tracker asks for, whatever the vehicle could do; nuPlan's and HUGSIM's is 3.",
            extra={"unit": "m/s2"},
        ),
    ] = 3.0


# § Pure pursuit: steer for a point ahead on the plan, and take the speed that the plan has.

_SHORTEST_M, _AHEAD_S = 4.0, 1.0
"""The point that is steered for is so far ahead, or so many seconds at the present speed."""

_SETTLE_S = 0.5
"""Time in which the steering is to reach what it should be."""

_SPEED_POINTS = 2
"""The acceleration is the one that leads to the plan's second point: one second ahead, so that noise matters less."""


class PurePursuit:
    """Steers along the arc through the rear axle and a point ahead on the plan (Coulter 1992)."""

    def reset(self) -> None:
        """Forget nothing: there is nothing that it remembers."""

    def control(
        self, vehicle: Vehicle, state: VehicleState, plan: Float64[np.ndarray, "n 2"], spacing_s: float
    ) -> Control:
        points = np.concatenate([np.zeros((1, 2)), plan])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        point = min(_SPEED_POINTS, len(plan))
        time_s = point * spacing_s
        acceleration = 2 * (float(along[point]) - state.speed_m_s * time_s) / time_s**2
        reach = max(_SHORTEST_M, _AHEAD_S * state.speed_m_s)
        ahead = np.array([np.interp(reach, along, points[:, axis]) for axis in range(2)])
        distance2 = float(ahead @ ahead)
        curvature = 2 * float(ahead[1]) / distance2 if distance2 > 0.25 else 0.0
        steer = float(np.arctan(vehicle.wheelbase_m * curvature))
        return Control(acceleration, (steer - state.steer_rad) / _SETTLE_S)


# § What of a plan a vehicle can keep to that can't brake as hard as the plan does.


class ReachablePlan(NamedTuple):
    """Points of a plan, none of them nearer than full braking leads."""

    points: Float64[np.ndarray, "n 2"]
    full_braking: bool
    """Whether even the last point is nearer: then nothing is left to weigh."""


def make_reachable(
    plan: Float64[np.ndarray, "n 2"], speed_m_s: float, braking_m_s2: float, spacing_s: float
) -> ReachablePlan:
    """Move what is too near on along the plan's own line, and straight on beyond its end.

    A tracker that is told to be where it has already driven past comes nearer to it by turning round: a driver who
    asks for a full stop at once would be steered off the road. A plan that stays within 0.1 m of the vehicle is such a
    stop, with noise. `plan` is in the vehicle's frame (x forward, y left).
    """
    if np.linalg.norm(plan, axis=1).max() < SHORTEST_M:
        plan = np.zeros_like(plan)
    line = np.concatenate([np.zeros((1, 2)), plan])
    steps = np.diff(line, axis=0)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    times = np.minimum(spacing_s * np.arange(1, len(plan) + 1), speed_m_s / braking_m_s2)
    least = speed_m_s * times - 0.5 * braking_m_s2 * times**2
    near = along[1:] < least
    heading = float(directions(steps)[-1])
    beyond = np.maximum(least - along[-1], 0.0)[:, None] * (np.cos(heading), np.sin(heading))
    moved = np.stack([np.interp(least, along, line[:, axis]) for axis in range(2)], axis=1) + beyond
    return ReachablePlan(np.where(near[:, None], moved, plan), bool(near[-1]))


# § What a tracker is to follow: a plan's points with the headings that they are to be passed with.

HeadingReference = Literal["tangent", "hugsim"]

SHORTEST_M = 0.1
"""Between closer points a plan has no direction: it jitters around a place where it wants to stand."""


def tracked_states(plan: Float64[np.ndarray, "n 2"], reference: HeadingReference) -> Float64[np.ndarray, "points 5"]:
    """Return the present state and those at the points of a plan: x, y, heading, 0, 0.

    Vehicle frame (x forward, y left, metres), headings in radians, left positive; speed and steering are not asked
    for. The first is the vehicle itself: the origin.
    """
    states = np.zeros((len(plan) + 1, 5))
    states[1:, :2] = plan
    steps = np.diff(states[:, :2], axis=0)
    states[1:, 2] = _tangents(steps) if reference == "tangent" else _swapped(steps)
    return states


def directions(steps: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    """Return where steps lead, unwrapped, radians from x.

    Where the plan stands or turns back it is the direction before, and x itself where there is none.
    """
    found = np.empty(len(steps))
    before = 0.0
    for i, (x, y) in enumerate(steps):
        turn = wrap_angle(float(np.arctan2(y, x)) - before)
        if np.hypot(x, y) >= SHORTEST_M and abs(turn) <= np.pi / 2:
            before += turn
        found[i] = before
    return found


def _tangents(steps: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    """Headings at the points: half way between the steps before and after; at the last as if it went on turning."""
    found = directions(steps)
    turns = np.diff(found) if len(found) > 1 else np.zeros(1)
    return found + 0.5 * (np.concatenate([turns, turns[-1:]]) if len(found) > 1 else turns)


def _swapped(steps: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    """HUGSIM's published heading: arctan2(forward, right) folded into +-90 degrees, right positive.

    Of a straight plan this is 90 degrees and not 0 (its pull request 57 mends it). Its sign is that of the sideways
    step, so that a hair to the left and to the right want opposite things.
    """
    right = np.arctan2(steps[:, 0], -steps[:, 1])
    right = np.where(right > np.pi / 2, right - np.pi, right)
    return -np.where(right < -np.pi / 2, right + np.pi, right)
