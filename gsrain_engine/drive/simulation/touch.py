"""What the ego vehicle touches at a moment of a drive: a road user, or what stands in the scene."""

from collections.abc import Sequence

import numpy as np

from ..road.ground import Ground
from ..road.occupied_space import OccupiedSpace
from ..road.planar_box import PlanarBox
from ..rollouts.rollout import BACKGROUND
from ..traffic.road_user import RoadUser
from ..vehicle.body import vehicle_box
from ..vehicle.state import VehicleState
from ..vehicle.vehicle import Vehicle


def touched(
    vehicle: Vehicle,
    state: VehicleState,
    users: Sequence[RoadUser],
    ground: Ground,
    occupied: OccupiedSpace,
    since_s: float,
) -> str | None:
    """Return the id of the road user that is hit, "background" for anything else; None while the way is free.

    `since_s` is how long ago it was looked before, 0 at the start: what a fast vehicle has driven through since then is
    hit too. Who is above or below the vehicle is not.
    """
    box = vehicle_box(vehicle, state)
    foot = ground.height_m(box.x_m, box.y_m)
    top = foot + vehicle.height_m
    for user in users:
        is_over_or_under = user.z_m >= top or user.z_m + user.size_lwh[2] <= foot
        closing = state.speed_m_s - user.speed_m_s * float(np.cos(user.yaw_rad - state.yaw_rad))
        if not is_over_or_under and _without_gap(box, closing * since_s).touches(user.box):
            return user.id
    return BACKGROUND if occupied.touches(_without_gap(box, state.speed_m_s * since_s)) else None


def _without_gap(box: PlanarBox, gone_m: float) -> PlanarBox:
    """Return the vehicle's box, so much longer behind that none is left to where it was before a way."""
    more = max(gone_m - box.length_m, 0.0)
    x, y = box.x_m - more / 2 * np.cos(box.yaw_rad), box.y_m - more / 2 * np.sin(box.yaw_rad)
    return PlanarBox(float(x), float(y), box.yaw_rad, box.length_m + more, box.width_m)
