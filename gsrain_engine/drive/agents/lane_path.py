"""The way that an agent means to drive: along its route, back to its middle where it is beside it. World: metres."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ..road.route import Route
from ..vehicle.state import VehicleState
from ..vehicle.vehicle import Vehicle

_SHORTEST_RETURN_M, _RETURN_S = 6.0, 1.5
"""Of the distance from the route 1/e is left after so many metres, or so many seconds: at 10 m/s and 1 m beside it, a
lateral acceleration of 0.4 m/s2, which nobody minds."""


class OnPath(NamedTuple):
    """Where a place is in relation to a path."""

    ahead_m: float
    """Along the route, from the vehicle's rear axle."""
    left_m: float
    """Of the path."""


@dataclass(frozen=True, slots=True, eq=False)
class LanePath:
    """The path of one moment; it starts where the vehicle's rear axle is."""

    state: VehicleState
    route: Route
    along_m: float
    """Of the vehicle on its route."""
    left_m: float
    """Of the vehicle beside its route."""

    @classmethod
    def of(cls, state: VehicleState, route: Route) -> "LanePath":
        on_route = route.nearest(state.x_m, state.y_m)
        return cls(state, route, on_route.along_m, on_route.left_m)

    def points(self, distances_m: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
        """Return the points so far ahead, in the vehicle's frame (x forward, y left); (0, 0) at no distance."""
        start = self.route.at(self.along_m, self.left_m)[:2]
        there = [self.route.at(self.along_m + float(s), self._beside(float(s)))[:2] for s in distances_m]
        # Where a route bends, a place beside it and its nearest point disagree a little: the vehicle stays the start.
        away = np.array(there).reshape(-1, 2) - start + (self.state.x_m, self.state.y_m)
        return self.state.from_world(away)

    def place(self, x_m: float, y_m: float) -> OnPath:
        """Return where a place in the world is in relation to the path."""
        on_route = self.route.nearest(x_m, y_m)
        ahead = on_route.along_m - self.along_m
        return OnPath(ahead, on_route.left_m - self._beside(max(ahead, 0.0)))

    def heading(self, ahead_m: float) -> float:
        """Return the route's heading in the world so far ahead, in radians."""
        return self.route.at(self.along_m + ahead_m)[2]

    def _beside(self, ahead_m: float) -> float:
        reach = max(_SHORTEST_RETURN_M, _RETURN_S * self.state.speed_m_s)
        return self.left_m * float(np.exp(-ahead_m / reach))


def half_corridor_m(vehicle: Vehicle) -> float:
    """Return how far to either side of the path a vehicle needs the road for itself."""
    return vehicle.width_m / 2 + _CLEARANCE_M


_CLEARANCE_M = 0.25
"""Free space that a driver wants beside the car; streets with parked cars leave half a metre."""
