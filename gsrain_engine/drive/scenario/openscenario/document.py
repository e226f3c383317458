"""A whole scenario as an OpenSCENARIO document."""

import datetime
from xml.etree import ElementTree

import msgspec
from scenariogeneration import xosc

from gsrain_engine.scene.scene import Scene

from ...road.ground import ground_of
from ...road.route import recorded_route
from ...traffic.ego_user import ego_user
from ...traffic.in_lane import gap_between
from ...traffic.road_user import RoadUser
from ..scenario import Scenario, ScenarioUser
from ..start import start_state
from ..traffic import Traffic
from .entities import ego_entity, user_entity
from .manoeuvres import Place, controller, manoeuvre, position, trajectory
from .names import EGO, OWN_FIELDS, PROPERTY
from .ways import Way, ways
from .weather import environment_of
from .words import words

_MINOR = 2
_DATE = datetime.datetime(2000, 1, 1)
"""Files don't say when they were written: the same scenario is the same bytes."""


def document_xml(scenario: Scenario, scene: Scene, road_file: str) -> str:
    """Return the document as text; `road_file` is the OpenDRIVE file that it refers to."""
    route, ground = recorded_route(scene), ground_of(scene)
    traffic = Traffic(scenario, scene, route, ground)
    state = start_state(scenario, scene, route)
    ego = ego_user(scenario.vehicle, state)
    started, sampled = {user.id: user for user in traffic.users}, ways(scenario, traffic, ego)

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
    """Add a road user: one of the scenario's, or an actor of the scene that it keeps."""
    if there.id == EGO:
        raise ValueError(f"road user {EGO!r}: in OpenSCENARIO files that is the ego vehicle's name")
    properties = {"kept": "true"} if user is None else {"model": user.model}
    entity = user_entity(there.class_name, there.size_lwh, properties)
    follows = controller(user) if user is not None and _kind(user) == "idm" else None
    entities.add_scenario_object(there.id, entity, follows)


def _does(id: str, user: ScenarioUser | None, way: Way, gap_m: float) -> xosc.Maneuver | None:
    if user is None or _kind(user) in ("track", "replay"):
        return trajectory(id, way.times_s, way.places) if len(way.times_s) > 1 else None
    return manoeuvre(user, gap_m)


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
