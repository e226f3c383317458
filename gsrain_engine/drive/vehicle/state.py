"""How the ego vehicle moves at a moment, and what its driver asks of it. World frame: metres, z up."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True, slots=True)
class VehicleState:
    """Pose and speed of a vehicle, at the middle of its rear axle."""

    x_m: float
    y_m: float
    yaw_rad: float
    """Counter-clockwise from the world's x; not wrapped."""
    speed_m_s: float = 0.0
    """Along its heading; 0 or more."""
    steer_rad: float = 0.0
    """Of the front wheels, left positive."""

    def to_world(self, points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Take points in the vehicle's frame (x forward, y left) to the world."""
        return points @ self._turn.T + (self.x_m, self.y_m)

    def from_world(self, points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Take points in the world to the vehicle's frame (x forward, y left)."""
        return (points - (self.x_m, self.y_m)) @ self._turn

    def rig_to_world(self, height_m: float) -> Float64[np.ndarray, "4 4"]:
        """Return the pose of a rig (x forward, y left, z up) at a height above the vehicle's point, in the world."""
        matrix = np.eye(4)
        matrix[:2, :2] = self._turn
        matrix[:3, 3] = self.x_m, self.y_m, height_m
        return matrix

    @property
    def _turn(self) -> Float64[np.ndarray, "2 2"]:
        cosine, sine = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.array([[cosine, -sine], [sine, cosine]])


class Control(NamedTuple):
    """What a vehicle is asked to do until the next moment."""

    acceleration_m_s2: float
    """Below 0 brakes."""
    steer_rate_rad_s: float
    """Of the front wheels, left positive."""
