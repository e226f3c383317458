"""Cameras that follow: the ego vehicle of a roll-out, an actor, or a path. World frame, meters."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float64

from ...scene.camera_path import CameraPath
from ...scene.scene import Actor, RigCamera, Scene
from .camera import OrbitCamera, default_path

ChaseMode = Literal["behind", "front camera", "free"]
_BEHIND_M, _ABOVE_M = 8.0, 3.0
_LOOKS_AT_M, _AT_HEIGHT_M = 8.0, 1.0
_FOV_DEG = 50.0


class VehicleMoment(NamedTuple):
    """Ego vehicle at one time."""

    rig_to_world: Float64[np.ndarray, "4 4"]
    speed_m_s: float
    rig_height_m: float
    """Height of the rig's origin above the road."""
    front_camera: RigCamera | None


@dataclass(slots=True)
class ChaseCamera:
    """Moves the viewport camera with the vehicle. The user may look around; in front-camera mode that ends the ride."""

    mode: ChaseMode = "free"
    velocity_m_s: Float64[np.ndarray, "3"] | None = None
    """Velocity of the camera, which slants the rain; None if it moves freely."""
    _pose: Float64[np.ndarray, "4 4"] | None = None

    def begin(self, mode: ChaseMode) -> None:
        """Start a mode in the next frame, from its default position."""
        self.mode, self._pose, self.velocity_m_s = mode, None, None

    def let_go(self) -> None:
        """Leave the front camera, because the user looks elsewhere."""
        if self.mode == "front camera":
            self.begin("free")

    def ride(self, vehicle: VehicleMoment, navigation: OrbitCamera) -> None:
        self.velocity_m_s = None
        if self.mode == "free":
            return
        pose = vehicle.rig_to_world
        self.velocity_m_s = vehicle.speed_m_s * pose[:3, 0]
        if self.mode == "front camera":
            if vehicle.front_camera is not None:
                navigation.look_like(vehicle.front_camera.camera(pose).pinhole)
        elif self._pose is None:
            _stand_behind(vehicle, navigation)
        elif not np.array_equal(self._pose, pose):
            navigation.carry(pose @ np.linalg.inv(self._pose))
        self._pose = pose


def _stand_behind(vehicle: VehicleMoment, navigation: OrbitCamera) -> None:
    ahead = np.array([_BEHIND_M + _LOOKS_AT_M, 0.0, _AT_HEIGHT_M - _ABOVE_M])
    to_world, origin = vehicle.rig_to_world[:3, :3], vehicle.rig_to_world[:3, 3]
    navigation.position = to_world @ np.array([-_BEHIND_M, 0.0, _ABOVE_M - vehicle.rig_height_m]) + origin
    x, y, z = to_world @ ahead
    navigation.heading = float(np.arctan2(y, x))
    navigation.pitch = float(np.arctan2(z, np.hypot(x, y)))
    navigation.distance_m = float(np.linalg.norm(ahead))
    navigation.vertical_fov_deg = _FOV_DEG


@dataclass(slots=True)
class ActorFollower:
    """Camera that follows an actor at its offset, while the user may look around. World frame, meters."""

    key: str = ""
    """Key of the actor; "" for none."""
    velocity_m_s: Float64[np.ndarray, "3"] | None = None
    """Velocity of the ride; None while nothing is followed or time is paused."""
    _pose: Float64[np.ndarray, "4 4"] | None = None
    _time_s: float = 0.0

    def follow(self, key: str) -> None:
        """Follow an actor from the camera's present position; "" stops."""
        self.key, self._pose, self.velocity_m_s = key, None, None

    def ride(self, scene: Scene, time_s: float, navigation: OrbitCamera) -> None:
        """Move and turn the camera with the actor since the last call; it stays while the actor is absent."""
        actor = next((each for each in scene.actors if each.key == self.key), None)
        pose = _level_pose(scene, actor, time_s) if actor is not None else None
        before, self.velocity_m_s = self._pose, None
        if actor is None:
            self.key = ""
        if pose is not None and before is not None and not np.array_equal(pose, before):
            step = pose @ np.linalg.inv(before)
            moved = step[:3, :3] @ navigation.position + step[:3, 3]
            if time_s > self._time_s:
                self.velocity_m_s = (moved - navigation.position) / (time_s - self._time_s)
            navigation.turn(float(np.arctan2(step[1, 0], step[0, 0])), 0.0)
            navigation.position = moved
        if pose is not None or actor is None:
            self._pose = pose
        self._time_s = time_s


def _level_pose(scene: Scene, actor: Actor, time_s: float) -> Float64[np.ndarray, "4 4"] | None:
    """Position and heading of an actor, without its pitch and roll."""
    to_scene = actor.pose_at(time_s)
    if to_scene is None:
        return None
    pose = scene.scene_to_world @ to_scene
    heading = float(np.arctan2(pose[1, 0], pose[0, 0]))
    c, s = np.cos(heading), np.sin(heading)
    level = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    level[:3, 3] = pose[:3, 3]
    return level


# Path to ride along and to record: the user's or a default one, in the world

Matrix = Float64[np.ndarray, "4 4"]


class PathFollower:
    """Caches the path of the present scene; returns the same object while its inputs stay the same."""

    _own: tuple[CameraPath, Matrix, CameraPath] | None = None
    _default: tuple[tuple[object, object], Matrix, CameraPath] | None = None

    def path(self, scene: Scene) -> CameraPath:
        """Path of a scene, in the world (meters, z up)."""
        to_world = scene.scene_to_world
        if scene.path is None:
            return self._default_path(scene, to_world)
        if self._own is None or self._own[0] is not scene.path or not np.array_equal(self._own[1], to_world):
            self._own = scene.path, to_world, scene.path.moved(to_world)
        return self._own[2]

    def _default_path(self, scene: Scene, to_world: Matrix) -> CameraPath:
        # Independent of layers: hiding or deleting them must not change a path that the user rides along.
        drive = scene.ego, scene.rigs
        if self._default is None or any(a is not b for a, b in zip(self._default[0], drive, strict=True)):
            path = default_path(scene, 960, 640)  # only the aspect ratio counts, for the field of view
            self._default = drive, to_world, path
        elif not np.array_equal(self._default[1], to_world):
            step = to_world @ np.linalg.inv(self._default[1])
            self._default = drive, to_world, self._default[2].moved(step)
        return self._default[2]
