"""A camera that goes along with a drive: behind the ego vehicle, or its own front camera. World frame, metres."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import RigCamera

from .navigation import Navigation

ChaseMode = Literal["behind", "front camera", "free"]

_BEHIND_M, _ABOVE_M = 8.0, 3.0
_LOOKS_AT_M, _AT_HEIGHT_M = 8.0, 1.0
_FOV_DEG = 50.0


class ChasedVehicle(NamedTuple):
    """The ego vehicle at one moment."""

    rig_to_world: Float64[np.ndarray, "4 4"]
    speed_m_s: float
    rig_height_m: float
    """Of the rig's origin above the road."""
    front_camera: RigCamera | None


@dataclass(slots=True)
class Chase:
    """Carries the viewport's camera. A person may look around meanwhile; from the front camera that ends the ride."""

    mode: ChaseMode = "free"
    velocity_m_s: Float64[np.ndarray, "3"] | None = None
    """Of the camera, by which rain slants; None where it goes its own way."""
    _pose: Float64[np.ndarray, "4 4"] | None = None

    def begin(self, mode: ChaseMode) -> None:
        """Go along in a way from the next frame on, from its usual place."""
        self.mode, self._pose, self.velocity_m_s = mode, None, None

    def let_go(self) -> None:
        """Leave a place that is fixed to the vehicle: a person looks elsewhere."""
        if self.mode == "front camera":
            self.begin("free")

    def ride(self, vehicle: ChasedVehicle, navigation: Navigation) -> None:
        self.velocity_m_s = None
        if self.mode == "free":
            return
        pose = vehicle.rig_to_world
        self.velocity_m_s = vehicle.speed_m_s * pose[:3, 0]
        if self.mode == "front camera":
            _look_from_front(vehicle, navigation)
        elif self._pose is None:
            _stand_behind(vehicle, navigation)
        elif not np.array_equal(self._pose, pose):
            navigation.carry(pose @ np.linalg.inv(self._pose))
        self._pose = pose


def _stand_behind(vehicle: ChasedVehicle, navigation: Navigation) -> None:
    ahead = np.array([_BEHIND_M + _LOOKS_AT_M, 0.0, _AT_HEIGHT_M - _ABOVE_M])
    to_world, origin = vehicle.rig_to_world[:3, :3], vehicle.rig_to_world[:3, 3]
    navigation.position = to_world @ np.array([-_BEHIND_M, 0.0, _ABOVE_M - vehicle.rig_height_m]) + origin
    x, y, z = to_world @ ahead
    navigation.heading = float(np.arctan2(y, x))
    navigation.pitch = float(np.arctan2(z, np.hypot(x, y)))
    navigation.distance_m = float(np.linalg.norm(ahead))
    navigation.vertical_fov_deg = _FOV_DEG


def _look_from_front(vehicle: ChasedVehicle, navigation: Navigation) -> None:
    front = vehicle.front_camera
    if front is None:
        return
    to_camera = np.linalg.inv(vehicle.rig_to_world @ front.camera_to_ego)
    navigation.look_like(
        Camera(front.width, front.height, front.fx, front.fy, front.cx, front.cy, to_camera, front.exposure_s)
    )
