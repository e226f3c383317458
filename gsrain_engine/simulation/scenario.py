"""Scenario settings (start, road users, weather, end), initial poses, and traffic."""

from dataclasses import replace
from functools import partial
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from ..rain.settings import RainSettings
from ..scene.scene import Actor, Scene
from ..settings import Settings
from .controller_base import ControllerSettings
from .friction import Friction, RoadGrip
from .geometry import Route
from .ground import RoadSurface
from .rollout import BACKGROUND
from .traffic.appearance import vehicle_model
from .traffic.base import EGO, Behavior, RoadUser, TrafficState
from .traffic.models import BehaviorSettings
from .traffic.tracks import RecordedTrack
from .vehicle import Vehicle, VehicleState

_Side = Annotated[float, Meta(gt=0, le=100)]


class ScenarioUser(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A road user of a scenario; its place is measured along the ego vehicle's route."""

    id: Annotated[str, Meta(min_length=1, title="Name")]
    model: Annotated[
        str,
        Meta(
            title="Model",
            description="What it looks like: hatchback, saloon, estate, van or truck, with a paint if wanted "
            "(van/red); actor:ID (one of the scene); a file of Gaussians (meters, x forward, y left, z up); or the "
            "folder of a 3DRealCar vehicle (gs.pth, wlh.json).",
        ),
    ] = "saloon"
    class_name: Annotated[str, Meta(title="Class")] = "car"
    size_lwh_m: Annotated[
        tuple[_Side, _Side, _Side] | None,
        Meta(title="Size", description="Length, width and height; none takes the model's.", extra={"unit": "m"}),
    ] = None
    placed: Annotated[
        Literal["along-route", "straight"],
        Meta(title="Measured", description="Along the ego vehicle's route, or straight from where it starts and as "
             "it is turned there."),
    ] = "along-route"  # fmt: skip
    ahead_m: Annotated[
        float,
        Meta(ge=-500, le=500, title="Ahead", description="Center to center, from the ego vehicle, at the start.",
             extra={"unit": "m"}),
    ] = 0.0  # fmt: skip
    left_m: Annotated[
        float,
        Meta(ge=-100, le=100, title="Left", description="Of the ego vehicle's route; straight: of itself.",
             extra={"unit": "m"}),
    ] = 0.0  # fmt: skip
    turned_deg: Annotated[
        float,
        Meta(ge=-180, le=180, title="Heading offset", description="To the left, from the route's direction; "
             "straight: from the ego vehicle's.", extra={"unit": "deg"}),
    ] = 0.0  # fmt: skip
    speed_m_s: Annotated[float, Meta(ge=0, le=60, title="Speed", extra={"unit": "m/s"})] = 0.0
    behaviour: BehaviorSettings


class Scenario(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One closed-loop test. Times are seconds since its start unless stated otherwise."""

    name: Annotated[str, Meta(min_length=1, title="Name")]
    description: str = ""
    scene: Annotated[str, Meta(
        title="Scene", extra={"commands": "drive"},
        description="Scene file or folder, or street (the built-in one).")] = "street"  # fmt: skip
    rig: Annotated[str | None, Meta(
        title="Rig", extra={"commands": "drive*"},
        description="Camera rig of the scene; none takes its first.")] = None  # fmt: skip
    picture_width_px: Annotated[int, Meta(
        ge=64, le=4096, multiple_of=2, title="Picture width",
        extra={"unit": "px", "option": "width", "commands": "drive"},
        description="Width of the images, an even number.")] = 800  # fmt: skip
    start_s: Annotated[
        float,
        Meta(title="Start", description="Scene time at which it begins: the ego vehicle starts where it then was.",
             extra={"unit": "s"}),
    ] = 0.0  # fmt: skip
    ahead_m: Annotated[
        float, Meta(ge=-500, le=500, title="Ahead of there", description="Along the route.", extra={"unit": "m"})
    ] = 0.0
    left_m: Annotated[float, Meta(ge=-20, le=20, title="Left of the route", extra={"unit": "m"})] = 0.0
    turned_deg: Annotated[
        float,
        Meta(ge=-180, le=180, title="Heading offset", description="From the route's direction, to the left.",
             extra={"unit": "deg"}),
    ] = 0.0  # fmt: skip
    speed_m_s: Annotated[float, Meta(ge=0, le=60, title="Initial speed", extra={"unit": "m/s"})] = 10.0
    keep: Annotated[
        tuple[str, ...] | Literal["all"],
        Meta(title="Actors that stay", description="Of the scene's own actors, which follow their tracks."),
    ] = ()
    road_users: tuple[ScenarioUser, ...] = ()
    rain: RainSettings = RainSettings()
    friction: Annotated[Friction, Meta(
        title="Road surface", extra={"commands": "drive"},
        description="Friction of the road under all vehicles. dry: each has its own limits. wet: less, by speed and "
        "water, which agents don't know.")] = "dry"  # fmt: skip
    vehicle: Vehicle = Vehicle()
    controller: ControllerSettings = ControllerSettings()
    step_s: Annotated[
        float, Meta(gt=0, le=1, title="Time step", description="HUGSIM's is 0.25 s.", extra={"unit": "s"})
    ] = 0.25
    duration_s: Annotated[float, Meta(
        gt=0, le=600, title="Max. duration", extra={"unit": "s", "commands": "drive"},
        description="The drive ends then at the latest.")] = 15.0  # fmt: skip
    leave_m: Annotated[
        float,
        Meta(gt=0, le=1000, title="Off the route", description="Farther from the route ends it.", extra={"unit": "m"}),
    ] = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        ids = [user.id for user in self.road_users]
        for each in ids:
            if ids.count(each) > 1:
                raise ValueError(f"two road users are called {each!r}")
        for each in ids:
            if each in (EGO, BACKGROUND):
                raise ValueError(f"a road user can't be called {each!r}: roll-outs mean something else by it")


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
            rule = self._rules[user.id] = user.behaviour.begin(self._scene, self._scenario.start_s)
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
