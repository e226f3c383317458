"""What road users of a scenario do, in the words of OpenSCENARIO."""

from collections.abc import Sequence
from typing import Any

import msgspec
from scenariogeneration import xosc

from ...traffic.brake import Brake
from ...traffic.cut_in import CutIn
from ...traffic.trigger import Triggered
from ..scenario import ScenarioUser
from .names import EGO, LANE_M
from .words import words

Place = tuple[float, float, float, float]
"""x, y, z and heading in the world."""


def manoeuvre(user: ScenarioUser, gap_m: float) -> xosc.Maneuver | None:
    """Return what a road user does once it is set off; none where it does nothing of the kind.

    `gap_m` is the gap between it and the ego vehicle at the start: whether a gap has to shrink or to grow.
    """
    behaviour = user.behaviour
    if isinstance(behaviour, CutIn):
        return _event(user.id, behaviour, gap_m, _cut_in(user.id, behaviour))
    if isinstance(behaviour, Brake):
        speed = _speed(behaviour.to_speed_m_s, behaviour.deceleration_m_s2)
        return _event(user.id, behaviour, gap_m, [("brake", speed)])
    return None


def trajectory(id: str, times_s: Sequence[float], places: Sequence[Place]) -> xosc.Maneuver:
    """Return a way that is followed by the clock, from the start on."""
    way = xosc.Trajectory(f"{id} way", False)
    way.add_shape(xosc.Polyline(list(times_s), [position(place) for place in places]))
    follow = xosc.FollowTrajectoryAction(way, words.FollowingMode.position, words.ReferenceContext.absolute, 1, 0)
    return _manoeuvre(id, [("follow", follow)], _after(id, 0.0))


def position(place: Place) -> xosc.WorldPosition:
    """Return a place in the world, to the micrometre and the nanoradian."""
    x, y, z = (round(each, 6) for each in place[:3])
    return xosc.WorldPosition(x, y, z, round(place[3], 9), 0, 0)


def controller(user: ScenarioUser) -> xosc.Controller:
    """Return what stands for a behaviour that OpenSCENARIO has no action for: its name and its parameters."""
    values = msgspec.to_builtins(user.behaviour)
    properties = xosc.Properties()
    for name, value in values.items():
        if value is not None:
            properties.add_property(name, value if isinstance(value, str) else msgspec.json.encode(value).decode())
    return xosc.Controller(str(values["kind"]), properties)


def _cut_in(id: str, cut_in: CutIn) -> list[tuple[str, Any]]:
    dynamics = xosc.TransitionDynamics(words.DynamicsShapes.cubic, words.DynamicsDimension.time, cut_in.duration_s)
    if cut_in.offset_m is None:
        change = xosc.RelativeLaneChangeAction(0, EGO, dynamics)
    else:
        lanes = round(cut_in.offset_m / LANE_M)
        change = xosc.RelativeLaneChangeAction(lanes, id, dynamics, round(cut_in.offset_m - lanes * LANE_M, 6))
    actions: list[tuple[str, Any]] = [("change lane", change)]
    if cut_in.to_speed_m_s is not None:
        actions.append(("change speed", _speed(cut_in.to_speed_m_s, cut_in.acceleration_m_s2)))
    return actions


def _speed(to_m_s: float, rate_m_s2: float) -> xosc.AbsoluteSpeedAction:
    dynamics = xosc.TransitionDynamics(words.DynamicsShapes.linear, words.DynamicsDimension.rate, rate_m_s2)
    return xosc.AbsoluteSpeedAction(to_m_s, dynamics)


def _event(id: str, settings: Triggered, gap_m: float, actions: list[tuple[str, Any]]) -> xosc.Maneuver:
    if settings.after_s is not None:
        return _manoeuvre(id, actions, _after(id, settings.after_s))
    if settings.gap_m is not None:
        rule = words.Rule.greaterOrEqual if gap_m < settings.gap_m else words.Rule.lessOrEqual
        gap = xosc.RelativeDistanceCondition(
            settings.gap_m, rule, words.RelativeDistanceType.longitudinal, EGO, freespace=True,
            coordinate_system=words.CoordinateSystem.road,
        )  # fmt: skip
        return _manoeuvre(id, actions, xosc.EntityTrigger(f"{id} gap", 0, words.ConditionEdge.none, gap, id))
    assert settings.time_to_collision_s is not None
    collision = xosc.TimeToCollisionCondition(
        settings.time_to_collision_s, words.Rule.lessOrEqual, entity=id, freespace=True,
        distance_type=words.RelativeDistanceType.longitudinal, coordinate_system=words.CoordinateSystem.road,
    )  # fmt: skip
    trigger = xosc.EntityTrigger(f"{id} time to collision", 0, words.ConditionEdge.none, collision, EGO)
    return _manoeuvre(id, actions, trigger)


def _after(id: str, time_s: float) -> xosc.ValueTrigger:
    condition = xosc.SimulationTimeCondition(time_s, words.Rule.greaterOrEqual)
    return xosc.ValueTrigger(f"{id} time", 0, words.ConditionEdge.none, condition)


def _manoeuvre(id: str, actions: list[tuple[str, Any]], trigger: Any) -> xosc.Maneuver:
    event = xosc.Event(f"{id} event", words.Priority.override)
    event.add_trigger(trigger)
    for name, action in actions:
        event.add_action(f"{id} {name}", action)
    return xosc.Maneuver(f"{id} manoeuvre").add_event(event)
