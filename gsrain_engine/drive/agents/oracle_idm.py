"""A driver that knows where everybody is: what is lost against it, perception has lost."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..traffic.road_user import RoadUser
from ..vehicle.vehicle import Vehicle
from .agent import Needs, Plan
from .idm_planner import IDMPlanner, cruise_speed
from .lane_path import LanePath, half_corridor_m
from .leads.lead import Lead
from .observation import Observation, Rig

_FORESIGHT_S = 1.5
"""Who will be in the lane so soon, going on sideways as now, counts as there: a lane change takes twice as long."""


class OracleIDMAgent:
    """Follows its lane by the intelligent driver model, with the simulator's own knowledge of all road users."""

    name = "oracle-idm"
    needs = Needs()

    def __init__(self) -> None:
        self._planner: IDMPlanner | None = None
        self._vehicle = Vehicle()

    def reset(self, seed: int, rig: Rig) -> None:
        self._planner, self._vehicle = None, rig.vehicle

    def plan(self, observation: Observation) -> Plan:
        """Return points along the route, behind whoever is ahead in the lane."""
        if self._planner is None:
            cruise = cruise_speed(observation.state.speed_m_s)
            self._planner = IDMPlanner(cruise, hard_m_s2=self._vehicle.most_braking_m_s2)
        path = LanePath.of(observation.state, observation.route)
        known = known_lead(observation.road_users, path, self._vehicle)
        points = self._planner.points(path, known and known.lead)
        if known is None:
            return Plan(points, {"lead": None})
        return Plan(points, {"lead": {"id": known.id, "gap_m": known.lead.gap_m, "speed_m_s": known.lead.speed_m_s}})

    def close(self) -> None:
        """Nothing is held."""


class KnownLead(NamedTuple):
    """Who is ahead in the lane."""

    id: str
    lead: Lead


def known_lead(users: Sequence[RoadUser], path: LanePath, vehicle: Vehicle) -> KnownLead | None:
    """Return the nearest road user ahead that is in the vehicle's lane, or moves into it; none where the lane is free.

    Also the truth that a camera's lead is compared with.
    """
    found = [KnownLead(user.id, lead) for user in users if (lead := _as_lead(user, path, vehicle)) is not None]
    return min(found, key=lambda each: each.lead.gap_m, default=None)


def _as_lead(user: RoadUser, path: LanePath, vehicle: Vehicle) -> Lead | None:
    corners = [path.place(float(x), float(y)) for x, y in user.box.corners]
    middle = path.place(user.x_m, user.y_m)
    if middle.ahead_m < vehicle.middle_m or max(each.ahead_m for each in corners) < vehicle.front_m:
        return None
    turned = user.yaw_rad - path.heading(middle.ahead_m)
    half, sideways = half_corridor_m(vehicle), user.speed_m_s * float(np.sin(turned)) * _FORESIGHT_S
    low, high = min(each.left_m for each in corners), max(each.left_m for each in corners)
    if low + min(sideways, 0.0) > half or high + max(sideways, 0.0) < -half:
        return None
    gap = min(each.ahead_m for each in corners) - vehicle.front_m
    return Lead(gap, user.speed_m_s * float(np.cos(turned)))
