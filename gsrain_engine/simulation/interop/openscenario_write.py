"""Export of scenarios as OpenSCENARIO XML with an OpenDRIVE road."""

import datetime
import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np
from scenariogeneration import xosc

from ...rain.calibration import load_calibration
from ...rain.properties import rain_properties
from ...rain.settings import RainSettings
from ...rain.wetness import SOAKING_DEPTH_MM, water_depth_mm
from ...scene.files import whole_file
from ...scene.objects import coco_class
from ...scene.scene import Scene
from ..ground import road_surface_of
from ..route import recorded_route
from ..scenario import Scenario, ScenarioUser, Traffic, start_state
from ..traffic.base import RoadUser, ego_user, gap_between
from ..traffic.models import Brake, CutIn, Triggered
from ..vehicle import Vehicle
from .openscenario_read import EGO, LANE_M, OWN_FIELDS, PROPERTY

_MINOR = 2
_DATE = datetime.datetime(2000, 1, 1)  # fixed date, so that the same scenario gives the same bytes


def document_xml(scenario: Scenario, scene: Scene, road_file: str) -> str:
    """Return the document as text; `road_file` is the referenced OpenDRIVE file."""
    route, ground = recorded_route(scene), road_surface_of(scene)
    traffic = Traffic(scenario, scene, route, ground)
    state = start_state(scenario, scene, route)
    ego = ego_user(scenario.vehicle, state)
    started, sampled = {user.id: user for user in traffic.users}, record_paths(scenario, traffic, ego)

    entities, init = xosc.Entities(), xosc.Init()
    init.add_global_action(environment_of(scenario.rain))
    entities.add_scenario_object(EGO, ego_entity(scenario.vehicle))
    height = ground.height_m(state.x_m, state.y_m)
    _begin(init, EGO, (state.x_m, state.y_m, height, state.yaw_rad), state.speed_m_s)
    end = xosc.SimulationTimeCondition(scenario.duration_s, words.Rule.greaterOrEqual)
    stop = xosc.ValueTrigger("end", 0, words.ConditionEdge.none, end, triggeringpoint="stop")
    board = xosc.StoryBoard(init, stop)
    own = {user.id: user for user in scenario.road_users}
    for there in traffic.everybody:
        user, way = own.get(there.id), sampled[there.id]
        _add(entities, there, user)
        _begin(init, there.id, way.places[0], there.speed_m_s)
        gap = gap_between(route, started[there.id], ego) if there.id in started else 0.0
        does = _does(there.id, user, way, gap)
        if does is not None:
            board.add_maneuver(does, there.id)
    return _text(scenario, entities, board, road_file)


def _kind(user: ScenarioUser) -> str:
    return str(msgspec.to_builtins(user.behaviour)["kind"])


def _add(entities: xosc.Entities, there: RoadUser, user: ScenarioUser | None) -> None:
    """Add a road user of the scenario, or an actor of the scene that it keeps."""
    if there.id == EGO:
        raise ValueError(f"road user {EGO!r}: in OpenSCENARIO files that is the ego vehicle's name")
    properties = {"kept": "true"} if user is None else {"model": user.model}
    entity = user_entity(there.class_name, there.size_lwh, properties)
    follows = controller(user) if user is not None and _kind(user) == "idm" else None
    entities.add_scenario_object(there.id, entity, follows)


# Maneuvers

Place = tuple[float, float, float, float]
"""World x, y, z and heading."""

# Recorded paths
# Sampled at every step, for trajectories.


@dataclass(frozen=True, slots=True)
class RecordedPath:
    """Poses of a road user and their times in seconds since the scenario began; the first is where it appears."""

    times_s: list[float] = field(default_factory=list[float])
    places: list[Place] = field(default_factory=list[Place])


def _does(id: str, user: ScenarioUser | None, way: RecordedPath, gap_m: float) -> xosc.Maneuver | None:
    if user is None or _kind(user) in ("track", "replay"):
        return trajectory(id, way.times_s, way.places) if len(way.times_s) > 1 else None
    return maneuver(user, gap_m)


def _begin(init: xosc.Init, id: str, place: Place, speed_m_s: float) -> None:
    at_once = xosc.TransitionDynamics(words.DynamicsShapes.step, words.DynamicsDimension.time, 0)
    init.add_init_action(id, xosc.TeleportAction(position(place)))
    init.add_init_action(id, xosc.AbsoluteSpeedAction(speed_m_s, at_once))


def _text(scenario: Scenario, entities: xosc.Entities, board: xosc.StoryBoard, road_file: str) -> str:
    values, properties = msgspec.to_builtins(scenario), xosc.Properties()
    for name in OWN_FIELDS:
        if values[name] is not None:
            value = values[name]
            properties.add_property(PROPERTY + name, value if isinstance(value, str) else str(value))
    properties.add_property(f"{PROPERTY}seed", str(scenario.rain.seed))
    whole = xosc.Scenario(
        scenario.description or scenario.name, "gsrain", xosc.ParameterDeclarations(), entities, board,
        xosc.RoadNetwork(road_file), xosc.Catalog(), osc_minor_version=_MINOR, creation_date=_DATE,
        header_properties=properties,
    )  # fmt: skip
    root = whole.get_element()
    ElementTree.indent(root, "    ")
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, "unicode") + "\n"


# Entities

_CATEGORIES = {"car": "car", "truck": "truck", "bus": "bus", "motorcycle": "motorbike", "bicycle": "bicycle"}
_WHEEL_M = 0.65


def ego_entity(vehicle: Vehicle) -> xosc.Vehicle:
    """Return the ego vehicle; its reference point is below the rear axle in both formats."""
    track = round(0.85 * vehicle.width_m, 6)
    return xosc.Vehicle(
        "ego vehicle",
        words.VehicleCategory.car,
        _box((vehicle.length_m, vehicle.width_m, vehicle.height_m), vehicle.middle_m),
        xosc.Axle(vehicle.most_steer_rad, _WHEEL_M, track, vehicle.wheelbase_m, _WHEEL_M / 2),
        xosc.Axle(0.0, _WHEEL_M, track, 0.0, _WHEEL_M / 2),
        vehicle.top_speed_m_s,
        vehicle.most_acceleration_m_s2,
        vehicle.most_braking_m_s2,
    )


def user_entity(
    class_name: str, size_lwh_m: tuple[float, float, float], properties: Mapping[str, str]
) -> xosc.Vehicle | xosc.Pedestrian:
    """Return a road user; its reference point is below its center."""
    kind, box = coco_class(class_name), _box(size_lwh_m, 0.0)
    if kind == "person":
        entity = xosc.Pedestrian(class_name, 75.0, words.PedestrianCategory.pedestrian, box)
    else:
        length, width, _ = size_lwh_m
        front, rear = (xosc.Axle(steer, _WHEEL_M, round(0.85 * width, 6), round(side * 0.3 * length, 6), _WHEEL_M / 2)
                       for steer, side in ((0.6, 1), (0.0, -1)))  # fmt: skip
        category = getattr(words.VehicleCategory, _CATEGORIES.get(kind, "car"))
        entity = xosc.Vehicle(class_name, category, box, front, rear, 50.0, 5.0, 10.0)
    for name, value in properties.items():
        entity.add_property(PROPERTY + name, value)
    return entity


def _box(size_lwh_m: tuple[float, float, float], ahead_m: float) -> xosc.BoundingBox:
    length, width, height = size_lwh_m
    return xosc.BoundingBox(width, length, height, round(ahead_m, 6), 0.0, round(height / 2, 6))


# Writing


def write_openscenario(path: Path, scenario: Scenario, scene: Scene) -> None:
    """Write OpenSCENARIO XML 1.2 to `path` (.xosc) and the road next to it (.xodr), byte-identical for equal input.

    Positions and headings are in the scene's world frame, meters; the ego vehicle is called Ego. Rain is written as
    precipitation in mm/h, with its visual range as fog; roads are marked wet, with unchanged friction. Road users use
    native OpenSCENARIO elements where possible: teleports, speeds, lane changes (cubic instead of quintic),
    trajectories, triggers by time, gap and time to collision. Car following becomes a controller with its parameters as
    properties. `read_openscenario` restores everything; GSRAIN's own values (model, rig, start in the recorded drive)
    are properties named `gsrain.*`.

    Raises ValueError like `Simulation` if the scene lacks something that the scenario needs, and ModuleNotFoundError,
    with install instructions, without the package scenariogeneration.
    """
    if importlib.util.find_spec("scenariogeneration") is None:
        raise ModuleNotFoundError(
            "writing OpenSCENARIO needs scenariogeneration: pip install 'gsrain[drive]'", name="scenariogeneration"
        )
    from .opendrive import road_xml

    road = path.with_suffix(".xodr")
    written = {road: road_xml(scenario, scene), path: document_xml(scenario, scene, road.name)}
    for each, text in written.items():
        with whole_file(each) as beside:
            beside.write_text(text, encoding="utf-8")


def maneuver(user: ScenarioUser, gap_m: float) -> xosc.Maneuver | None:
    """Return the maneuver of a triggered road user; None for other behaviors.

    `gap_m` is its initial gap to the ego vehicle, which decides whether the trigger is a shrinking or growing gap.
    """
    behaviour = user.behaviour
    if isinstance(behaviour, CutIn):
        return _event(user.id, behaviour, gap_m, _cut_in(user.id, behaviour))
    if isinstance(behaviour, Brake):
        speed = _speed(behaviour.to_speed_m_s, behaviour.deceleration_m_s2)
        return _event(user.id, behaviour, gap_m, [("brake", speed)])
    return None


def trajectory(id: str, times_s: Sequence[float], places: Sequence[Place]) -> xosc.Maneuver:
    """Return a trajectory that is followed by time from the start."""
    way = xosc.Trajectory(f"{id} way", False)
    way.add_shape(xosc.Polyline(list(times_s), [position(place) for place in places]))
    follow = xosc.FollowTrajectoryAction(way, words.FollowingMode.position, words.ReferenceContext.absolute, 1, 0)
    return _maneuver(id, [("follow", follow)], _after(id, 0.0))


def position(place: Place) -> xosc.WorldPosition:
    """Return a world position, to the micrometer and the nanoradian."""
    x, y, z = (round(each, 6) for each in place[:3])
    return xosc.WorldPosition(x, y, z, round(place[3], 9), 0, 0)


def controller(user: ScenarioUser) -> xosc.Controller:
    """Return a controller with name and parameters, for a behavior without an OpenSCENARIO action."""
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
        return _maneuver(id, actions, _after(id, settings.after_s))
    if settings.gap_m is not None:
        rule = words.Rule.greaterOrEqual if gap_m < settings.gap_m else words.Rule.lessOrEqual
        gap = xosc.RelativeDistanceCondition(
            settings.gap_m, rule, words.RelativeDistanceType.longitudinal, EGO, freespace=True,
            coordinate_system=words.CoordinateSystem.road,
        )  # fmt: skip
        return _maneuver(id, actions, xosc.EntityTrigger(f"{id} gap", 0, words.ConditionEdge.none, gap, id))
    assert settings.time_to_collision_s is not None
    collision = xosc.TimeToCollisionCondition(
        settings.time_to_collision_s, words.Rule.lessOrEqual, entity=id, freespace=True,
        distance_type=words.RelativeDistanceType.longitudinal, coordinate_system=words.CoordinateSystem.road,
    )  # fmt: skip
    trigger = xosc.EntityTrigger(f"{id} time to collision", 0, words.ConditionEdge.none, collision, EGO)
    return _maneuver(id, actions, trigger)


def _after(id: str, time_s: float) -> xosc.ValueTrigger:
    condition = xosc.SimulationTimeCondition(time_s, words.Rule.greaterOrEqual)
    return xosc.ValueTrigger(f"{id} time", 0, words.ConditionEdge.none, condition)


def _maneuver(id: str, actions: list[tuple[str, Any]], trigger: Any) -> xosc.Maneuver:
    event = xosc.Event(f"{id} event", words.Priority.override)
    event.add_trigger(trigger)
    for name, action in actions:
        event.add_action(f"{id} {name}", action)
    return xosc.Maneuver(f"{id} manoeuvre").add_event(event)


def record_paths(scenario: Scenario, traffic: Traffic, ego: RoadUser) -> dict[str, RecordedPath]:
    """Simulate all road users around a standing ego vehicle and record their poses."""
    found: dict[str, RecordedPath] = {}
    for step in range(round(scenario.duration_s / scenario.step_s) + 1):
        time_s = step * scenario.step_s
        for user in traffic.users:
            way = found.setdefault(user.id, RecordedPath())
            way.times_s.append(time_s)
            way.places.append((user.x_m, user.y_m, user.z_m, user.yaw_rad))
        traffic.advance(time_s, ego, scenario.step_s)
    return found


# Weather


def environment_of(rain: RainSettings) -> xosc.EnvironmentAction:
    """Return the weather action: precipitation in mm/h, fog of the rain's visual range, wind, wetness.

    The visual range is the meteorological optical range ln(20) / beta of the rain's own extinction. Friction stays 1,
    because vehicles do not slip in the simulation.
    """
    intensity = rain.intensity_mm_h
    kind = words.PrecipitationType.rain if intensity > 0 else words.PrecipitationType.dry
    fog = wind = cloud = None
    if intensity > 0:
        cloud = words.FractionalCloudCover.eightOktas
        visibility = rain_properties(rain, load_calibration(rain.calibration)).visibility_m
        fog = None if np.isinf(visibility) else words.Fog(round(visibility, 1))
    x, y = rain.wind_m_s
    if x or y:
        wind = xosc.Wind(float(np.arctan2(y, x)) % (2 * np.pi), float(np.hypot(x, y)))
    weather = xosc.Weather(cloud, fog=fog, precipitation=xosc.Precipitation(kind, intensity), wind=wind)
    road = xosc.RoadCondition(1.0, wetness=_wetness(intensity))
    return xosc.EnvironmentAction(xosc.Environment("weather", weather=weather, roadcondition=road))


def _wetness(intensity_mm_h: float) -> Any:
    if intensity_mm_h == 0:
        return words.Wetness.dry
    soaks = water_depth_mm(intensity_mm_h) >= SOAKING_DEPTH_MM
    return words.Wetness.wetWithPuddles if soaks else words.Wetness.moist


# Enumerations
# scenariogeneration declares them as another type than its own classes accept.

words: Any = xosc
"""`words.Rule.lessOrEqual`, `words.PrecipitationType.rain`, ..."""
