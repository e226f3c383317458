"""Playback of a roll-out with interpolation between steps. World frame, meters."""

from bisect import bisect_left, bisect_right

import msgspec
import numpy as np
from jaxtyping import Float64

from ..safe_io.text_files import printable_line
from ..scene.scene import Scene
from .agents.base import Rig
from .geometry import wrap_angle
from .ground import road_surface_of
from .rollout import Rollout, RolloutStep
from .scenario import Scenario
from .sensors import camera_of_width, rig_cameras
from .simulation import RoadScene, past_motions
from .traffic.appearance import vehicle_model
from .traffic.base import RoadUser
from .vehicle import VehicleState


class RolloutPlayback:
    """A roll-out in its scene. Times are seconds since the scenario began."""

    def __init__(self, rollout: Rollout, scene: Scene) -> None:
        """Combine a roll-out and its scene.

        Raises ValueError if the scene lacks a required model, or the roll-out's scenario can't be read.
        """
        try:
            self.scenario = msgspec.convert(rollout.scenario, Scenario)
        except msgspec.ValidationError as error:
            raise ValueError(f"the roll-out's scenario: {printable_line(error)}") from None
        self.rollout = rollout
        self.base = scene
        rig = self.scenario.rig if self.scenario.rig in scene.rigs else None  # else the scene's first
        width = self.scenario.picture_width_px
        cameras = tuple(camera_of_width(each, width) for each in rig_cameras(scene, rig))
        self.rig = Rig(self.scenario.vehicle, cameras, road_surface_of(scene).rig_height_m)
        looks = {user.id: vehicle_model(user.model, scene) for user in self.scenario.road_users}
        self._road = RoadScene(scene, looks, self.scenario.road_users)
        self._times = [step.time_s for step in rollout.steps]

    @property
    def end_s(self) -> float:
        return self._times[-1]

    def step(self, time_s: float) -> RolloutStep:
        """Return the last step that has begun at a time."""
        return self._around(time_s)[0]

    def state(self, time_s: float) -> VehicleState:
        before, after, part = self._around(time_s)
        names = ("x_m", "y_m", "yaw_rad", "speed_m_s", "steer_rad")
        return VehicleState(**{name: _mixed(before.ego, after.ego, name, part) for name in names})

    def users(self, time_s: float) -> tuple[RoadUser, ...]:
        """Return the road users at a time; each that appears or disappears in a step is present until the step ends."""
        before, after, part = self._around(time_s)
        later = {user.id: user for user in after.road_users}
        users: list[RoadUser] = []
        for user in before.road_users:
            model, then = self.rollout.users[user.id], later.get(user.id, user)
            names = ("x_m", "y_m", "yaw_rad", "speed_m_s", "z_m")
            fields = {name: _mixed(user, then, name, part) for name in names}
            users.append(RoadUser(user.id, model.class_name, model.size_lwh_m, **fields))
        return tuple(users)

    def rig_to_world(self, time_s: float) -> Float64[np.ndarray, "4 4"]:
        """Return the pose of the ego vehicle's rig (x forward, y left, z up, above the rear axle)."""
        before, after, part = self._around(time_s)
        return self.state(time_s).rig_to_world(_mixed(before.ego, after.ego, "z_m", part) + self.rig.height_m)

    def scene(self, time_s: float) -> Scene:
        users, rig = self.users(time_s), self.rig_to_world(time_s)
        before = self.rollout.steps[: bisect_left(self._times, time_s)]
        return self._road.at(rig, users, past_motions(before, time_s, users, rig, self.scenario))

    def scene_time_s(self, time_s: float) -> float:
        """Return the scene time, which drives the rain."""
        return self.scenario.start_s + time_s

    def _around(self, time_s: float) -> tuple[RolloutStep, RolloutStep, float]:
        """Return the steps before and after a time, and the fraction between them, 0..1."""
        lower = max(bisect_right(self._times, time_s) - 1, 0)
        upper = min(lower + 1, len(self._times) - 1)
        span = self._times[upper] - self._times[lower]
        part = float(np.clip((time_s - self._times[lower]) / span, 0, 1)) if span > 0 else 0.0
        return self.rollout.steps[lower], self.rollout.steps[upper], part


def _mixed(before: object, after: object, name: str, part: float) -> float:
    """Interpolate a field between two records; angles turn the shorter way."""
    first, last = getattr(before, name), getattr(after, name)
    return first + part * wrap_angle(last - first) if name == "yaw_rad" else (1 - part) * first + part * last
