"""Pure pursuit: steer for a point ahead on the plan, and take the speed that the plan has."""

import numpy as np
from jaxtyping import Float64

from .state import Control, VehicleState
from .vehicle import Vehicle

_SHORTEST_M, _AHEAD_S = 4.0, 1.0
"""The point that is steered for is so far ahead, or so many seconds at the present speed."""
_SETTLE_S = 0.5
"""Time in which the steering is to reach what it should be."""
_SPEED_POINTS = 2
"""The acceleration is the one that leads to the plan's second point: one second ahead, so that noise matters less."""


class PurePursuit:
    """Steers along the arc through the rear axle and a point ahead on the plan (Coulter 1992)."""

    def reset(self) -> None:
        """Forget nothing: there is nothing that it remembers."""

    def control(
        self, vehicle: Vehicle, state: VehicleState, plan: Float64[np.ndarray, "n 2"], spacing_s: float
    ) -> Control:
        points = np.concatenate([np.zeros((1, 2)), plan])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        point = min(_SPEED_POINTS, len(plan))
        time_s = point * spacing_s
        acceleration = 2 * (float(along[point]) - state.speed_m_s * time_s) / time_s**2
        reach = max(_SHORTEST_M, _AHEAD_S * state.speed_m_s)
        ahead = np.array([np.interp(reach, along, points[:, axis]) for axis in range(2)])
        distance2 = float(ahead @ ahead)
        curvature = 2 * float(ahead[1]) / distance2 if distance2 > 0.25 else 0.0
        steer = float(np.arctan(vehicle.wheelbase_m * curvature))
        return Control(acceleration, (steer - state.steer_rad) / _SETTLE_S)
