"""HUGSIM's world: the axes of the front camera where the drive begins (x right, y down, z forward), in metres.

From our world (z up) to there. HUGSIM takes the first recorded front camera as it is mounted; ours is levelled, so that
y is straight down and the ego vehicle keeps its x-z plane: its boxes and poses assume as much.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from ..agents.lidar_mount import front_camera
from ..agents.observation import Observation, Rig
from ..traffic.road_user import RoadUser

Box = list[float]
"""z, -x, -y, width, length, height, yaw: middle in axes x forward, y left, z up, yaw left positive (HUGSIM's "IMU")."""


@dataclass(frozen=True, slots=True)
class HugsimWorld:
    """Where HUGSIM's world lies in ours."""

    x_m: float
    y_m: float
    z_m: float
    """The front camera's place when the drive begins."""
    yaw_rad: float
    """The vehicle's heading then."""

    @classmethod
    def beginning(cls, rig: Rig, observation: Observation) -> "HugsimWorld":
        """Put the world's origin into the front camera as it stands at an observation."""
        x, y, z = _front_camera(rig, observation)
        return cls(x, y, z, observation.state.yaw_rad)

    def place(self, x_m: float, y_m: float, z_m: float) -> Float64[np.ndarray, "3"]:
        """Take a place in our world to HUGSIM's."""
        cosine, sine = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        forward = cosine * (x_m - self.x_m) + sine * (y_m - self.y_m)
        left = cosine * (y_m - self.y_m) - sine * (x_m - self.x_m)
        return np.array([-left, self.z_m - z_m, forward])

    def yaw(self, yaw_rad: float) -> float:
        """Take a heading (left positive) to an angle about y down (right positive), -pi..pi."""
        return wrapped(self.yaw_rad - yaw_rad)

    def ego_place(self, rig: Rig, observation: Observation) -> Float64[np.ndarray, "3"]:
        """Return where the front camera is: HUGSIM's point of reference of the ego vehicle."""
        return self.place(*_front_camera(rig, observation))

    def ego_box(self, rig: Rig, observation: Observation) -> Box:
        """Return the ego vehicle's box: around its body's middle, at the front camera's height."""
        state, vehicle = observation.state, rig.vehicle
        x, y = state.to_world(np.array([[vehicle.middle_m, 0.0]]))[0]
        middle = self.place(float(x), float(y), _front_camera(rig, observation)[2])
        size = vehicle.width_m, vehicle.length_m, vehicle.height_m
        return [*_forward_left_up(middle), *size, -self.yaw(state.yaw_rad)]

    def object_box(self, user: RoadUser) -> Box:
        """Return a road user's box: its bottom's middle, and its heading as HUGSIM writes it, -yaw - pi/2.

        HUGSIM's models look along their own x, a quarter turn right of forward: `yaw` is that of the model, -pi..pi.
        """
        bottom = self.place(user.x_m, user.y_m, user.z_m)
        length, width, height = user.size_lwh
        model_yaw = wrapped(self.yaw(user.yaw_rad) - np.pi / 2)
        return [*_forward_left_up(bottom), width, length, height, -model_yaw - np.pi / 2]


def wrapped(angle_rad: float) -> float:
    return float(np.arctan2(np.sin(angle_rad), np.cos(angle_rad)))


def _front_camera(rig: Rig, observation: Observation) -> tuple[float, float, float]:
    x, y, z = front_camera(rig.cameras).camera_to_ego[:3, 3]
    world = observation.state.to_world(np.array([[x, y]]))[0]
    return float(world[0]), float(world[1]), float(observation.height_m + rig.height_m + z)


def _forward_left_up(place: Float64[np.ndarray, "3"]) -> tuple[float, float, float]:
    return float(place[2]), -float(place[0]), -float(place[1])
