"""Plane geometry: wrapped angles and rectangles on the ground. World frame, meters."""

from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
import shapely
from jaxtyping import Float64

_Angle = TypeVar("_Angle", float, Float64[np.ndarray, " n"])


def wrap_angle(angle_rad: _Angle) -> _Angle:
    """Wrap angles to [-pi, pi)."""
    return (angle_rad + np.pi) % (2 * np.pi) - np.pi


def wrap_degrees(angle_deg: float) -> float:
    """Wrap an angle to [-180, 180) degrees."""
    return (angle_deg + 180.0) % 360.0 - 180.0


# Rectangles


@dataclass(frozen=True)
class PlanarBox:
    """A rectangle on the ground, given by its center."""

    x_m: float
    y_m: float
    yaw_rad: float
    """Direction of the length, counterclockwise from the world's x axis."""
    length_m: float
    width_m: float

    @cached_property
    def corners(self) -> Float64[np.ndarray, "4 2"]:
        """Corners: front left, rear left, rear right, front right."""
        half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (self.length_m / 2, self.width_m / 2)
        cosine, sine = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return half @ np.array([[cosine, sine], [-sine, cosine]]) + (self.x_m, self.y_m)

    @cached_property
    def polygon(self) -> shapely.Polygon:
        return shapely.Polygon(self.corners)

    def lattice(self, step_m: float) -> Float64[np.ndarray, "n 2"]:
        """Return a grid of points over the rectangle including its edges, spaced at most `step_m` along each side."""
        along, across = (
            np.linspace(-side / 2, side / 2, int(np.ceil(side / step_m)) + 1) for side in (self.length_m, self.width_m)
        )
        cosine, sine = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        x = self.x_m + cosine * along[:, None] - sine * across
        y = self.y_m + sine * along[:, None] + cosine * across
        return np.stack([x.ravel(), y.ravel()], axis=1)

    def part(self, rear: int, right: int) -> "PlanarBox":
        """Return a quarter of the rectangle: front (0) or rear (1), left (0) or right (1)."""
        forward, left = (0.5 - rear) * self.length_m / 2, (0.5 - right) * self.width_m / 2
        cosine, sine = float(np.cos(self.yaw_rad)), float(np.sin(self.yaw_rad))
        x, y = self.x_m + cosine * forward - sine * left, self.y_m + sine * forward + cosine * left
        return PlanarBox(x, y, self.yaw_rad, self.length_m / 2, self.width_m / 2)

    def touches(self, other: "PlanarBox") -> bool:
        """Return whether two rectangles overlap or share a point."""
        reach = np.hypot(self.length_m, self.width_m) + np.hypot(other.length_m, other.width_m)
        if np.hypot(self.x_m - other.x_m, self.y_m - other.y_m) > reach / 2:
            return False
        return bool(self.polygon.intersects(other.polygon))
