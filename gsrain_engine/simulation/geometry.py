"""Plane geometry: wrapped angles, and rectangles and routes on the ground. World frame, meters."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeVar

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
        lengths = self.length_m, self.width_m
        along, across = (np.linspace(-side / 2, side / 2, int(np.ceil(side / step_m)) + 1) for side in lengths)
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


def arc_lengths(points: Float64[np.ndarray, "n d"]) -> Float64[np.ndarray, " n"]:
    """Return the distance of each point of a polyline from its first, along it."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def points_along(
    points: Float64[np.ndarray, "n d"], along_m: Float64[np.ndarray, " n"], at_m: Float64[np.ndarray, " m"]
) -> Float64[np.ndarray, "m d"]:
    """Return points of a polyline at distances from its first; `along_m` are those of its own points."""
    return np.stack([np.interp(at_m, along_m, column) for column in points.T], axis=1)


class RouteCoordinates(NamedTuple):
    """Position relative to a route."""

    along_m: float
    """Distance of the nearest point from the start; negative before it, beyond the length after the end."""
    left_m: float
    """Distance from the route, left positive."""


@dataclass(frozen=True, eq=False)
class Route:
    """A polyline of at least two distinct points, extended straight at both ends."""

    points: Float64[np.ndarray, "n 2"]

    @property
    def length_m(self) -> float:
        return float(self._along[-1])

    def at(self, along_m: float, left_m: float = 0.0) -> tuple[float, float, float]:
        """Return x, y and heading at a distance from the start, offset to the left."""
        i = int(np.clip(np.searchsorted(self._along, along_m, side="right") - 1, 0, len(self.points) - 2))
        step = self.points[i + 1] - self.points[i]
        forward = step / np.linalg.norm(step)
        x, y = self.points[i] + (along_m - self._along[i]) * forward + left_m * np.array([-forward[1], forward[0]])
        return float(x), float(y), float(np.arctan2(forward[1], forward[0]))

    def nearest(self, x_m: float, y_m: float) -> RouteCoordinates:
        place = np.array([x_m, y_m])
        steps = np.diff(self.points, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        forward = steps / lengths[:, None]
        reach = np.einsum("nd,nd->n", place - self.points[:-1], forward)
        low, high = np.zeros(len(steps)), lengths.copy()
        low[0], high[-1] = -np.inf, np.inf
        reach = np.clip(reach, low, high)
        away = place - (self.points[:-1] + reach[:, None] * forward)
        i = int(np.argmin(np.einsum("nd,nd->n", away, away)))
        left = forward[i, 0] * away[i, 1] - forward[i, 1] * away[i, 0]
        distance = float(np.linalg.norm(away[i]))
        return RouteCoordinates(float(self._along[i] + reach[i]), distance if left >= 0 else -distance)

    def ahead(self, along_m: float, reach_m: float, step_m: float = 1.0) -> Float64[np.ndarray, "m 2"]:
        """Return evenly spaced points from a distance on."""
        return np.array([self.at(along_m + s)[:2] for s in np.arange(0.0, reach_m + step_m / 2, step_m)])

    @cached_property
    def _along(self) -> Float64[np.ndarray, " n"]:
        return arc_lengths(self.points)
