"""Closed-loop simulation: observe, plan, control, step traffic, detect collisions. Deterministic."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float64

from ..backends import open_renderer
from ..choices import Backend
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..render.export_settings import Lod
from ..render.level_of_detail import lod_cut
from ..render.provenance import PictureProvenance
from ..render.renderer import Renderer
from ..scene.built_in import DEFAULT_SCENE
from ..scene.open import with_lod_trees
from ..scene.scene import Actor, PoseTrack, Scene
from .agents import base
from .agents.base import Agent, CameraView, Observation, SensorRequirements, Trajectory
from .agents.registry import AgentOptions, open_agent
from .controllers import open_controller
from .friction import RoadGrip
from .geometry import PlanarBox, Route, RouteCoordinates
from .ground import RoadSurface, recorded_route, road_surface_of
from .metrics.summary import ScoredRun
from .obstacles import OccupiedSpace, drivable_of, occupied_space_of
from .rollout import EgoRecord, Rollout, RolloutStep, UserModel, UserRecord
from .scenario import Scenario, ScenarioUser, Traffic, start_state
from .scenario_io import load_scenario
from .sensors import RigRenderer, camera_of_width, needed_cameras, rig_cameras
from .traffic.appearance import ACTOR, VehicleModel, scale_gaussians
from .traffic.base import RoadUser, ego_user
from .vehicle import Control, Vehicle, VehicleState, grip_share, limit_control, step_bicycle, vehicle_box, yaw_rate
from .vehicle_settings import BACKGROUND, EGO

logger = logging.getLogger("gsrain")
_SEEDS = 2**32


class Simulation:
    """One scenario in one scene, for one agent, for any number of drives."""

    def __init__(
        self,
        scenario: Scenario,
        scene: Scene,
        needs: SensorRequirements = base.NOTHING,
        renderer: Renderer | None = None,
        seed: int | None = None,
        lod: Lod | None = None,
    ) -> None:
        """Prepare the simulation. `renderer` is required if the agent needs cameras, and must stay open meanwhile.

        `seed` is the rain seed; None takes the scenario's. `lod` is the level of detail of images, as of an export. A
        scenario of the built-in street, at any hour, in another scene logs a warning. Raises ValueError if the scene
        lacks a drive, a rig or a model that the scenario needs.
        """
        if scenario.scene == DEFAULT_SCENE != scene.name.partition(":")[0]:
            logger.warning("scenario %s is made for the built-in street, and is driven in scene %r", scenario.name,
                           scene.name)  # fmt: skip
        if needs.cameras and renderer is None:
            raise ValueError("the agent needs pictures, and there is nothing that draws them")
        self.scenario = scenario if seed is None else _with_seed(scenario, seed)
        self.cut = lod_cut(scene, lod) if renderer is not None else None
        """Level-of-detail cut of the images; None draws all Gaussians."""
        scene = scene if self.cut is None else with_lod_trees(scene)
        self.scene = scene
        self.route: Route = recorded_route(scene)
        self.ground = road_surface_of(scene)
        self.occupied: OccupiedSpace = occupied_space_of(scene, self.ground)
        self._needs, self._renderer = needs, renderer
        cameras = tuple(camera_of_width(each, scenario.picture_width_px) for each in rig_cameras(scene, scenario.rig))
        self._needed = needed_cameras(cameras, needs)
        self.rig = base.Rig(scenario.vehicle, cameras, self.ground.rig_height_m)
        self._controller = open_controller(scenario.controller)
        self._traffic = Traffic(self.scenario, scene, self.route, self.ground)
        self._road = RoadScene(scene, self._traffic.looks, self.scenario.road_users)
        self._pictures: RigRenderer | None = None
        self._grip = RoadGrip(RainSimulation.start(scenario.rain)) if scenario.friction == "wet" else None
        start = start_state(self.scenario, scene, self.route)
        self._start = self._moment = _SimulationMoment(0, 0.0, start, Control(0.0, 0.0))
        self._begins_m = self.route.nearest(start.x_m, start.y_m).along_m
        if self._begins_m >= self.route.length_m:
            where = f"where the route of scene {scene.name!r} ends"
            raise ValueError(f"scenario {scenario.name}: it starts {where}: nothing is left to be driven")
        self.end: str | None = None
        """Reason of the end; None during the drive."""
        self._steps: list[RolloutStep] = []

    def reset(self, seed: int | None = None) -> Observation:
        """Restart the drive, with other drops if a seed is given."""
        if seed is not None:
            self.scenario = _with_seed(self.scenario, seed)
        self._traffic.reset()
        if self._renderer is not None and self._needed:
            self._pictures = RigRenderer(self._renderer, self.scenario.rain, self._needed, self._needs, self.cut)
        self.end, self._steps, self._moment = None, [], self._start
        self._judge()
        return self.observation()

    @property
    def pictures(self) -> dict[str, PictureProvenance]:
        """Provenance of the first picture of each camera in this drive; empty for agents without cameras."""
        return {} if self._pictures is None else dict(self._pictures.provenance)

    @property
    def seed(self) -> int:
        """Seed of the rain of this drive."""
        return self.scenario.rain.seed

    def step(self, plan: Trajectory | None) -> None:
        """Follow a plan for one step; None or an empty plan ends the drive. Raises ValueError for invalid plans."""
        self._check_goes_on()
        if plan is None or not len(plan.points):
            self.end = "agent"
            self._steps.append(self._recorded(plan))
            return
        points = np.asarray(plan.points, np.float64)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError(f"a plan of shape {points.shape}: expected points (N, 2)")
        if not (np.abs(points) <= base.FARTHEST_M).all():
            raise ValueError(f"a plan with points that are not finite, or farther than {base.FARTHEST_M / 1000:g} km")
        control = self._controller.control(self.scenario.vehicle, self._moment.state, points, base.SPACING_S)
        self.advance(control, plan)

    def advance(self, control: Control, plan: Trajectory | None = None) -> None:
        """Advance all vehicles by one step under a control; `plan` is only recorded."""
        self._check_goes_on()
        before, dt = self._moment, self.scenario.step_s
        self._steps.append(self._recorded(plan))
        vehicle = self.scenario.vehicle
        control = limit_control(vehicle, before.state, control, dt)
        share = self._grip_share(before, control.acceleration_m_s2)
        control = control._replace(acceleration_m_s2=share * control.acceleration_m_s2)
        state = step_bicycle(vehicle, before.state, control, dt, share)
        self._traffic.advance(before.time_s, ego_user(vehicle, before.state), dt, self._grip)
        self._moment = _SimulationMoment(before.step + 1, (before.step + 1) * dt, state, control)
        self._judge()

    def _grip_share(self, moment: "_SimulationMoment", acceleration_m_s2: float) -> float:
        """Return the share of a demanded acceleration, and of the turn, that the road transmits, 0..1."""
        if self._grip is None:
            return 1.0
        grip = self._grip.acceleration_m_s2(moment.state.speed_m_s, self.scenario.start_s + moment.time_s)
        return grip_share(self.scenario.vehicle, moment.state, acceleration_m_s2, grip)

    @property
    def _yaw_rate(self) -> float:
        moment = self._moment
        share = self._grip_share(moment, moment.control.acceleration_m_s2)
        return share * yaw_rate(self.scenario.vehicle, moment.state)

    def observation(self) -> Observation:
        """Return the current observation, with the images that the agent needs."""
        moment = self._moment
        views = {} if self._pictures is None else self.render_cameras(self._pictures)
        return Observation(
            moment.step, moment.time_s, moment.state, moment.control.acceleration_m_s2,
            moment.control.steer_rate_rad_s, self._height_m, "straight", views, self.route, self._traffic.users,
        )  # fmt: skip

    def render_cameras(self, pictures: RigRenderer) -> dict[str, CameraView]:
        """Render the current state for any cameras of the rig."""
        state, time_s = self._moment.state, self.scenario.start_s + self._moment.time_s
        velocity = state.speed_m_s * np.array([np.cos(state.yaw_rad), np.sin(state.yaw_rad), 0.0])
        turning = self._yaw_rate
        return pictures.views(self.scene_now, self.rig_to_world, velocity, turning, time_s)

    @property
    def scene_now(self) -> Scene:
        """The scene with all road users in their current places."""
        before = [step for step in self._steps if step.step < self._moment.step]
        motions = past_motions(before, self._moment.time_s, self._traffic.users, self.rig_to_world, self.scenario)
        return self._road.at(self.rig_to_world, self._traffic.users, motions)

    @property
    def rig_to_world(self) -> Float64[np.ndarray, "4 4"]:
        """Current pose of the ego vehicle's rig (x forward, y left, z up, above the rear axle). World frame, meters."""
        return self._moment.state.rig_to_world(self._height_m + self.rig.height_m)

    def rollout(self, agent: str) -> Rollout:
        """Return the roll-out so far; an unfinished drive has the end "stopped"."""
        steps, end = list(self._steps), self.end or "stopped"
        if not steps or steps[-1].step != self._moment.step:
            steps.append(self._recorded(None))
        everybody = self._traffic.everybody
        return Rollout(
            scenario=_plain(self.scenario),
            scene=self.scene.name,
            agent=agent,
            seed=self.seed,
            step_s=self.scenario.step_s,
            spacing_s=base.SPACING_S,
            users={each.id: UserModel(class_name=each.class_name, size_lwh_m=each.size_lwh) for each in everybody},
            end=end,
            steps=tuple(steps),
        )

    def _check_goes_on(self) -> None:
        if self.end is not None:
            raise ValueError(f"the drive is over ({self.end}); reset it")

    def _judge(self) -> None:
        if self._hit is not None:
            self.end = "collision"
        elif self._completion >= 1:
            self.end = "completed"
        elif abs(self._on_route.left_m) > self.scenario.leave_m:
            self.end = "off route"
        elif self._moment.time_s >= self.scenario.duration_s - 1e-9:
            self.end = "time"
        if self.end is not None:
            self._steps.append(self._recorded(None))

    def _recorded(self, plan: Trajectory | None) -> RolloutStep:
        moment, state = self._moment, self._moment.state
        return RolloutStep(
            step=moment.step,
            time_s=moment.time_s,
            ego=EgoRecord(
                x_m=state.x_m, y_m=state.y_m, z_m=self._height_m, yaw_rad=state.yaw_rad, speed_m_s=state.speed_m_s,
                steer_rad=state.steer_rad, acceleration_m_s2=moment.control.acceleration_m_s2,
                steer_rate_rad_s=moment.control.steer_rate_rad_s, yaw_rate_rad_s=self._yaw_rate,
            ),
            road_users=tuple(
                UserRecord(id=user.id, x_m=user.x_m, y_m=user.y_m, z_m=user.z_m, yaw_rad=user.yaw_rad,
                           speed_m_s=user.speed_m_s)
                for user in self._traffic.users
            ),
            plan=() if plan is None else tuple((float(x), float(y)) for x, y in plan.points),
            route_left_m=self._on_route.left_m,
            route_completion=self._completion,
            collision=self._hit,
            notes={} if plan is None else _plain(plan.notes),
        )  # fmt: skip

    @property
    def _height_m(self) -> float:
        return self.ground.height_m(self._moment.state.x_m, self._moment.state.y_m)

    @property
    def _hit(self) -> str | None:
        moment, scenario = self._moment, self.scenario
        since_s = scenario.step_s if moment.step else 0.0
        return find_collision(scenario.vehicle, moment.state, self._traffic.users, self.ground, self.occupied, since_s)

    @property
    def _on_route(self) -> RouteCoordinates:
        return self.route.nearest(self._moment.state.x_m, self._moment.state.y_m)

    @property
    def _completion(self) -> float:
        share = (self._on_route.along_m - self._begins_m) / (self.route.length_m - self._begins_m)
        return float(np.clip(share, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class _SimulationMoment:
    step: int
    time_s: float
    state: VehicleState
    control: Control
    """Control over the previous step."""


def _with_seed(scenario: Scenario, seed: int) -> Scenario:
    """Return a scenario with another rain seed; raises ValueError if it is out of range."""
    if not 0 <= seed < _SEEDS:
        raise ValueError(f"seed {seed}: must be within 0..{_SEEDS - 1}")
    return msgspec.structs.replace(scenario, rain=msgspec.structs.replace(scenario.rain, seed=seed))


def _plain(value: object) -> dict[str, Any]:
    return msgspec.json.decode(msgspec.json.encode(value))


def drive(simulation: Simulation, agent: Agent) -> Iterator[Observation]:
    """Run an agent; yields each observation after the agent has planned on it.

    The agent is reset before the first images are drawn, so that a client that can't start costs none. Closing the
    iterator stops the drive. Exceptions of the agent propagate. `simulation.rollout` returns the record.
    """
    agent.reset(simulation.seed, simulation.rig)
    observation = simulation.reset()
    while simulation.end is None:
        plan = agent.plan(observation)
        yield observation
        simulation.step(plan)
        if simulation.end is None:
            observation = simulation.observation()


def run_drive(simulation: Simulation, agent: Agent) -> Rollout:
    """Run an agent to the end and return the roll-out. Exceptions of the agent propagate."""
    for _ in drive(simulation, agent):
        pass
    return simulation.rollout(agent.name)


def drive_scene(
    scene: Scene,
    rain: RainSettings | None = None,
    agent: Agent | str = "oracle-idm",
    scenario: Scenario | str = "stationary-lead",
    *,
    options: AgentOptions | None = None,
    backend: Backend = "auto",
) -> ScoredRun:
    """Run an agent through a scene in the rain, and score the drive.

    `rain` defaults to the scenario's. A named agent is opened and closed here, as is the renderer for cameras. Raises
    ValueError for an unknown agent or scenario, or if the scene lacks a recorded ego drive, a rig or a model.
    """
    test = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    if rain is not None:
        test = msgspec.structs.replace(test, rain=rain)
    with ExitStack() as stack:
        driver = open_agent(agent, options) if isinstance(agent, str) else agent
        if driver is not agent:
            stack.callback(driver.close)
        renderer = stack.enter_context(open_renderer(backend)) if driver.needs.cameras else None
        simulation = Simulation(test, scene, driver.needs, renderer)
        rollout = run_drive(simulation, driver)
        drivable = drivable_of(scene, simulation.ground, simulation.occupied)
        return ScoredRun.of(rollout, simulation.occupied, drivable)


def find_collision(
    vehicle: Vehicle, state: VehicleState, users: Sequence[RoadUser], ground: RoadSurface, occupied: OccupiedSpace,
    since_s: float,
) -> str | None:  # fmt: skip
    """Return the id of the road user hit, "background" for other obstacles, or None.

    `since_s` is the time since the previous check, 0 at the start: obstacles that a fast vehicle has passed through
    since then count as hit. Road users above or below the vehicle do not.
    """
    box = vehicle_box(vehicle, state)
    foot = ground.height_m(box.x_m, box.y_m)
    top = foot + vehicle.height_m
    for user in users:
        is_over_or_under = user.z_m >= top or user.z_m + user.size_lwh[2] <= foot
        closing = state.speed_m_s - user.speed_m_s * float(np.cos(user.yaw_rad - state.yaw_rad))
        if not is_over_or_under and _without_gap(box, closing * since_s).touches(user.box):
            return user.id
    return BACKGROUND if occupied.touches(_without_gap(box, state.speed_m_s * since_s)) else None


def _without_gap(box: PlanarBox, gone_m: float) -> PlanarBox:
    """Extend the vehicle's box backward to its previous position after driving `gone_m`."""
    more = max(gone_m - box.length_m, 0.0)
    x, y = box.x_m - more / 2 * np.cos(box.yaw_rad), box.y_m - more / 2 * np.sin(box.yaw_rad)
    return PlanarBox(float(x), float(y), box.yaw_rad, box.length_m + more, box.width_m)


class RoadScene:
    """A scene with the scenario's road users as its actors."""

    def __init__(self, scene: Scene, looks: dict[str, VehicleModel], users: Sequence[ScenarioUser] = ()) -> None:
        """Use models by road user id; road users without a model are actors of the scene.

        Of the scenario's `users`, copies of an actor have its lamps.
        """
        copies = {user.id: user.model.removeprefix(ACTOR) for user in users if user.model.startswith(ACTOR)}
        lamps = [
            msgspec.structs.replace(lamp, mount=id)
            for id, actor in copies.items()
            for lamp in scene.lamps
            if lamp.mount == actor != id
        ]
        self.scene = replace(scene, lamps=(*scene.lamps, *lamps))
        self._world_to_scene = np.linalg.inv(scene.scene_to_world)
        unit = 1 / scene.metres_per_unit
        self._gaussians = {id: scale_gaussians(look.gaussians, unit) for id, look in looks.items()}
        self._wet_sh = {id: look.wet_sh for id, look in looks.items()}
        self._recorded = {actor.id: actor for actor in scene.actors}

    def at(
        self,
        rig_to_world: Float64[np.ndarray, "4 4"],
        users: tuple[RoadUser, ...],
        motions: Mapping[str, PoseTrack] | None = None,
    ) -> Scene:
        """Return the scene with the ego vehicle's rig and road users in their places, valid at any time.

        `motions` in the world are what they did up to then, for their spray.
        """
        actors = tuple(self._actor(user) for user in users)
        past = {id: track.moved(self._world_to_scene) for id, track in (motions or {}).items()}
        ego = PoseTrack.standing(self._world_to_scene @ rig_to_world)
        return replace(self.scene, actors=actors, ego=ego, motions=past)

    def _actor(self, user: RoadUser) -> Actor:
        track = PoseTrack.standing(self._world_to_scene @ user.pose)
        if user.id not in self._gaussians:
            return replace(self._recorded[user.id], track=track)
        length, width, height = (side / self.scene.metres_per_unit for side in user.size_lwh)
        gaussians, wet_sh = self._gaussians[user.id], self._wet_sh[user.id]
        return Actor(user.id, user.class_name, (length, width, height), gaussians, track, wet_sh=wet_sh)


BEFORE_S = 30.0
"""Seconds of the past that spray and water on glass may need."""


def past_motions(
    steps: Sequence[RolloutStep], time_s: float, users: Sequence[RoadUser], rig_to_world: Float64[np.ndarray, "4 4"],
    scenario: Scenario,
) -> dict[str, PoseTrack]:  # fmt: skip
    """Tracks (world, scene time) of the ego vehicle's rig and of road users up to a time of a drive.

    `steps` are those before that time. Before the scenario all were moving straight ahead at their first speed.
    """
    recent = [each for each in steps if each.time_s > time_s - BEFORE_S]
    x, y, rig_m = (float(each) for each in rig_to_world[:3, 3])
    yaw = float(np.arctan2(rig_to_world[1, 0], rig_to_world[0, 0]))
    egos = [(each.time_s, each.ego.x_m, each.ego.y_m, rig_m, each.ego.yaw_rad) for each in recent]
    speed = recent[0].ego.speed_m_s if recent else scenario.speed_m_s
    found = {EGO: _track([*egos, (time_s, x, y, rig_m, yaw)], speed, scenario.start_s)}
    for user in users:
        places, speed = [(time_s, user.x_m, user.y_m, user.z_m, user.yaw_rad)], user.speed_m_s
        for step in reversed(recent):
            there = next((each for each in step.road_users if each.id == user.id), None)
            if there is None:
                break
            places.append((step.time_s, there.x_m, there.y_m, there.z_m, there.yaw_rad))
            speed = there.speed_m_s
        found[user.id] = _track(places[::-1], speed, scenario.start_s)
    return found


def _track(places: Sequence[tuple[float, ...]], speed_m_s: float, start_s: float) -> PoseTrack:
    """Track through rows of time, x, y, z and yaw, and a straight way to the first if a drive begins with it."""
    rows = np.array(places)
    if rows[0, 0] < 1e-9:
        time_s, x, y, z, yaw = rows[0]
        gone = speed_m_s * BEFORE_S
        rows = np.concatenate([[(time_s - BEFORE_S, x - gone * np.cos(yaw), y - gone * np.sin(yaw), z, yaw)], rows])
    half, none = rows[:, 4] / 2, np.zeros(len(rows))
    quaternions = np.stack([np.cos(half), none, none, np.sin(half)], axis=1)
    return PoseTrack(start_s + rows[:, 0], rows[:, 1:4].copy(), quaternions, np.ones(len(rows), bool))
