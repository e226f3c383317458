"""Gymnasium environment of a drive through a rainy scene, and its reward."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Literal

import gymnasium
import msgspec
import numpy as np
from jaxtyping import UInt8
from msgspec import Meta

from ...backends import Backend, open_renderer
from ...scene.open import load_sorted_scene
from ...scene.scene import Scene
from ..agents.base import Observation, SensorRequirements, Trajectory
from ..scenario import Scenario
from ..scenario_io import load_scenario
from ..sensors import RigRenderer, needed_cameras
from ..simulation import Simulation
from ..vehicle import Vehicle, yaw_rate
from .spaces import control_of, control_space, observation_space, observation_values, plan_space

_FRONT = SensorRequirements(("front",))
_LARGEST_SEED = 2**32

# Reward


class Reward(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
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
        got_on = _along(after) - _along(before)
        state = after.state
        lateral = state.speed_m_s * yaw_rate(vehicle, state)
        harsh = after.acceleration_m_s2**2 + lateral**2
        at_end = {"collision": self.collision, "off route": self.off_route, "completed": self.completed}
        step_s = after.time_s - before.time_s
        return float(self.progress * got_on - self.discomfort * harsh * step_s + at_end.get(end or "", 0.0))


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

        Args:
            scenario: Shipped name, file, or `Scenario`.
            scene: Scene file or folder, "street", or `Scene`; defaults to the scenario's.
            action: Type of actions.
            cameras: Cameras to render: rig camera names, ("front",), or ("all",). Empty by default: without images a
                step takes one to two milliseconds at most.
            depth: True adds depth to the observations.
            semantic: True adds semantic classes to the observations.
            intensity_mm_h: Rain intensity, 0..100; defaults to the scenario's.
            reward: Reward weights.
            backend: Render back end.
            render_mode: "rgb_array" enables `render`, which returns the front camera image.

        Raises ValueError if scenario, scene and cameras do not match.
        """
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode {render_mode!r}: only 'rgb_array' can be had")
        chosen = _with_intensity(
            scenario if isinstance(scenario, Scenario) else load_scenario(scenario), intensity_mm_h
        )
        opened = scene if isinstance(scene, Scene) else load_sorted_scene(chosen.scene if scene is None else str(scene))
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1 / chosen.step_s)}
        self._action, self._reward = action, reward or Reward()
        self._resources = ExitStack()
        needs = SensorRequirements(tuple(cameras), depth, semantic)
        draws = bool(cameras) or render_mode is not None
        self._renderer = self._resources.enter_context(open_renderer(backend)) if draws else None
        try:
            self.simulation = Simulation(chosen, opened, needs, self._renderer if cameras else None)
            """The simulation; its `rollout("NAME")` records the current episode."""
        except ValueError:
            self.close()
            raise
        mounted = self.simulation.rig.cameras
        if draws and not mounted:
            self.close()
            raise ValueError(f"scene {opened.name!r} has no rig: there is no camera to see through")
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
        """Advance by one step.

        Raises ValueError before `reset`, after the end, and for actions that are not finite or of another shape.
        """
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
        over = simulation.end is not None
        out_of_time = simulation.end == "time"
        return (
            observation_values(self._now, vehicle),
            reward,
            over and not out_of_time,
            out_of_time,
            self._info(self._now),
        )

    def render(self) -> UInt8[np.ndarray, "h w 3"] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the current front camera image; None without the render mode "rgb_array", or before `reset`."""
        now, simulation = self._now, self.simulation
        if self._renderer is None or self.render_mode is None or now is None:
            return None
        (front,) = needed_cameras(simulation.rig.cameras, _FRONT)
        if front.name in now.views:
            return now.views[front.name].image
        if self._front is None:
            self._front = RigRenderer(self._renderer, simulation.scenario.rain, (front,), _FRONT)
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


def _with_intensity(scenario: Scenario, intensity_mm_h: float | None) -> Scenario:
    if intensity_mm_h is None:
        return scenario
    values = msgspec.to_builtins(scenario)
    values["rain"]["intensity_mm_h"] = intensity_mm_h
    try:
        return msgspec.convert(values, Scenario)
    except msgspec.ValidationError as error:
        raise ValueError(f"intensity_mm_h: {error}") from None


def _along(observation: Observation) -> float:
    return observation.route.nearest(observation.state.x_m, observation.state.y_m).along_m
