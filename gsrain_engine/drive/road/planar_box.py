"""Boxes on the ground as seen from above, and whether they touch. World frame, metres."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from jaxtyping import Float64


@dataclass(frozen=True)
class PlanarBox:
    """A rectangle on the ground, around its middle."""

    x_m: float
    y_m: float
    yaw_rad: float
    """Of its length, counter-clockwise from the world's x."""
    length_m: float
    width_m: float

    @cached_property
    def corners(self) -> Float64[np.ndarray, "4 2"]:
        """Front left, rear left, rear right, front right."""
        half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (self.length_m / 2, self.width_m / 2)
        cosine, sine = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return half @ np.array([[cosine, sine], [-sine, cosine]]) + (self.x_m, self.y_m)

    @cached_property
    def polygon(self) -> shapely.Polygon:
        """The rectangle for shapely."""
        return shapely.Polygon(self.corners)

    def touches(self, other: "PlanarBox") -> bool:
        """Whether two rectangles overlap or share a point."""
        reach = np.hypot(self.length_m, self.width_m) + np.hypot(other.length_m, other.width_m)
        if np.hypot(self.x_m - other.x_m, self.y_m - other.y_m) > reach / 2:
            return False
        return bool(self.polygon.intersects(other.polygon))
