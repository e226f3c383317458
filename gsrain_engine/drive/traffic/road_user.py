"""Somebody else on the road, at a moment. World frame, metres."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from ..road.planar_box import PlanarBox


@dataclass(frozen=True, slots=True)
class RoadUser:
    """A thing that may be driven into: its box on the ground, around its middle, and how fast it goes."""

    id: str
    class_name: str
    """As the scene calls it: "car", "truck", "pedestrian"."""
    size_lwh: tuple[float, float, float]
    """Metres."""
    x_m: float
    y_m: float
    yaw_rad: float
    """Counter-clockwise from the world's x."""
    speed_m_s: float = 0.0
    """Along its heading."""
    z_m: float = 0.0
    """Height of its bottom."""

    @property
    def box(self) -> PlanarBox:
        return PlanarBox(self.x_m, self.y_m, self.yaw_rad, self.size_lwh[0], self.size_lwh[1])

    @property
    def pose(self) -> Float64[np.ndarray, "4 4"]:
        """From its own frame (x forward, y left, z up, origin at the bottom centre) to the world."""
        matrix = np.eye(4)
        cosine, sine = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        matrix[:2, :2] = [[cosine, -sine], [sine, cosine]]
        matrix[:3, 3] = self.x_m, self.y_m, self.z_m
        return matrix

    def ahead(self, distance_m: float) -> "RoadUser":
        """Return it so far ahead along its heading."""
        x = self.x_m + distance_m * float(np.cos(self.yaw_rad))
        return replace(self, x_m=x, y_m=self.y_m + distance_m * float(np.sin(self.yaw_rad)))

    def moved(self, **fields: float) -> "RoadUser":
        """Return it elsewhere, or at another speed."""
        return replace(self, **fields)
