"""Scenarios in a scene: initial poses, and traffic."""

from dataclasses import replace
from functools import partial

import numpy as np

from ..scene.scene import Actor, Scene
from .friction import RoadGrip
from .geometry import Route
from .ground import RoadSurface
from .scenario_settings import Scenario, ScenarioUser
from .traffic.appearance import vehicle_model
from .traffic.base import Behavior, RoadUser, TrafficState
from .traffic.models import begin_behavior
from .traffic.tracks import RecordedTrack
from .vehicle import VehicleState

# Initial poses: world frame, meters


def start_along_m(scenario: Scenario, scene: Scene, route: Route) -> float:
    """Return the ego vehicle's start position along the route.

    Raises ValueError if the scene has no ego vehicle at that time, or its drive is over by then.
    """
    last_s = scene.ego.times[-1] if scene.ego is not None and len(scene.ego.times) else np.inf
    if not scenario.start_s <= last_s:
        raise ValueError(f"scenario {scenario.name}: at {scenario.start_s:g} s the drive of scene {scene.name!r} is "
                         f"over; it ends at {last_s:g} s")  # fmt: skip
    pose = scene.ego_to_world(scenario.start_s)
    if pose is None:
        raise ValueError(f"scene {scene.name!r} has no ego vehicle at {scenario.start_s:g} s")
    return route.nearest(float(pose[0, 3]), float(pose[1, 3])).along_m + scenario.ahead_m


def start_state(scenario: Scenario, scene: Scene, route: Route) -> VehicleState:
    """Return the initial state of the ego vehicle; raises ValueError like `start_along_m`."""
    x, y, heading = route.at(start_along_m(scenario, scene, route), scenario.left_m)
    return VehicleState(x, y, heading + float(np.radians(scenario.turned_deg)), scenario.speed_m_s)


def start_place(user: ScenarioUser, scenario: Scenario, scene: Scene, route: Route) -> tuple[float, float, float]:
    """Return x, y and heading of a road user's center at the start; raises ValueError like `start_along_m`."""
    ahead = scenario.vehicle.middle_m + user.ahead_m
    if user.placed == "straight":
        ego = start_state(scenario, scene, route)
        x, y = ego.to_world(np.array([[ahead, user.left_m]]))[0]
        heading = ego.yaw_rad
    else:
        x, y, heading = route.at(start_along_m(scenario, scene, route) + ahead, user.left_m)
    return float(x), float(y), heading + float(np.radians(user.turned_deg))


class Traffic:
    """The scenario's road users and the scene's own actors that it keeps, advanced step by step."""

    def __init__(self, scenario: Scenario, scene: Scene, route: Route, ground: RoadSurface) -> None:
        self._scenario, self._scene, self._route, self._ground = scenario, scene, route, ground
        self.looks = {user.id: vehicle_model(user.model, scene) for user in scenario.road_users}
        """Models of the scenario's own road users, by id."""
        actors = _remaining_actors(scenario, scene)
        self._recorded = {actor.id: RecordedTrack(scene, actor, scenario.start_s) for actor in actors}
        self.reset()

    def reset(self) -> None:
        self.everybody: tuple[RoadUser, ...] = ()
        """All road users that ever appeared, each in its first state."""
        self._rules: dict[str, Behavior] = {}
        self._latest: dict[str, RoadUser] = {}
        present: dict[str, RoadUser | None] = {}
        for user in self._scenario.road_users:
            rule = self._rules[user.id] = begin_behavior(user.behaviour, self._scene, self._scenario.start_s)
            placed = self._latest[user.id] = self._placed(user)
            present[user.id] = rule.start(placed)
        self._meet(present, 0.0)

    @property
    def users(self) -> tuple[RoadUser, ...]:
        """Road users that are present."""
        return tuple(self._present.values())

    def advance(self, time_s: float, ego: RoadUser, dt_s: float, grip: RoadGrip | None = None) -> None:
        """Advance all road users simultaneously, each based on the previous states of the others.

        None of them brakes harder than `grip` allows.
        """
        scene_s = self._scenario.start_s + time_s
        holds = None if grip is None else partial(grip.acceleration_m_s2, time_s=scene_s)
        moved: dict[str, RoadUser | None] = {}
        for id, rule in self._rules.items():
            others = tuple(user for key, user in self._present.items() if key != id)
            moved[id] = rule.next(self._latest[id], TrafficState(time_s, ego, others, self._route, holds), dt_s)
        self._meet(moved, time_s + dt_s)

    def _placed(self, user: ScenarioUser) -> RoadUser:
        """Return a road user at its initial place, measured from the ego vehicle's center."""
        x, y, yaw = start_place(user, self._scenario, self._scene, self._route)
        size = user.size_lwh_m or self.looks[user.id].size_lwh_m
        return RoadUser(user.id, user.class_name, size, x, y, yaw, user.speed_m_s)

    def _meet(self, moved: dict[str, RoadUser | None], time_s: float) -> None:
        """Put moved road users on the ground; recorded ones keep their own heights."""
        grounded = {
            id: user and replace(user, z_m=self._ground.height_m(user.x_m, user.y_m)) for id, user in moved.items()
        }
        everyone = grounded | {id: track.at(time_s) for id, track in self._recorded.items()}
        self._present = {id: user for id, user in everyone.items() if user is not None}
        self._latest |= self._present
        known = {user.id for user in self.everybody}
        self.everybody = (*self.everybody, *(user for user in self.users if user.id not in known))


def _remaining_actors(scenario: Scenario, scene: Scene) -> tuple[Actor, ...]:
    actors = {actor.id: actor for actor in scene.actors}
    names = tuple(id for id, actor in actors.items() if actor.visible) if scenario.keep == "all" else scenario.keep
    missing = next((name for name in names if name not in actors), None)
    if missing is not None:
        known = ", ".join(actors) or "none"
        raise ValueError(
            f"scenario {scenario.name}: scene {scene.name!r} has no actor {missing!r} to keep, only {known}"
        )
    double = next((user.id for user in scenario.road_users if user.id in names), None)
    if double is not None:
        raise ValueError(f"scenario {scenario.name}: road user {double!r} is called like an actor that it keeps")
    return tuple(actors[name] for name in names)
