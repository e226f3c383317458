"""The loop of a drive: observe, plan, steer, move everybody, look what was hit. Deterministic, step by step."""

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float64

from gsrain_engine.render.renderer import Renderer
from gsrain_engine.scene.scene import Scene

from ..agents.agent import NOTHING, SPACING_S, Needs, Plan
from ..agents.observation import Observation, Rig
from ..road.ground import ground_of
from ..road.occupied_space import OccupiedSpace, occupied_space_of
from ..road.planar_box import PlanarBox
from ..road.route import OnRoute, Route, recorded_route
from ..scenario.scenario import Scenario
from ..scenario.start import start_state
from ..traffic.road_user import RoadUser
from ..vehicle.bicycle import limited, moved_on
from ..vehicle.controllers import open_controller
from ..vehicle.state import Control, VehicleState
from ..vehicle.vehicle import Vehicle
from .rig_pictures import RigPictures, needed_cameras, of_width, rig_cameras
from .road_scene import RoadScene
from .rollout import EgoRecord, Rollout, RolloutStep, UserModel, UserRecord
from .traffic import Traffic

BACKGROUND = "background"
"""What was hit where it is no road user."""
_STANDING = Control(0.0, 0.0)


class Simulation:
    """One scenario in one scene, to be driven through by one agent, as often as wanted."""

    def __init__(
        self, scenario: Scenario, scene: Scene, needs: Needs = NOTHING, renderer: Renderer | None = None, seed: int = 0
    ) -> None:
        """Make ready. `renderer` is needed where an agent needs cameras; it stays open for as long as this is used.

        Raises ValueError where the scene lacks what the scenario needs: a drive, a rig, a model.
        """
        if needs.cameras and renderer is None:
            raise ValueError("the agent needs pictures, and there is nothing that draws them")
        self.scenario = msgspec.structs.replace(scenario, rain=msgspec.structs.replace(scenario.rain, seed=seed))
        self.seed = seed
        self.scene = scene
        self.route: Route = recorded_route(scene)
        self.ground = ground_of(scene)
        self.occupied: OccupiedSpace = occupied_space_of(scene, self.ground)
        self._needs, self._renderer = needs, renderer
        cameras = tuple(of_width(each, scenario.picture_width_px) for each in rig_cameras(scene, scenario.rig))
        self._shown = needed_cameras(cameras, needs)
        self.rig = Rig(scenario.vehicle, cameras, self.ground.rig_height_m)
        self._controller = open_controller(scenario.controller)
        self._traffic = Traffic(self.scenario, scene, self.route, self.ground)
        self._road = RoadScene(scene, self._traffic.looks)
        self._pictures: RigPictures | None = None
        self._moment = self._start()
        start = self._moment.state
        self._begins_m = self.route.nearest(start.x_m, start.y_m).along_m
        self.end: str | None = None
        """Why the drive is over; none while it goes on."""
        self._steps: list[RolloutStep] = []

    def reset(self, seed: int | None = None) -> Observation:
        """Begin the drive anew; with other drops where a seed is given."""
        if seed is not None:
            self.seed = seed
            rain = msgspec.structs.replace(self.scenario.rain, seed=seed)
            self.scenario = msgspec.structs.replace(self.scenario, rain=rain)
        self._controller.reset()
        self._traffic.reset()
        if self._renderer is not None and self._shown:
            self._pictures = RigPictures(self._renderer, self.scenario.rain, self._shown, self._needs)
        self.end, self._steps = None, []
        self._moment = self._start()
        self._judge()
        return self.observation()

    def step(self, plan: Plan | None) -> None:
        """Follow a plan for one step; without one, or with an empty one, the drive is over."""
        if plan is None or not len(plan.points):
            self._finish("agent", plan)
            return
        if plan.points.ndim != 2 or plan.points.shape[1] != 2 or not np.isfinite(plan.points).all():
            raise ValueError(f"a plan of shape {plan.points.shape}: expected finite points (N, 2)")
        points = np.asarray(plan.points, np.float64)
        control = self._controller.control(self.scenario.vehicle, self._moment.state, points, SPACING_S)
        self.advance(control, plan)

    def advance(self, control: Control, plan: Plan | None = None) -> None:
        """Move everybody on by one step under a control; `plan` is what it comes from, for the record."""
        if self.end is not None:
            raise ValueError(f"the drive is over ({self.end}); reset it")
        before, dt = self._moment, self.scenario.step_s
        self._record(plan)
        control = limited(self.scenario.vehicle, before.state, control, dt)
        state = moved_on(self.scenario.vehicle, before.state, control, dt)
        self._traffic.advance(before.time_s, self._ego(before.state), dt)
        self._moment = _Moment(before.step + 1, (before.step + 1) * dt, state, control)
        self._judge()

    def observation(self) -> Observation:
        """Show the present moment, with the pictures that the agent needs."""
        moment, state = self._moment, self._moment.state
        height = self.ground.height_m(state.x_m, state.y_m)
        views = {}
        if self._pictures is not None:
            velocity = state.speed_m_s * np.array([np.cos(state.yaw_rad), np.sin(state.yaw_rad), 0.0])
            time_s = self.scenario.start_s + moment.time_s
            views = self._pictures.views(self.scene_now, self.rig_to_world, velocity, self._yaw_rate(state), time_s)
        return Observation(
            moment.step, moment.time_s, state, moment.control.acceleration_m_s2, moment.control.steer_rate_rad_s,
            height, "straight", views, self.route, self._traffic.users,
        )  # fmt: skip

    @property
    def scene_now(self) -> Scene:
        """The scene with everybody where they are now."""
        return self._road.at(self.rig_to_world, self._traffic.users)

    @property
    def rig_to_world(self) -> Float64[np.ndarray, "4 4"]:
        """Pose of the ego vehicle's rig (x forward, y left, z up, above the rear axle) now. World: metres."""
        state = self._moment.state
        return state.rig_to_world(self.ground.height_m(state.x_m, state.y_m) + self.rig.height_m)

    def rollout(self, agent: str) -> Rollout:
        """Return what has happened so far; of a drive that is not over, as one that was stopped."""
        steps, end = list(self._steps), self.end or "stopped"
        if not steps or steps[-1].step != self._moment.step:
            steps.append(self._recorded(None))
        return Rollout(
            scenario=_plain(self.scenario),
            scene=self.scene.name,
            agent=agent,
            seed=self.seed,
            step_s=self.scenario.step_s,
            spacing_s=SPACING_S,
            users={user.id: UserModel(class_name=user.class_name, size_lwh_m=user.size_lwh)
                   for user in self._traffic.everybody},
            end=end,
            steps=tuple(steps),
        )  # fmt: skip

    def _start(self) -> "_Moment":
        return _Moment(0, 0.0, start_state(self.scenario, self.scene, self.route), _STANDING)

    def _judge(self) -> None:
        """Say whether the drive is over at the present moment, and why."""
        if self._hit is not None:
            self._finish("collision", None)
        elif self._completion >= 1:
            self._finish("completed", None)
        elif abs(self._on_route.left_m) > self.scenario.leave_m:
            self._finish("off route", None)
        elif self._moment.time_s >= self.scenario.duration_s - 1e-9:
            self._finish("time", None)

    def _finish(self, end: str, plan: Plan | None) -> None:
        self.end = end
        self._record(plan)

    def _record(self, plan: Plan | None) -> None:
        self._steps.append(self._recorded(plan))

    def _recorded(self, plan: Plan | None) -> RolloutStep:
        moment, state = self._moment, self._moment.state
        height = self.ground.height_m(state.x_m, state.y_m)
        return RolloutStep(
            step=moment.step,
            time_s=moment.time_s,
            ego=EgoRecord(
                x_m=state.x_m, y_m=state.y_m, z_m=height, yaw_rad=state.yaw_rad, speed_m_s=state.speed_m_s,
                steer_rad=state.steer_rad, acceleration_m_s2=moment.control.acceleration_m_s2,
                steer_rate_rad_s=moment.control.steer_rate_rad_s, yaw_rate_rad_s=self._yaw_rate(state),
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
    def _hit(self) -> str | None:
        box = vehicle_box(self.scenario.vehicle, self._moment.state)
        foot = self.ground.height_m(box.x_m, box.y_m)
        top = foot + self.scenario.vehicle.height_m
        for user in self._traffic.users:
            is_over_or_under = user.z_m >= top or user.z_m + user.size_lwh[2] <= foot
            if not is_over_or_under and box.touches(user.box):
                return user.id
        return BACKGROUND if self.occupied.touches(self._since_last(box)) else None

    def _since_last(self, box: PlanarBox) -> PlanarBox:
        """Return the vehicle's box, so long that a fast one leaves no gap to where it was a step ago."""
        gone = self._moment.state.speed_m_s * self.scenario.step_s if self._moment.step else 0.0
        more = max(gone - box.length_m, 0.0)
        x, y = box.x_m - more / 2 * np.cos(box.yaw_rad), box.y_m - more / 2 * np.sin(box.yaw_rad)
        return PlanarBox(float(x), float(y), box.yaw_rad, box.length_m + more, box.width_m)

    @property
    def _on_route(self) -> OnRoute:
        return self.route.nearest(self._moment.state.x_m, self._moment.state.y_m)

    @property
    def _completion(self) -> float:
        start, ahead = self._begins_m, self.route.length_m - self._begins_m
        return float(np.clip((self._on_route.along_m - start) / ahead, 0.0, 1.0)) if ahead > 0 else 1.0

    def _yaw_rate(self, state: VehicleState) -> float:
        return float(state.speed_m_s * np.tan(state.steer_rad) / self.scenario.vehicle.wheelbase_m)

    def _ego(self, state: VehicleState) -> RoadUser:
        vehicle = self.scenario.vehicle
        box = vehicle_box(vehicle, state)
        size = vehicle.length_m, vehicle.width_m, vehicle.height_m
        return RoadUser("ego", "car", size, box.x_m, box.y_m, state.yaw_rad, state.speed_m_s)


@dataclass(frozen=True, slots=True)
class _Moment:
    step: int
    time_s: float
    state: VehicleState
    control: Control
    """Over the step before."""


def vehicle_box(vehicle: Vehicle, state: VehicleState) -> PlanarBox:
    """Return the box on the ground that a vehicle takes up."""
    x = state.x_m + vehicle.middle_m * np.cos(state.yaw_rad)
    y = state.y_m + vehicle.middle_m * np.sin(state.yaw_rad)
    return PlanarBox(float(x), float(y), state.yaw_rad, vehicle.length_m, vehicle.width_m)


def _plain(value: object) -> dict[str, Any]:
    """Return a value as a file gives it back."""
    return msgspec.json.decode(msgspec.json.encode(value))
