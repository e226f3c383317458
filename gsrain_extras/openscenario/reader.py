"""Import of OpenSCENARIO XML files, as far as they need no map."""

import math
import re
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import msgspec
import numpy as np

from gsrain_engine.safe_io.errors import convert_checked
from gsrain_engine.safe_io.text_files import printable_line, read_whole
from gsrain_engine.simulation.geometry import wrap_degrees
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.simulation.vehicle import Vehicle, VehicleState


def read_openscenario(path: Path) -> Scenario:
    """Read an OpenSCENARIO XML file, version 1.0 to 1.3.

    Supported: vehicles with their boxes, initial positions (WorldPosition; RelativeLanePosition and
    RelativeObjectPosition to the ego vehicle, lanes 3.5 m wide) and speeds; one event each, of a lane change, a change
    of speed or a trajectory with times, triggered by time, gap or time to collision; precipitation in mm/h (from 1.1
    on; a unitless share before) and wind; the stop time of the storyboard. The ego vehicle is the entity named Ego or
    hero, or else the first; its actions are ignored, since the agent drives it. It starts at the start of the scene's
    own drive, and all others are placed relative to it.

    Raises ValueError, naming the file and the element, for unsupported content that matters.
    """
    data = read_whole(path)
    try:
        return _Document(parse_xml(data)).scenario(path.stem)
    except ValueError as error:
        raise ValueError(f"{path}: {printable_line(error)}") from None


class InitialState(NamedTuple):
    """Position of an entity's teleport action, and its initial speed."""

    position: Element
    speed_m_s: float


class _Document:
    """A parsed file: its entities, and where they begin."""

    def __init__(self, root: Element) -> None:
        self._root = root
        self._entities = {each.get("name", ""): each for each in root.iterfind("Entities/ScenarioObject")}
        self._begun = initial_states(root)
        if not self._entities:
            raise ValueError("there are no ScenarioObjects in it")
        names = list(self._entities)
        self._ego_name = next((name for name in names if name.lower() in ("ego", "hero")), names[0])
        missing = next((name for name in names if name not in self._begun), None)
        if missing is not None:
            raise ValueError(f"{missing} is not teleported anywhere at the start")

    def scenario(self, name: str) -> Scenario:
        header = self._root.find("FileHeader")
        own = {} if header is None else properties(header)
        vehicle = ego_vehicle(self._entities[self._ego_name])
        stop = self._root.find("Storyboard/StopTrigger")
        end = None if stop is None else stop.find(".//SimulationTimeCondition")
        others = {name: entity for name, entity in self._entities.items() if name != self._ego_name}
        actors = [name for name, entity in others.items() if properties(*entity).get(f"{PROPERTY}kept") == "true"]
        plain = {
            "name": name,
            "description": "" if header is None else header.get("description", ""),
            "speed_m_s": self._begun[self._ego_name].speed_m_s,
            "keep": actors,
            "road_users": [self._user(name, vehicle) for name in others if name not in actors],
            "rain": _rain(self._root, own),
            "vehicle": msgspec.to_builtins(vehicle),
            **({} if end is None else {"duration_s": number(end, "value")}),
            **{name: own[PROPERTY + name] for name in OWN_FIELDS if PROPERTY + name in own},
        }
        return convert_checked(plain, Scenario, strict=False)

    def _user(self, name: str, vehicle: Vehicle) -> dict[str, Any]:
        entity, begins = self._entities[name], self._begun[name]
        box = box_of(entity)
        where = placed(name, begins, self._ego_name, self._begun[self._ego_name])
        # OpenSCENARIO places both by reference points, scenarios by centers.
        turned, ahead = np.radians(where["turned_deg"]), 0.0 if box is None else box[1]
        where["ahead_m"] += ahead * float(np.cos(turned)) - vehicle.middle_m
        where["left_m"] += ahead * float(np.sin(turned))
        where |= {each: round(where[each], 6) for each in ("ahead_m", "left_m")}
        behaviour = properties(*entity.findall("ObjectController[1]/Controller[1]"))
        return {
            "id": name,
            **model_and_class_of(name, entity),
            **({} if box is None else {"size_lwh_m": box[0]}),
            **where,
            "speed_m_s": begins.speed_m_s,
            "behaviour": behaviour if "kind" in behaviour else self._behavior(name, where["left_m"]),
        }

    def _behavior(self, name: str, left_m: float) -> dict[str, Any]:
        """Return the behavior of an entity that begins so far left of the ego vehicle, as plain values.

        Raises ValueError for several events, or an action without a behavior.
        """
        events, speed_m_s = events_of(self._root, name), self._begun[name].speed_m_s
        if not events:
            return {"kind": "constant-velocity" if speed_m_s > 0 else "stationary"}
        if len(events) > 1:
            raise ValueError(f"{name} has {len(events)} events: one each can be taken")
        ((event, triggers),) = events
        change, speed, follow = (event.find(f"Action/{each}") for each in (_LANE_CHANGE, _SPEED, _FOLLOW))
        actions = event.findall("Action")
        if not actions or len(actions) != sum(each is not None for each in (change, speed, follow)):
            kinds = {kind.tag for each in actions for kind in each.iterfind("PrivateAction/*")} or {"no private action"}
            raise ValueError(
                f"{name}: {', '.join(sorted(kinds))}: only LaneChangeAction, SpeedAction and FollowTrajectoryAction, "
                "one of each, can be taken"
            )
        if follow is not None:
            return self._track(name, follow)
        trigger = _trigger(name, triggers)
        new = {} if speed is None else _new_speed(name, speed, speed_m_s)
        if change is not None:
            return {"kind": "cut-in", **trigger, **self._lane_change(name, change, left_m), **new}
        to, rate = new["to_speed_m_s"], new["acceleration_m_s2"]
        if to < speed_m_s:
            return {"kind": "brake", **trigger, "deceleration_m_s2": rate, "to_speed_m_s": to}
        return {"kind": "cut-in", **trigger, "offset_m": 0.0, **new}

    def _lane_change(self, name: str, change: Element, left_m: float) -> dict[str, Any]:
        target, dynamics = change.find("LaneChangeTarget/RelativeTargetLane"), change.find("LaneChangeActionDynamics")
        if target is None or dynamics is None or target.get("entityRef") not in (name, self._ego_name):
            raise ValueError(
                f"{name}: a lane change needs a RelativeTargetLane of itself or {self._ego_name}: there is no map"
            )
        to = LANE_M * number(target, "value") + number(change, "targetLaneOffset", 0.0)
        offset: float | None = to
        if target.get("entityRef") == self._ego_name:
            offset = None if to == 0 else to - left_m
        across, value = abs(left_m if offset is None else offset), number(dynamics, "value")
        along = value / max(self._begun[name].speed_m_s, 0.1)
        durations = {"time": value, "distance": along, "rate": across / max(value, 1e-6)}
        return {"duration_s": _by_dimension(name, dynamics, durations), "offset_m": offset}

    def _track(self, name: str, follow: Element) -> dict[str, Any]:
        """Return the points of a trajectory from its start, ahead and left in the ego vehicle's initial axes."""
        start, ego = (world_state(self._begun[each].position) for each in (name, self._ego_name))
        points: list[dict[str, float]] = []
        for vertex in follow.iter("Vertex"):
            position = vertex.find("Position/*")
            there = None if position is None else world_state(position)
            if there is None or start is None or ego is None:
                raise ValueError(f"{name}: a trajectory and its begins must be WorldPositions")
            step = np.array([[there.x_m - start.x_m, there.y_m - start.y_m]])
            ahead, left = VehicleState(0.0, 0.0, ego.yaw_rad).from_world(step)[0]
            time_s = number(vertex, "time")
            if time_s > 0:
                points.append({"time_s": time_s, "ahead_m": float(ahead), "left_m": float(left)})
        if not points:
            raise ValueError(f"{name}: its trajectory is no polyline with times: nothing can be followed")
        return {"kind": "track", "points": points}


def _rain(root: Element, own: dict[str, str]) -> dict[str, Any]:
    first = root.find("Storyboard/Init/Actions/GlobalAction/EnvironmentAction")
    if any(each is not first or each.find("Environment") is None for each in root.iter("EnvironmentAction")):
        raise ValueError("weather that changes, or comes from a catalogue: only one Environment at the start")
    weather = None if first is None else first.find("Environment/Weather")
    plain: dict[str, Any] = {"seed": own.get(f"{PROPERTY}seed", "0")}
    rain, wind = (None, None) if weather is None else (weather.find("Precipitation"), weather.find("Wind"))
    if rain is not None and rain.get("precipitationType") != "dry":
        if rain.get("precipitationType") != "rain":
            raise ValueError(f"it {rain.get('precipitationType')}s: only rain falls here")
        if "precipitationIntensity" not in rain.attrib:
            raise ValueError("precipitation without precipitationIntensity: its share 0..1 says no mm/h")
        plain["intensity_mm_h"] = number(rain, "precipitationIntensity")
    if wind is not None:
        speed, direction = number(wind, "speed"), number(wind, "direction")
        plain["wind_m_s"] = [round(float(speed * each(direction)), 9) + 0.0 for each in (np.cos, np.sin)]
    return plain


# Behaviors

_IMMEDIATE_M_S2 = 20.0

_LANE_CHANGE = "PrivateAction/LateralAction/LaneChangeAction"
_SPEED = "PrivateAction/LongitudinalAction/SpeedAction"
_FOLLOW = "PrivateAction/RoutingAction/FollowTrajectoryAction"

_CONDITIONS = ("SimulationTimeCondition", "RelativeDistanceCondition", "TimeToCollisionCondition")


def events_of(root: Element, name: str) -> list[tuple[Element, list[Element]]]:
    """Return the events of an entity, each with the triggers of its act and its own."""
    return [
        (event, [*act.findall("StartTrigger"), *event.findall("StartTrigger")])
        for act in root.iter("Act")
        for group in act.iter("ManeuverGroup")
        if name in [each.get("entityRef") for each in group.iterfind("Actors/EntityRef")]
        for event in group.iter("Event")
    ]


def _new_speed(where: str, speed: Element, from_m_s: float) -> dict[str, float]:
    target, dynamics = speed.find("SpeedActionTarget/AbsoluteTargetSpeed"), speed.find("SpeedActionDynamics")
    if target is None or dynamics is None:
        raise ValueError(f"{where}: a speed can only be changed to an AbsoluteTargetSpeed")
    to, value = number(target, "value"), number(dynamics, "value")
    rate = _IMMEDIATE_M_S2
    if dynamics.get("dynamicsShape") != "step" and value > 0:
        rates = {"rate": value, "time": abs(to - from_m_s) / value, "distance": abs(to**2 - from_m_s**2) / (2 * value)}
        rate = _by_dimension(where, dynamics, rates)
    return {"to_speed_m_s": to, "acceleration_m_s2": min(max(rate, 1e-3), _IMMEDIATE_M_S2)}


def _by_dimension(where: str, dynamics: Element, values: dict[str, float]) -> float:
    kind = dynamics.get("dynamicsDimension")
    if kind is None or kind not in values:
        raise ValueError(f"{where}: dynamicsDimension {kind!r}: only time, distance and rate are known")
    return values[kind]


def _trigger(where: str, triggers: list[Element]) -> dict[str, float]:
    """Return the trigger of an event; times of its act and its own both have to pass."""
    after, others = 0.0, list[dict[str, float]]()
    if any(len(trigger.findall("ConditionGroup")) > 1 for trigger in triggers):
        raise ValueError(f"{where}: waits for one of several groups of conditions: only one group can be taken")
    for condition in (each for trigger in triggers for each in trigger.iter("Condition")):
        kind = next((each for each in condition.iter() if each.tag in _CONDITIONS), condition)
        late = number(condition, "delay", 0.0)
        if kind.tag == "SimulationTimeCondition":
            after = max(after, number(kind, "value") + late)
        elif kind.tag == "TimeToCollisionCondition":
            others.append({"time_to_collision_s": number(kind, "value")})
        elif kind.get("relativeDistanceType") == "longitudinal" and kind.get("freespace") == "true":
            others.append({"gap_m": number(kind, "value")})
        else:
            raise ValueError(
                f"{where}: waits for {condition.get('name')!r}: only SimulationTimeCondition, TimeToCollisionCondition "
                "and a longitudinal RelativeDistanceCondition in free space can be taken"
            )
    if len(others) > 1 or (others and after > 0):
        raise ValueError(f"{where}: waits for several conditions at once: one can be taken")
    return others[0] if others else {"after_s": after}


# Vehicles and pedestrians

_MODELS = {"car": "saloon", "van": "van", "truck": "truck", "bus": "truck", "semitrailer": "truck"}
_CLASSES = {"van": "car", "semitrailer": "truck", "motorbike": "motorcycle"}


def model_and_class_of(name: str, entity: Element) -> dict[str, str]:
    """Return model and class of an entity; raises ValueError without a matching model."""
    vehicle = entity.find("Vehicle")
    if vehicle is not None:
        category = vehicle.get("vehicleCategory", "car")
    elif entity.find("CatalogReference") is not None:
        category = "car"
    else:
        category = "thing" if entity.find("Pedestrian") is None else "person"
    model = properties(*entity).get(f"{PROPERTY}model", _MODELS.get(category))
    if model is None:
        remedy = f'name one in its property "{PROPERTY}model"'
        raise ValueError(f"{name} is a {category}, of which there is no model: {remedy}")
    return {"model": model, "class_name": _CLASSES.get(category, category)}


def box_of(entity: Element) -> tuple[tuple[float, float, float], float] | None:
    """Return length, width and height of an entity, and the forward offset of its center from its reference point."""
    size, middle = entity.find("*/BoundingBox/Dimensions"), entity.find("*/BoundingBox/Center")
    if size is None or middle is None:
        return None
    length, width, height = (number(size, each) for each in ("length", "width", "height"))
    return (length, width, height), number(middle, "x")


def ego_vehicle(entity: Element) -> Vehicle:
    """Return the ego vehicle; missing or implausible values default to a mid-size car's."""
    box, performance = box_of(entity), entity.find("Vehicle/Performance")
    plain: dict[str, Any] = {}
    if box is not None:
        (length, width, height), middle = box
        plain |= {"length_m": length, "width_m": width, "height_m": height}
        plain["rear_overhang_m"] = round(length / 2 - middle, 6)
    axles = [entity.find(f"Vehicle/Axles/{name}") for name in ("FrontAxle", "RearAxle")]
    if axles[0] is not None and axles[1] is not None:
        plain["wheelbase_m"] = number(axles[0], "positionX") - number(axles[1], "positionX")
        plain["most_steer_rad"] = min(number(axles[0], "maxSteering"), 1.5)
    if performance is not None:
        plain["most_acceleration_m_s2"] = min(number(performance, "maxAcceleration"), 20.0)
        plain["most_braking_m_s2"] = min(number(performance, "maxDeceleration"), 20.0)
        plain["top_speed_m_s"] = min(number(performance, "maxSpeed"), 100.0)
    try:
        return convert_checked(plain, Vehicle)
    except msgspec.ValidationError as error:
        raise ValueError(f"the ego vehicle: {error}") from None


def initial_states(root: Element) -> dict[str, InitialState]:
    """Return the entities' initial positions and speeds by name; raises ValueError for relative speeds."""
    found: dict[str, InitialState] = {}
    for private in root.iterfind("Storyboard/Init/Actions/Private"):
        name = private.get("entityRef", "")
        position = private.find("PrivateAction/TeleportAction/Position/*")
        if position is None:
            continue
        action = private.find("PrivateAction/LongitudinalAction/SpeedAction")
        speed = None if action is None else action.find("SpeedActionTarget/AbsoluteTargetSpeed")
        if action is not None and speed is None:
            raise ValueError(f"{name} begins at a speed that is no AbsoluteTargetSpeed")
        found[name] = InitialState(position, 0.0 if speed is None else number(speed, "value"))
    return found


def world_state(position: Element) -> VehicleState | None:
    """Return the pose of a WorldPosition; None for other kinds of positions, which need a map."""
    if position.tag != "WorldPosition":
        return None
    return VehicleState(number(position, "x"), number(position, "y"), number(position, "h", 0.0))


def placed(name: str, begins: InitialState, ego_name: str, ego: InitialState) -> dict[str, Any]:
    """Return its place relative to the ego vehicle; raises ValueError for positions that need a map."""
    position = begins.position
    if position.tag == "WorldPosition":
        from_, there = world_state(ego.position), world_state(position)
        if from_ is None or there is None:
            raise ValueError(f"{name} has a WorldPosition, {ego_name} a {ego.position.tag}: both must be in the world")
        ahead, left = from_.from_world(np.array([[there.x_m, there.y_m]]))[0]
        return _fields("straight", float(ahead), float(left), there.yaw_rad - from_.yaw_rad)
    if position.get("entityRef") != ego_name or position.tag not in ("RelativeLanePosition", "RelativeObjectPosition"):
        raise ValueError(
            f"{name} begins at a {position.tag}: without a map only WorldPosition, and RelativeLanePosition "
            f"and RelativeObjectPosition to {ego_name}, have a place"
        )
    turned = position.find("Orientation")
    heading = 0.0 if turned is None or turned.get("type") != "relative" else number(turned, "h", 0.0)
    if position.tag == "RelativeObjectPosition":
        return _fields("straight", number(position, "dx"), number(position, "dy"), heading)
    left = LANE_M * number(position, "dLane") + number(position, "offset", 0.0)
    return _fields("along-route", number(position, "ds"), left, heading)


def _fields(kind: str, ahead_m: float, left_m: float, turned_rad: float) -> dict[str, Any]:
    degrees = wrap_degrees(float(np.degrees(turned_rad)))
    return {"placed": kind, "ahead_m": ahead_m, "left_m": left_m, "turned_deg": round(degrees, 6)}


# XML parsing: for untrusted files, with parameters substituted

_MAX_VALUE = 1e9  # maximum of any length, time, speed or angle; keeps products finite
_PARAMETER = re.compile(r"\$(\w+)")


class _NoDocumentType(ElementTree.TreeBuilder):
    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise ValueError("a document type: OpenSCENARIO files have none, and entities can be made to blow up")


def parse_xml(data: bytes) -> Element:
    """Parse a file; returns its root `OpenSCENARIO` with all `$parameters` replaced by their declared values.

    Files with a document type are rejected, so no entities are expanded and no other files opened.
    """
    parser = ElementTree.XMLParser(target=_NoDocumentType())
    try:
        parser.feed(data)
        root: Element = parser.close()
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # LookupError: unknown encoding
        raise ValueError(printable_line(error)) from None
    if root.tag != "OpenSCENARIO" or root.find("Storyboard") is None:
        raise ValueError("not an OpenSCENARIO scenario: there is no Storyboard in it")
    declared = {each.get("name", ""): each.get("value", "") for each in root.iter("ParameterDeclaration")}
    for element in root.iter():
        for name, value in element.attrib.items():
            if value.startswith("$") and element.tag != "ParameterDeclaration":
                match = _PARAMETER.fullmatch(value)
                if match is None or match[1] not in declared:
                    reason = "only declared parameters are put in, no expressions"
                    raise ValueError(f'{element.tag}@{name}="{value}": {reason}')
                element.set(name, declared[match[1]])
    return root


def number(element: Element, name: str, default: float | None = None) -> float:
    """Return an attribute as a number, or the default if it is missing; raises ValueError for anything else."""
    value = element.get(name)
    if value is None and default is not None:
        return default
    try:
        found = float(value or "")
    except ValueError:
        found = math.nan
    if not abs(found) <= _MAX_VALUE:
        stands = "is missing" if value is None else f'is "{value}"'
        raise ValueError(f"{element.tag}@{name} {stands}: expected a number")
    return found


def properties(*elements: Element) -> dict[str, str]:
    """Return the values of the `Properties` of elements."""
    rows = (row for element in elements for row in element.findall("Properties[1]/Property"))
    return {row.get("name", ""): row.get("value", "") for row in rows}


# Shared names of reader and writer

EGO = "Ego"
PROPERTY = "gsrain."  # prefix of GSRAIN's own properties

OWN_FIELDS = (
    "name", "scene", "rig", "start_s", "ahead_m", "left_m", "turned_deg", "step_s", "leave_m", "picture_width_px",
)  # fmt: skip
"""Scenario fields without an OpenSCENARIO equivalent."""

LANE_M = 3.5  # lane width, of the written road and of lanes in files that are read
