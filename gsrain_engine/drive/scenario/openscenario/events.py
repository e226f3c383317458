"""What entities of an OpenSCENARIO file do, as behaviours."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ...vehicle.state import VehicleState
from .names import LANE_M
from .places import world_state
from .xml_file import number

_AT_ONCE_M_S2 = 20.0
_LANE_CHANGE, _SPEED, _FOLLOW = (
    "PrivateAction/LateralAction/LaneChangeAction",
    "PrivateAction/LongitudinalAction/SpeedAction",
    "PrivateAction/RoutingAction/FollowTrajectoryAction",
)
_CONDITIONS = ("SimulationTimeCondition", "RelativeDistanceCondition", "TimeToCollisionCondition")


@dataclass(frozen=True, slots=True)
class Actor:
    """Who acts."""

    name: str
    left_m: float
    """Of the ego vehicle, where it begins."""
    speed_m_s: float
    start: VehicleState | None
    """Where it begins in the world, if that is known."""
    ego_name: str
    ego_start: VehicleState | None


def events_of(root: Element, name: str) -> list[tuple[Element, list[Element]]]:
    """Return the events of an entity, each with the triggers that it waits for: its act's and its own."""
    found: list[tuple[Element, list[Element]]] = []
    for act in root.iter("Act"):
        for group in act.iter("ManeuverGroup"):
            if name in [each.get("entityRef") for each in group.iterfind("Actors/EntityRef")]:
                found += [(event, [*act.findall("StartTrigger"), *event.findall("StartTrigger")])
                          for event in group.iter("Event")]  # fmt: skip
    return found


def behaviour(path: Path, root: Element, actor: Actor) -> dict[str, Any]:
    """Return what an entity does as the plain values of a behaviour.

    Raises ValueError, with the file, the entity and the action, for more than one event and for what has no behaviour.
    """
    where = f"{path}: {actor.name}"
    events = events_of(root, actor.name)
    if not events:
        return {"kind": "constant-velocity"} if actor.speed_m_s > 0 else {"kind": "stationary"}
    if len(events) > 1:
        raise ValueError(f"{where} has {len(events)} events: one each can be taken")
    ((event, triggers),) = events
    change, speed, follow = (event.find(f"Action/{each}") for each in (_LANE_CHANGE, _SPEED, _FOLLOW))
    actions = event.findall("Action")
    if not actions or len(actions) != sum(each is not None for each in (change, speed, follow)):
        kinds = {kind.tag for each in actions for kind in each.iterfind("PrivateAction/*")} or {"no private action"}
        raise ValueError(
            f"{where}: {', '.join(sorted(kinds))}: only LaneChangeAction, SpeedAction and FollowTrajectoryAction, one "
            "of each, can be taken"
        )
    if follow is not None:
        return _track(path, follow, actor)
    trigger = _trigger(path, where, triggers)
    new = {} if speed is None else _new_speed(path, where, speed, actor)
    if change is not None:
        return {"kind": "cut-in", **trigger, **_lane_change(path, where, change, actor), **new}
    to, rate = new["to_speed_m_s"], new["acceleration_m_s2"]
    if to < actor.speed_m_s:
        return {"kind": "brake", **trigger, "deceleration_m_s2": rate, "to_speed_m_s": to}
    return {"kind": "cut-in", **trigger, "offset_m": 0.0, **new}


def _lane_change(path: Path, where: str, change: Element, actor: Actor) -> dict[str, Any]:
    target, dynamics = change.find("LaneChangeTarget/RelativeTargetLane"), change.find("LaneChangeActionDynamics")
    if target is None or dynamics is None or target.get("entityRef") not in (actor.name, actor.ego_name):
        raise ValueError(
            f"{where}: a lane change needs a RelativeTargetLane of itself or {actor.ego_name}: there is no map"
        )
    beside = number(path, change, "targetLaneOffset") if "targetLaneOffset" in change.attrib else 0.0
    to = LANE_M * number(path, target, "value") + beside
    offset: float | None = to
    if target.get("entityRef") == actor.ego_name:
        offset = None if to == 0 else to - actor.left_m
    across, value = abs(actor.left_m if offset is None else offset), number(path, dynamics, "value")
    kind = dynamics.get("dynamicsDimension")
    durations = {"time": value, "distance": value / max(actor.speed_m_s, 0.1), "rate": across / max(value, 1e-6)}
    if kind not in durations:
        raise ValueError(f"{where}: dynamicsDimension {kind!r}: only time, distance and rate are known")
    return {"duration_s": durations[kind], "offset_m": offset}


def _new_speed(path: Path, where: str, speed: Element, actor: Actor) -> dict[str, float]:
    target, dynamics = speed.find("SpeedActionTarget/AbsoluteTargetSpeed"), speed.find("SpeedActionDynamics")
    if target is None or dynamics is None:
        raise ValueError(f"{where}: a speed can only be changed to an AbsoluteTargetSpeed")
    to, value = number(path, target, "value"), number(path, dynamics, "value")
    by, kind = abs(to - actor.speed_m_s), dynamics.get("dynamicsDimension")
    rate = _AT_ONCE_M_S2
    if dynamics.get("dynamicsShape") != "step" and value > 0:
        rates = {"rate": value, "time": by / value, "distance": abs(to**2 - actor.speed_m_s**2) / (2 * value)}
        if kind not in rates:
            raise ValueError(f"{where}: dynamicsDimension {kind!r}: only time, distance and rate are known")
        rate = rates[kind]
    return {"to_speed_m_s": to, "acceleration_m_s2": min(max(rate, 1e-3), _AT_ONCE_M_S2)}


def _trigger(path: Path, where: str, triggers: list[Element]) -> dict[str, float]:
    """Return what sets an event off; times of its act and its own both have to pass."""
    after, others = 0.0, list[dict[str, float]]()
    if any(len(trigger.findall("ConditionGroup")) > 1 for trigger in triggers):
        raise ValueError(f"{where}: waits for one of several groups of conditions: only one group can be taken")
    for condition in (each for trigger in triggers for each in trigger.iter("Condition")):
        kind = next((each for each in condition.iter() if each.tag in _CONDITIONS), condition)
        late = number(path, condition, "delay") if "delay" in condition.attrib else 0.0
        if kind.tag == "SimulationTimeCondition":
            after = max(after, number(path, kind, "value") + late)
        elif kind.tag == "TimeToCollisionCondition":
            others.append({"time_to_collision_s": number(path, kind, "value")})
        elif kind.get("relativeDistanceType") == "longitudinal" and kind.get("freespace") == "true":
            others.append({"gap_m": number(path, kind, "value")})
        else:
            raise ValueError(
                f"{where}: waits for {condition.get('name')!r}: only SimulationTimeCondition, TimeToCollisionCondition "
                "and a longitudinal RelativeDistanceCondition in free space can be taken"
            )
    if len(others) > 1 or (others and after > 0):
        raise ValueError(f"{where}: waits for several conditions at once: one can be taken")
    return others[0] if others else {"after_s": after}


def _track(path: Path, follow: Element, actor: Actor) -> dict[str, Any]:
    """Return the points of a trajectory from where its entity begins, ahead and left as the ego vehicle stands."""
    points: list[dict[str, float]] = []
    for vertex in follow.iter("Vertex"):
        position = vertex.find("Position/*")
        there = None if position is None else world_state(path, position)
        if there is None or actor.start is None or actor.ego_start is None:
            raise ValueError(f"{path}: {actor.name}: a trajectory and its beginning must be WorldPositions")
        step = np.array([[there.x_m - actor.start.x_m, there.y_m - actor.start.y_m]])
        frame = VehicleState(0.0, 0.0, actor.ego_start.yaw_rad)
        ahead, left = frame.from_world(step)[0]
        time_s = number(path, vertex, "time")
        if time_s > 0:
            points.append({"time_s": time_s, "ahead_m": float(ahead), "left_m": float(left)})
    if not points:
        raise ValueError(f"{path}: {actor.name}: its trajectory is no polyline with times: nothing can be followed")
    return {"kind": "track", "points": points}
