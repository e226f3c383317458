"""Where the ego vehicle's body is, which its states do not say: they are those of its rear axle."""

import numpy as np

from ..road.planar_box import PlanarBox
from .state import VehicleState
from .vehicle import Vehicle


def vehicle_box(vehicle: Vehicle, state: VehicleState) -> PlanarBox:
    """Return the box on the ground that a vehicle takes up. World frame, metres."""
    x = state.x_m + vehicle.middle_m * np.cos(state.yaw_rad)
    y = state.y_m + vehicle.middle_m * np.sin(state.yaw_rad)
    return PlanarBox(float(x), float(y), state.yaw_rad, vehicle.length_m, vehicle.width_m)
