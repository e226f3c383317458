"""Time to collision with who is ahead, and the gap to it, at every moment of a run (the paper's TTC)."""

from typing import Literal, NamedTuple

import numpy as np
import shapely
from jaxtyping import Float64

from ..road.planar_box import PlanarBox
from ..rollouts.rollout import Rollout, RolloutStep
from ..rollouts.run_setting import run_setting
from ..vehicle.vehicle import Vehicle
from .logged_traffic import user_boxes
from .planned_poses import ego_box, ego_pose

LONGEST_S = 10.0
"""No time to collision is longer: the paper's "no collision risk"."""
Distance = Literal["bumper", "center"]
"""d_x of the paper, which does not define it. `bumper`: from the front bumper to the nearest part of the other that
lies in the lane; `center`: from middle to middle, along the heading."""

_LANE_M = 1000.0


class LeadAhead(NamedTuple):
    """Somebody in the way, from the ego vehicle."""

    gap_m: float
    """From the front bumper to its nearest part within the swept lane; 0 or less where they overlap."""
    center_m: float
    """From middle to middle along the ego vehicle's heading."""
    speed_m_s: float
    """Its speed along the ego vehicle's heading; below 0 it comes towards it."""


def leads_ahead(rollout: Rollout, step: RolloutStep, vehicle: Vehicle) -> list[LeadAhead]:
    """Return who is in the ego vehicle's way at a moment, and not behind it.

    The way is the lane that the vehicle would sweep straight on: as wide as itself, along its heading. Who is beside it
    is not in the way; who overlaps the vehicle's box is, with a gap of 0.
    """
    own = ego_box(vehicle, ego_pose(step.ego))
    lane = shapely.box(-vehicle.length_m / 2, -vehicle.width_m / 2, _LANE_M, vehicle.width_m / 2)
    leads: list[LeadAhead] = []
    for record, box in zip(step.road_users, user_boxes(step.road_users, rollout.users), strict=True):
        seen = _seen_from(own, box)
        within = lane.intersection(seen.polygon)
        if within.is_empty or within.area == 0:
            continue
        gap = max(float(within.bounds[0]) - vehicle.length_m / 2, 0.0)
        along = record.speed_m_s * float(np.cos(record.yaw_rad - step.ego.yaw_rad))
        leads.append(LeadAhead(gap, seen.x_m, along))
    return leads


def gaps_m(rollout: Rollout) -> Float64[np.ndarray, " n"]:
    """Return the bumper gap to the nearest who is ahead at every moment, metres; infinite where nobody is."""
    vehicle = run_setting(rollout).vehicle
    leads = [leads_ahead(rollout, step, vehicle) for step in rollout.steps]
    return np.array([min((each.gap_m for each in ahead), default=np.inf) for ahead in leads])


def times_to_collision_s(rollout: Rollout, distance: Distance = "bumper") -> Float64[np.ndarray, " n"]:
    """Return the time to collision at every moment, seconds, 0..10.

    TTC = min(d_x / (v_SUT - v_BV), 10), the least over who is ahead (paper, equation of TTC); v_BV is the other's speed
    along the ego vehicle's heading. It is 10 where nobody is ahead or the other is not slower, and 0 where they overlap
    or where anything was hit. The background counts only when it is hit.
    """
    vehicle = run_setting(rollout).vehicle
    return np.array([_time_s(step, leads_ahead(rollout, step, vehicle), distance) for step in rollout.steps])


def _time_s(step: RolloutStep, leads: list[LeadAhead], distance: Distance) -> float:
    if step.collision is not None or any(lead.gap_m <= 0 for lead in leads):
        return 0.0
    times = [LONGEST_S]
    for lead in leads:
        closing = step.ego.speed_m_s - lead.speed_m_s
        if closing > 0:
            times.append(max(lead.gap_m if distance == "bumper" else lead.center_m, 0.0) / closing)
    return min(times)


def _seen_from(own: PlanarBox, other: PlanarBox) -> PlanarBox:
    """Return a box in the frame of another (x forward, y left, around its middle)."""
    away = np.array([other.x_m - own.x_m, other.y_m - own.y_m])
    cosine, sine = np.cos(own.yaw_rad), np.sin(own.yaw_rad)
    x, y = float(away @ (cosine, sine)), float(away @ (-sine, cosine))
    return PlanarBox(x, y, other.yaw_rad - own.yaw_rad, other.length_m, other.width_m)
