"""The ego vehicle as the others see it: one road user more."""

from ..vehicle.body import vehicle_box
from ..vehicle.state import VehicleState
from ..vehicle.vehicle import Vehicle
from .road_user import RoadUser

EGO = "ego"
"""Its id; no other road user is called so."""


def ego_user(vehicle: Vehicle, state: VehicleState) -> RoadUser:
    """Return the ego vehicle as a road user: its body's middle, not the rear axle. Its height is not told."""
    box = vehicle_box(vehicle, state)
    size = vehicle.length_m, vehicle.width_m, vehicle.height_m
    return RoadUser(EGO, "car", size, box.x_m, box.y_m, state.yaw_rad, state.speed_m_s)
