"""Playback of a roll-out in the editor's scene: each road user gets a track, so that no copies are needed."""

import operator
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from ..scene.gaussians import Gaussians
from ..scene.geometry import quaternions_from_matrices
from ..scene.lod_order import in_lod_order
from ..scene.scene import Actor, PoseTrack, RigCamera, Scene
from ..simulation.agents.base import SensorRequirements
from ..simulation.playback import RolloutPlayback
from ..simulation.rollout import Rollout
from ..simulation.scenario import Scenario
from ..simulation.sensors import needed_cameras
from ..simulation.traffic.appearance import scale_gaussians, vehicle_model
from .viewport.camera_follow import VehicleMoment

EGO_CAR = "ego car"
"""Id of the actor that is the ego vehicle's body; no road user has this id."""

_BODY = "saloon"
Poses = Float64[np.ndarray, "t 4 4"]


class RolloutInScene:
    """One roll-out in one scene; scenes that differ only away from the roll-out's actors share it."""

    def __init__(self, rollout: Rollout, scene: Scene) -> None:
        """Give each road user its track.

        Raises ValueError if the scene lacks an actor of the roll-out, because it was driven in another scene.
        """
        try:
            self.played = RolloutPlayback(rollout, scene)
            self._times = np.array([each.time_s for each in rollout.steps])
            self._to_scene = np.linalg.inv(scene.scene_to_world)
            self._scale = 1 / scene.metres_per_unit
            self._users = tuple(self._user(id, scene) for id in rollout.users)
        except KeyError as missing:
            raise ValueError(f"this scene has no actor {missing}: the roll-out is of {rollout.scene!r}") from None
        rig = np.array([self.played.rig_to_world(t) for t in self._times])
        self._rig = self._track(rig, np.ones(len(rig), bool))
        self._body = self._ego_car(scene)
        self._of = scene
        self._shown: dict[bool, tuple[Scene, Scene]] = {}

    def placed_in(self, scene: Scene) -> "RolloutInScene":
        """Return the roll-out placed in a changed scene; raises as the constructor does."""
        return RolloutInScene(self.played.rollout, scene)

    def fits(self, scene: Scene) -> bool:
        """Return whether the roll-out is still valid in a scene: same units, axes, and actors that it uses."""
        same = all(map(operator.is_, self._actors_of(self._of), self._actors_of(scene)))
        return same and np.array_equal(scene.scene_to_world, self._of.scene_to_world)

    def _actors_of(self, scene: Scene) -> list[Actor | None]:
        """The scene's own actors that the roll-out uses."""
        there = {each.id: each for each in scene.actors}
        models = {user.model.removeprefix("actor:") for user in self.scenario.road_users}
        return [there.get(id) for id in sorted({*self.played.rollout.users, *models})]

    @property
    def scenario(self) -> Scenario:
        return self.played.scenario

    @property
    def start_s(self) -> float:
        """Scene time at the start of the scenario."""
        return self.played.scene_time_s(0.0)

    @property
    def span_s(self) -> tuple[float, float]:
        """Start and end in the scene's time."""
        return self.start_s, self.played.scene_time_s(self.played.end_s)

    def own_time_s(self, clock_s: float) -> float:
        """Seconds since the scenario began, clipped to the drive."""
        return float(np.clip(clock_s - self.start_s, 0.0, self.played.end_s))

    def scene(self, scene: Scene, *, with_ego: bool) -> Scene:
        """Return a scene with all road users; `with_ego` includes a body for the ego vehicle."""
        if with_ego not in self._shown or self._shown[with_ego][0] is not scene:
            actors = (*self._users, self._body) if with_ego else self._users
            self._shown[with_ego] = scene, replace(scene, actors=actors, ego=self._rig)
        return self._shown[with_ego][1]

    def vehicle(self, clock_s: float) -> VehicleMoment:
        """Ego vehicle at a scene time, for a chase camera."""
        time_s = self.own_time_s(clock_s)
        pose, state = self.played.rig_to_world(time_s), self.played.state(time_s)
        return VehicleMoment(pose, state.speed_m_s, self.played.rig.height_m, self.front_camera)

    @property
    def front_camera(self) -> RigCamera | None:
        """The rig's camera that looks most straight ahead."""
        cameras = self.played.rig.cameras
        return needed_cameras(cameras, SensorRequirements(cameras=("front",)))[0] if cameras else None

    def _user(self, id: str, scene: Scene) -> Actor:
        """A road user with its Gaussians and its track through the whole drive."""
        played, poses, there = self.played, [np.eye(4)] * len(self._times), np.zeros(len(self._times), bool)
        for k, time_s in enumerate(self._times):
            for user in played.users(float(time_s)):
                if user.id == id:
                    poses[k], there[k] = user.pose, True
        first = float(self._times[int(there.argmax())])
        actor = next(each for each in played.scene(first).actors if each.id == id)
        if not any(actor.gaussians is each.gaussians for each in scene.actors):
            actor = replace(actor, gaussians=in_lod_order(actor.gaussians))
        return replace(actor, track=self._track(np.array(poses), there))

    def _ego_car(self, scene: Scene) -> Actor:
        vehicle = self.scenario.vehicle
        look = vehicle_model(_BODY, scene)
        gaussians: Gaussians = scale_gaussians(look.gaussians, self._scale * vehicle.length_m / look.size_lwh_m[0])
        middle = np.eye(4)
        middle[:3, 3] = vehicle.middle_m, 0.0, -self.played.rig.height_m
        poses = np.array([self.played.rig_to_world(t) @ middle for t in self._times])
        length, width, height = (self._scale * each for each in (vehicle.length_m, vehicle.width_m, vehicle.height_m))
        track = self._track(poses, np.ones(len(poses), bool))
        return Actor(EGO_CAR, "car", (length, width, height), in_lod_order(gaussians), track)

    def _track(self, poses: Poses, there: np.ndarray) -> PoseTrack:
        """Scene track from poses in the world (meters) at the roll-out's times."""
        own = self._to_scene @ poses
        turns = own[:, :3, :3] / np.cbrt(np.linalg.det(own[:, :3, :3]))[:, None, None]
        quaternions = np.asarray(quaternions_from_matrices(turns), np.float64)
        return PoseTrack(self._times + self.start_s, own[:, :3, 3].copy(), quaternions, there)
