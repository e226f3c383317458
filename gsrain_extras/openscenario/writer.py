"""Export of scenarios as OpenSCENARIO XML with an OpenDRIVE road."""

import datetime
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np
import shapely
from jaxtyping import Float64

from gsrain_engine.optional_packages import MissingPackageError, missing_package
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.properties import rain_properties
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.wetness import water_depth_mm
from gsrain_engine.safe_io.files import whole_file
from gsrain_engine.scene.objects import coco_class
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.ground import recorded_route, road_surface_of
from gsrain_engine.simulation.scenario import Scenario, ScenarioUser, Traffic, start_state
from gsrain_engine.simulation.traffic.base import RoadUser, ego_user, gap_between
from gsrain_engine.simulation.traffic.settings import Brake, CutIn, Triggered
from gsrain_engine.simulation.vehicle import Vehicle

from .reader import EGO, LANE_M, OWN_FIELDS, PROPERTY

try:
    from scenariogeneration import xodr, xosc
except ModuleNotFoundError as error:
    raise MissingPackageError(missing_package("scenariogeneration", "writing OpenSCENARIO")) from error

words: Any = xosc
"""Enumerations: scenariogeneration declares them as another type than its own classes accept."""

_DATE = datetime.datetime(2000, 1, 1)  # fixed date, so that the same scenario gives the same bytes


def write_openscenario(path: Path, scenario: Scenario, scene: Scene) -> None:
    """Write OpenSCENARIO XML 1.2 to `path` (.xosc) and the road next to it (.xodr), byte-identical for equal input.

    Positions and headings are in the scene's world frame, meters; the ego vehicle is called Ego. Rain is written as
    precipitation in mm/h, with its visual range as fog; roads are marked wet, with unchanged friction. Road users use
    native OpenSCENARIO elements where possible: teleports, speeds, lane changes (cubic instead of quintic),
    trajectories, triggers by time, gap and time to collision. Car following becomes a controller with its parameters as
    properties. `read_openscenario` restores everything; GSRAIN's own values (model, rig, start in the recorded drive)
    are properties named `gsrain.*`.

    Raises ValueError like `Simulation` if the scene lacks something that the scenario needs.
    """
    road = path.with_suffix(".xodr")
    written = {road: road_xml(scenario, scene), path: document_xml(scenario, scene, road.name)}
    for each, text in written.items():
        with whole_file(each) as partial:
            partial.write_text(text, encoding="utf-8")


def document_xml(scenario: Scenario, scene: Scene, road_file: str) -> str:
    """Return the document as text; `road_file` is the referenced OpenDRIVE file."""
    route, ground = recorded_route(scene), road_surface_of(scene)
    traffic = Traffic(scenario, scene, route, ground)
    state = start_state(scenario, scene, route)
    ego = ego_user(scenario.vehicle, state)
    started, recorded = {user.id: user for user in traffic.users}, record_paths(scenario, traffic, ego)

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
        if there.id == EGO:
            raise ValueError(f"road user {EGO!r}: in OpenSCENARIO files that is the ego vehicle's name")
        user, path = own.get(there.id), recorded[there.id]
        kind = "replay" if user is None else str(msgspec.to_builtins(user.behaviour)["kind"])
        properties = {"kept": "true"} if user is None else {"model": user.model}
        entity = user_entity(there.class_name, there.size_lwh, properties)
        follows = controller(user) if user is not None and kind == "idm" else None
        entities.add_scenario_object(there.id, entity, follows)
        _begin(init, there.id, path[0][1], there.speed_m_s)
        if user is None or kind in ("track", "replay"):
            does = trajectory(there.id, path) if len(path) > 1 else None
        else:
            gap = gap_between(route, started[there.id], ego) if there.id in started else 0.0
            does = maneuver(user, gap)
        if does is not None:
            board.add_maneuver(does, there.id)

    values, properties = msgspec.to_builtins(scenario), xosc.Properties()
    for name in OWN_FIELDS:
        if values[name] is not None:
            properties.add_property(PROPERTY + name, str(values[name]))
    properties.add_property(f"{PROPERTY}seed", str(scenario.rain.seed))
    whole = xosc.Scenario(
        scenario.description or scenario.name, "gsrain", xosc.ParameterDeclarations(), entities, board,
        xosc.RoadNetwork(road_file), xosc.Catalog(), osc_minor_version=2, creation_date=_DATE,
        header_properties=properties,
    )  # fmt: skip
    return _xml(whole.get_element())


def _xml(root: ElementTree.Element) -> str:
    ElementTree.indent(root, "    ")
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, "unicode") + "\n"


# Maneuvers

Place = tuple[float, float, float, float]
"""World x, y, z and heading."""

TimedPlaces = list[tuple[float, Place]]
"""Times in seconds since the scenario began, and places; the first is where a road user appears."""


def _begin(init: xosc.Init, id: str, place: Place, speed_m_s: float) -> None:
    immediate = xosc.TransitionDynamics(words.DynamicsShapes.step, words.DynamicsDimension.time, 0)
    init.add_init_action(id, xosc.TeleportAction(position(place)))
    init.add_init_action(id, xosc.AbsoluteSpeedAction(speed_m_s, immediate))


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


def maneuver(user: ScenarioUser, gap_m: float) -> xosc.Maneuver | None:
    """Return the maneuver of a triggered road user; None for other behaviors.

    `gap_m` is its initial gap to the ego vehicle, which decides whether the trigger is a shrinking or growing gap.
    """
    behaviour = user.behaviour
    if isinstance(behaviour, CutIn):
        return _maneuver(user.id, _cut_in(user.id, behaviour), _trigger(user.id, behaviour, gap_m))
    if isinstance(behaviour, Brake):
        speed = _speed(behaviour.to_speed_m_s, behaviour.deceleration_m_s2)
        return _maneuver(user.id, [("brake", speed)], _trigger(user.id, behaviour, gap_m))
    return None


def trajectory(id: str, places: TimedPlaces) -> xosc.Maneuver:
    """Return a trajectory that is followed by time from the start."""
    path = xosc.Trajectory(f"{id} way", False)
    times, positions = zip(*((time_s, position(place)) for time_s, place in places), strict=True)
    path.add_shape(xosc.Polyline(list(times), list(positions)))
    follow = xosc.FollowTrajectoryAction(path, words.FollowingMode.position, words.ReferenceContext.absolute, 1, 0)
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


def _trigger(id: str, settings: Triggered, gap_m: float) -> Any:
    if settings.after_s is not None:
        return _after(id, settings.after_s)
    road, distance = words.CoordinateSystem.road, words.RelativeDistanceType.longitudinal
    if settings.gap_m is not None:
        rule = words.Rule.greaterOrEqual if gap_m < settings.gap_m else words.Rule.lessOrEqual
        gap = xosc.RelativeDistanceCondition(
            settings.gap_m, rule, distance, EGO, freespace=True, coordinate_system=road
        )
        return xosc.EntityTrigger(f"{id} gap", 0, words.ConditionEdge.none, gap, id)
    assert settings.time_to_collision_s is not None
    rule, until = words.Rule.lessOrEqual, settings.time_to_collision_s
    collision = xosc.TimeToCollisionCondition(
        until, rule, entity=id, freespace=True, distance_type=distance, coordinate_system=road
    )
    return xosc.EntityTrigger(f"{id} time to collision", 0, words.ConditionEdge.none, collision, EGO)


def _maneuver(id: str, actions: list[tuple[str, Any]], trigger: Any) -> xosc.Maneuver:
    event = xosc.Event(f"{id} event", words.Priority.override)
    event.add_trigger(trigger)
    for name, action in actions:
        event.add_action(f"{id} {name}", action)
    return xosc.Maneuver(f"{id} manoeuvre").add_event(event)


def _after(id: str, time_s: float) -> xosc.ValueTrigger:
    condition = xosc.SimulationTimeCondition(time_s, words.Rule.greaterOrEqual)
    return xosc.ValueTrigger(f"{id} time", 0, words.ConditionEdge.none, condition)


def record_paths(scenario: Scenario, traffic: Traffic, ego: RoadUser) -> dict[str, TimedPlaces]:
    """Simulate all road users around a standing ego vehicle and record their poses."""
    found: dict[str, TimedPlaces] = {}
    for step in range(round(scenario.duration_s / scenario.step_s) + 1):
        time_s = step * scenario.step_s
        for user in traffic.users:
            found.setdefault(user.id, []).append((time_s, (user.x_m, user.y_m, user.z_m, user.yaw_rad)))
        traffic.advance(time_s, ego, scenario.step_s)
    return found


# Weather

_PUDDLES_FROM_MM = 0.2  # depth of the water on a road from which it stands in puddles


def environment_of(rain: RainSettings) -> xosc.EnvironmentAction:
    """Return the weather action: precipitation in mm/h, fog of the rain's visual range, wind, wetness.

    The visual range is the meteorological optical range ln(20) / beta of the rain's own extinction. Friction stays 1,
    because vehicles do not slip in the simulation.
    """
    intensity = rain.intensity_mm_h
    kind = words.PrecipitationType.rain if intensity > 0 else words.PrecipitationType.dry
    fog = wind = cloud = None
    wetness = words.Wetness.dry
    if intensity > 0:
        soaks = water_depth_mm(intensity) >= _PUDDLES_FROM_MM
        wetness = words.Wetness.wetWithPuddles if soaks else words.Wetness.moist
        cloud = words.FractionalCloudCover.eightOktas
        visibility = rain_properties(rain, load_calibration(rain.calibration)).visibility_m
        fog = None if np.isinf(visibility) else words.Fog(round(visibility, 1))
    x, y = rain.wind_vector_m_s
    if x or y:
        wind = xosc.Wind(float(np.arctan2(y, x)) % (2 * np.pi), float(np.hypot(x, y)))
    weather = xosc.Weather(cloud, fog=fog, precipitation=xosc.Precipitation(kind, intensity), wind=wind)
    road = xosc.RoadCondition(1.0, wetness=wetness)
    return xosc.EnvironmentAction(xosc.Environment("weather", weather=weather, roadcondition=road))


# OpenDRIVE road

_BEFORE_M, _BEHIND_M = 60.0, 200.0  # straight extension of the road before and after the recorded drive
_STEP_M = 5.0
_TOLERANCE_M = 0.01


def road_xml(scenario: Scenario, scene: Scene) -> str:
    """Return a road of four lanes as text: the recorded route is the center of lane -2, with right-hand traffic.

    The route becomes parametric cubics (Hermite) within centimeters of it, with continuous tangents; long ones where it
    is straight. Height is omitted.
    """
    route = recorded_route(scene)
    alongs = np.arange(-_BEFORE_M, route.length_m + _BEHIND_M + _STEP_M / 2, _STEP_M)
    points = np.array([route.at(float(each))[:2] for each in alongs])
    lanes = xodr.Lanes()
    section = xodr.LaneSection(0, xodr.Lane(lane_type=xodr.LaneType.none))
    for _ in range(3):
        section.add_right_lane(xodr.Lane(a=LANE_M))
    section.add_left_lane(xodr.Lane(a=LANE_M))
    lanes.add_lanesection(section)
    lanes.add_laneoffset(xodr.LaneOffset(0, 1.5 * LANE_M))
    road = xodr.Road(0, _reference_line(points), lanes, name=scenario.name)
    drive = xodr.OpenDrive(scenario.name)
    drive.add_road(road)
    root = drive.get_element()
    header = root.find("header")
    assert header is not None
    header.set("date", str(_DATE))
    return _xml(root)


def _reference_line(points: Float64[np.ndarray, "n 2"]) -> xodr.PlanView:
    """Return the reference line: a cubic between each pair of points."""
    line = np.asarray(shapely.LineString(points).simplify(_TOLERANCE_M).coords)
    # The points that define the shape: all in bends, few where it is straight.
    chosen = [int(np.argmin(np.linalg.norm(points - each, axis=1))) for each in line]
    slopes, plan = np.gradient(points, _STEP_M, axis=0)[chosen], xodr.PlanView()
    for start, end, leave, arrive in zip(points[chosen], points[chosen[1:]], slopes, slopes[1:], strict=False):
        chord = float(np.linalg.norm(end - start))
        heading = float(np.arctan2(leave[1], leave[0]))
        turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        reach, first, last = turn @ (end - start), chord * turn @ leave, chord * turn @ arrive
        second, third = 3 * reach - 2 * first - last, first + last - 2 * reach
        u, v = ((0.0, float(first[k]), float(second[k]), float(third[k])) for k in range(2))
        plan.add_fixed_geometry(xodr.ParamPoly3(*u, *v), float(start[0]), float(start[1]), heading)
    return plan
