"""The ego vehicle's route: a polyline on the ground by arc length. World frame, meters."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ..scene.scene import Scene
from .ground import recorded_ego_positions


class RouteCoordinates(NamedTuple):
    """Position relative to a route."""

    along_m: float
    """Distance from the route's start to the nearest point; negative before the start, beyond the length after the end.
    """
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
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])


_STEP_M = 0.5  # minimum spacing; closer samples of a recorded drive mostly show noise


def recorded_route(scene: Scene) -> Route:
    """Return the route of the scene's ego vehicle.

    Raises ValueError if the scene has no ego vehicle or it does not move.
    """
    if scene.ego is None:
        raise ValueError(
            f"scene {scene.name!r} has no drive to follow: it has no ego vehicle; let one drive along a camera path "
            "(gsrain convert --drive, in the window Ego drives along the path)"
        )
    kept: list[np.ndarray] = []
    for place in recorded_ego_positions(scene)[:, :2]:
        if not kept or np.linalg.norm(place - kept[-1]) >= _STEP_M:
            kept.append(place)
    if len(kept) < 2:
        raise ValueError(f"scene {scene.name!r} has no drive to follow: its ego vehicle moves less than {_STEP_M} m")
    return Route(np.array(kept))
