"""A camera that goes along with a drive: behind the ego vehicle, or its own front camera. World frame, metres."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.camera import Camera

from ..view.navigation import Navigation
from .shown_rollout import ShownRollout

ChaseMode = Literal["behind", "front camera", "free"]

_BEHIND_M, _ABOVE_M = 8.0, 3.0
_LOOKS_AT_M, _AT_HEIGHT_M = 8.0, 1.0
_FOV_DEG = 50.0


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

    def ride(self, shown: ShownRollout, clock_s: float, navigation: Navigation) -> None:
        """Go to where the drive is now."""
        self.velocity_m_s = None
        if self.mode == "free":
            return
        time_s = shown.own_time_s(clock_s)
        pose, state = shown.played.rig_to_world(time_s), shown.played.state(time_s)
        self.velocity_m_s = state.speed_m_s * pose[:3, 0]
        if self.mode == "front camera":
            _look_from_front(shown, pose, navigation)
        elif self._pose is None:
            _stand_behind(pose, shown.played.rig.height_m, navigation)
        elif not np.array_equal(self._pose, pose):
            navigation.carry(pose @ np.linalg.inv(self._pose))
        self._pose = pose


def _stand_behind(pose: Float64[np.ndarray, "4 4"], height_m: float, navigation: Navigation) -> None:
    ahead = np.array([_BEHIND_M + _LOOKS_AT_M, 0.0, _AT_HEIGHT_M - _ABOVE_M])
    to_world = pose[:3, :3]
    navigation.position = to_world @ np.array([-_BEHIND_M, 0.0, _ABOVE_M - height_m]) + pose[:3, 3]
    x, y, z = to_world @ ahead
    navigation.heading = float(np.arctan2(y, x))
    navigation.pitch = float(np.arctan2(z, np.hypot(x, y)))
    navigation.distance_m = float(np.linalg.norm(ahead))
    navigation.vertical_fov_deg = _FOV_DEG


def _look_from_front(shown: ShownRollout, pose: Float64[np.ndarray, "4 4"], navigation: Navigation) -> None:
    front = shown.front_camera
    if front is None:
        return
    to_camera = np.linalg.inv(pose @ front.camera_to_ego)
    navigation.look_like(
        Camera(front.width, front.height, front.fx, front.fy, front.cx, front.cy, to_camera, front.exposure_s)
    )
