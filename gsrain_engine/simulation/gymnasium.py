"""Closed-loop Gymnasium environments; the import registers `gsrain/Drive-v0` and `gsrain/DrivePlan-v0`."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from jaxtyping import Float32, Float64, UInt8
from msgspec import Meta

from ..choices import Backend
from ..optional_packages import MissingPackageError, missing_package
from ..settings import Settings

try:
    import gymnasium
    from gymnasium import spaces
except ModuleNotFoundError as _error:
    raise MissingPackageError(missing_package("gymnasium", "an environment")) from _error

from ..backends import open_renderer
from ..scene.open import load_sorted_scene
from ..scene.scene import RigCamera, Scene
from .agents.base import COMMANDS, Observation, SensorRequirements, Trajectory
from .geometry import wrap_angle
from .scenario import Scenario
from .scenario_io import load_scenario
from .sensors import RigRenderer, needed_cameras
from .simulation import Simulation
from .traffic.base import RoadUser
from .vehicle import Control, Vehicle, VehicleState, yaw_rate

CONTROL_ID, PLAN_ID = "gsrain/Drive-v0", "gsrain/DrivePlan-v0"


def register_environments() -> None:
    """Register both environments: controls (acceleration and steering rate) or plan points as actions."""
    for id, action in ((CONTROL_ID, "control"), (PLAN_ID, "plan")):
        if id not in gymnasium.registry:
            gymnasium.register(id=id, entry_point=f"{__name__}:DriveEnvironment", kwargs={"action": action})


_FRONT = SensorRequirements(("front",))
_LARGEST_SEED = 2**32


class Reward(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Weights of the reward of a step.

    reward = progress * (meters along the route) - discomfort * (a^2 + (v * yaw rate)^2) * step, with the
    longitudinal acceleration a over the step and the lateral one v * yaw rate at its end, in m/s2; plus a
    terminal reward for a collision, leaving the route or completing it. A timeout has no terminal reward.
    """

    progress: Annotated[float, Meta(ge=0, title="Progress", extra={"unit": "1/m"})] = 1.0
    discomfort: Annotated[float, Meta(ge=0, title="Discomfort", extra={"unit": "s3/m2"})] = 0.05
    collision: Annotated[float, Meta(le=0, title="Collision")] = -100.0
    off_route: Annotated[float, Meta(le=0, title="Off the route")] = -50.0
    completed: Annotated[float, Meta(ge=0, title="Route completed")] = 100.0

    def of_step(self, before: Observation, after: Observation, vehicle: Vehicle, end: str | None) -> float:
        """Return the reward of a step between two observations; `end` is the reason of the end, None before."""
        along = [each.route.nearest(each.state.x_m, each.state.y_m).along_m for each in (before, after)]
        lateral = after.state.speed_m_s * yaw_rate(vehicle, after.state)
        harsh = after.acceleration_m_s2**2 + lateral**2
        at_end = {"collision": self.collision, "off route": self.off_route, "completed": self.completed}
        step_s = after.time_s - before.time_s
        progress = self.progress * (along[1] - along[0])
        return float(progress - self.discomfort * harsh * step_s + at_end.get(end or "", 0.0))


class DriveEnvironment(gymnasium.Env[dict[str, Any], Any]):
    """A scenario to drive through. `gsrain/Drive-v0` takes controls, `gsrain/DrivePlan-v0` takes plans.

    The seed of `reset` is the rain seed: the same seed and actions give the same observations. Without a seed, each
    episode has other drops. A collision, the end of the route and leaving it by more than `leave_m` terminate; the
    scenario's maximum duration truncates. Vector environments in subprocesses (`gymnasium.make_vec`, "async") need
    `vector_kwargs={"context": "spawn"}`, because kernel threads do not survive a fork.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | Path | Scenario = "stationary-lead",
        scene: str | Path | Scene | None = None,
        *,
        action: Literal["control", "plan"] = "control",
        cameras: tuple[str, ...] = (),
        depth: bool = False,
        semantic: bool = False,
        intensity_mm_h: float | None = None,
        reward: Reward | None = None,
        backend: Backend = "auto",
        render_mode: str | None = None,
    ) -> None:
        """Create the environment.

        `scenario` is a shipped name, a file or a `Scenario`; `scene` a file or folder, "street" or a `Scene`, or the
        scenario's. `cameras` to render are names in the rig, ("front",) or ("all",); `depth` and `semantic` add to
        them. Without images a step takes one to two milliseconds at most. The render mode "rgb_array" enables `render`,
        which returns the front camera image. Raises ValueError if scenario, scene and cameras do not match.
        """
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode {render_mode!r}: only 'rgb_array' can be had")
        chosen = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
        if intensity_mm_h is not None:
            chosen = _with_intensity(chosen, intensity_mm_h)
        opened = scene if isinstance(scene, Scene) else load_sorted_scene(chosen.scene if scene is None else str(scene))
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1 / chosen.step_s)}
        self._action, self._reward = action, reward or Reward()
        needs = SensorRequirements(tuple(cameras), depth, semantic)
        draws = bool(cameras) or render_mode is not None
        with ExitStack() as stack:
            self._renderer = stack.enter_context(open_renderer(backend)) if draws else None
            self.simulation = Simulation(chosen, opened, needs, self._renderer if cameras else None)
            """The simulation; its `rollout("NAME")` records the current episode."""
            mounted = self.simulation.rig.cameras
            if draws and not mounted:
                raise ValueError(f"scene {opened.name!r} has no rig: there is no camera to see through")
            self._resources = stack.pop_all()
        self._front: RigRenderer | None = None
        self._now: Observation | None = None
        self.action_space = control_space() if action == "control" else plan_space()
        self.observation_space = observation_space(needed_cameras(mounted, needs), needs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode; there are no options."""
        super().reset(seed=seed)
        drops = int(self.np_random.integers(_LARGEST_SEED)) if seed is None else seed % _LARGEST_SEED
        self._front = None
        self._now = self.simulation.reset(drops)
        return observation_values(self._now, self.simulation.scenario.vehicle), self._info(self._now)

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Advance by one step. Raises ValueError for an invalid action, before `reset`, and after the end."""
        before, simulation = self._now, self.simulation
        if before is None:
            raise ValueError("the drive has not begun: reset it first")
        values = np.asarray(action, np.float64)
        if values.shape != self.action_space.shape or not np.isfinite(values).all():
            raise ValueError(f"an action of shape {values.shape}: expected finite numbers {self.action_space.shape}")
        vehicle = simulation.scenario.vehicle
        if self._action == "control":
            simulation.advance(control_of(values, vehicle))
        else:
            simulation.step(Trajectory(values))
        self._now = simulation.observation()
        reward = self._reward.of_step(before, self._now, vehicle, simulation.end)
        out_of_time = simulation.end == "time"
        over = simulation.end is not None and not out_of_time
        return observation_values(self._now, vehicle), reward, over, out_of_time, self._info(self._now)

    def render(self) -> UInt8[np.ndarray, "h w 3"] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the current front camera image; None without the render mode "rgb_array", or before `reset`."""
        now, simulation = self._now, self.simulation
        if self._renderer is None or self.render_mode is None or now is None:
            return None
        (front,) = needed_cameras(simulation.rig.cameras, _FRONT)
        if front.name in now.views:
            return now.views[front.name].image
        if self._front is None:
            self._front = RigRenderer(self._renderer, simulation.scenario.rain, (front,), _FRONT, simulation.cut)
        return simulation.render_cameras(self._front)[front.name].image

    def close(self) -> None:
        """Release the renderer."""
        self._resources.close()

    def _info(self, observation: Observation) -> dict[str, Any]:
        state = observation.state
        return {
            "time_s": observation.time_s,
            "pose": (state.x_m, state.y_m, observation.height_m, state.yaw_rad),
            "seed": self.simulation.seed,
            "end": self.simulation.end or "",
        }


def _with_intensity(scenario: Scenario, intensity_mm_h: float) -> Scenario:
    values = msgspec.to_builtins(scenario)
    values["rain"]["intensity_mm_h"] = intensity_mm_h
    try:
        return msgspec.convert(values, Scenario)
    except msgspec.ValidationError as error:
        raise ValueError(f"intensity_mm_h: {error}") from None


# Action and observation spaces

PLAN_POINTS = 6  # number of points of a plan, 0.5 s apart: three seconds, as in UniAD

_REACH_M = 200.0


def control_space() -> spaces.Box:
    """Return the space of controls: acceleration and steering rate as shares of the vehicle's limits.

    Shape (2,), -1..1: from full braking to full acceleration, and from full rate right to full rate left.
    """
    return spaces.Box(-1.0, 1.0, (2,), np.float32)


def plan_space() -> spaces.Box:
    """Return the space of plans: points in the vehicle's frame, (6, 2) meters (x forward, y left), 0.5 s apart."""
    return spaces.Box(-_REACH_M, _REACH_M, (PLAN_POINTS, 2), np.float32)


def control_of(action: Float64[np.ndarray, "2"], vehicle: Vehicle) -> Control:
    pedal, wheel = (float(each) for each in np.clip(action, -1.0, 1.0))
    limit = vehicle.most_acceleration_m_s2 if pedal > 0 else vehicle.most_braking_m_s2
    return Control(pedal * limit, wheel * vehicle.most_steer_rate_rad_s)


ROUTE_POINTS, ROUTE_STEP_M = 30, 2.0
MAX_ROAD_USERS = 16
_FAR_M = 10_000.0
_EGO = np.array([200.0, 100.0, 2.0, 20.0, 100.0, 1000.0, np.pi], np.float32)
_USER = np.array([_FAR_M, _FAR_M, np.pi, 100.0, 100.0, 100.0, 200.0], np.float32)


def observation_space(cameras: Sequence[RigCamera], needs: SensorRequirements) -> spaces.Space[dict[str, Any]]:
    """Return the space of observations.

    ego: (7,) speed m/s, acceleration m/s2, steering rad, steering rate rad/s, yaw rate rad/s, distance left of the
        route m, heading left of the route's rad.
    command: 0 right, 1 left, 2 straight.
    route: (30, 2) points of the route, 2 m apart, from 2 m ahead on, in the vehicle's frame (x forward, y left).
    road_users: (16, 7) nearest first: x and y of the center and heading in the vehicle's frame, length, width,
        height, speed; zeros in unused rows. Ground truth: ignore it when testing cameras.
    road_user_count: number of used rows of `road_users`.
    rgb, depth, semantic: by camera (h, w, 3) uint8; (h, w) float32 m, 0 where there is nothing; (h, w) uint8 of
        Cityscapes' training ids. Each only if requested.
    """
    users = np.tile(_USER, (MAX_ROAD_USERS, 1))
    room: dict[str, spaces.Space[Any]] = {
        "ego": spaces.Box(-_EGO, _EGO, dtype=np.float32),
        "command": spaces.Discrete(len(COMMANDS)),
        "route": spaces.Box(-_FAR_M, _FAR_M, (ROUTE_POINTS, 2), np.float32),
        "road_users": spaces.Box(-users, users, dtype=np.float32),
        "road_user_count": spaces.Discrete(MAX_ROAD_USERS + 1),
    }
    if cameras:
        room["rgb"] = _by_camera(cameras, 255, (3,), np.uint8)
        if needs.depth:
            room["depth"] = _by_camera(cameras, _FAR_M, (), np.float32)
        if needs.semantic:
            room["semantic"] = _by_camera(cameras, 255, (), np.uint8)
    return spaces.Dict(room)


def observation_values(observation: Observation, vehicle: Vehicle) -> dict[str, Any]:
    """Return an observation as values of the space, clipped to its bounds."""
    state = observation.state
    on = observation.route.nearest(state.x_m, state.y_m)
    along = on.along_m + ROUTE_STEP_M * np.arange(1, ROUTE_POINTS + 1)
    route = np.array([observation.route.at(float(each))[:2] for each in along])
    ego = (
        state.speed_m_s, observation.acceleration_m_s2, state.steer_rad, observation.steer_rate_rad_s,
        yaw_rate(vehicle, state), on.left_m, wrap_angle(state.yaw_rad - observation.route.at(on.along_m)[2]),
    )  # fmt: skip
    count, users = _road_users(state, observation.road_users)
    found: dict[str, Any] = {
        "ego": _within(np.array(ego), _EGO),
        "command": COMMANDS.index(observation.command),
        "route": _within(state.from_world(route), np.float32(_FAR_M)),
        "road_users": users,
        "road_user_count": count,
    }
    views = observation.views.items()
    images: dict[str, dict[str, Any]] = {
        "rgb": {name: view.image for name, view in views},
        "depth": {name: np.minimum(view.depth_m, _FAR_M) for name, view in views if view.depth_m is not None},
        "semantic": {name: view.semantic for name, view in views if view.semantic is not None},
    }
    return found | {name: by_camera for name, by_camera in images.items() if by_camera}


def _road_users(state: VehicleState, users: Sequence[RoadUser]) -> tuple[int, Float32[np.ndarray, "users 7"]]:
    """Return the number of road users and the rows of the nearest."""
    rows = np.zeros((MAX_ROAD_USERS, len(_USER)), np.float32)
    if not users:
        return 0, rows
    places = state.from_world(np.array([(user.x_m, user.y_m) for user in users]))
    nearest = np.argsort(np.linalg.norm(places, axis=1), kind="stable")[:MAX_ROAD_USERS]
    for row, i in enumerate(nearest):
        user = users[i]
        turned = wrap_angle(user.yaw_rad - state.yaw_rad)
        rows[row] = _within(np.array([*places[i], turned, *user.size_lwh, user.speed_m_s]), _USER)
    return len(nearest), rows


def _within(values: Float64[np.ndarray, "..."], limit: Any) -> Float32[np.ndarray, "..."]:
    return np.clip(values.astype(np.float32), -limit, limit)


def _by_camera(cameras: Sequence[RigCamera], limit: float, channels: tuple[int, ...], kind: Any) -> spaces.Space[Any]:
    return spaces.Dict({
        camera.name: spaces.Box(0, limit, (camera.height, camera.width, *channels), kind) for camera in cameras
    })  # fmt: skip


register_environments()
