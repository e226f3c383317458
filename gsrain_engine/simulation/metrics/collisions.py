"""Collision metrics: executed collisions, planned collisions, and time to collision."""

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Literal, NamedTuple

import numpy as np
import shapely
from jaxtyping import Float64

from ..geometry import PlanarBox, wrap_angle
from ..obstacles import OccupiedSpace
from ..rollout import Rollout, RolloutStep
from ..vehicle import Vehicle, VehicleState, vehicle_box


class Collision(NamedTuple):
    """The first collision of a run. Times count from the start of the scenario."""

    who: str  # id of the road user, or "background"
    time_s: float
    speed_m_s: float  # ego speed at the first step with contact
    closing_speed_m_s: float
    """Closing speed along the ego heading: less than the ego speed if the other drives on ahead."""


def first_collision(rollout: Rollout) -> Collision | None:
    """Return the first contact of the ego box with another box or the background; None without one.

    Boxes are those of the simulation, tested at every step, so that times are multiples of the step.
    """
    for step in rollout.steps:
        if step.collision is not None:
            others = [each for each in step.road_users if each.id == step.collision]
            away = sum(each.speed_m_s * float(np.cos(each.yaw_rad - step.ego.yaw_rad)) for each in others)
            return Collision(step.collision, step.time_s, step.ego.speed_m_s, step.ego.speed_m_s - away)
    return None


# Planned collisions: the paper's rate by planned point, and HUGSIM's by frame


class PlannedCollisions(NamedTuple):
    """c_ij of a run: for each frame and planned point, whether it collides."""

    frames: tuple[tuple[bool, ...], ...]

    @property
    def points_per_frame(self) -> int:
        """N of the paper: the maximum if plans differ in length, 0 without plans."""
        return max((len(each) for each in self.frames), default=0)

    @property
    def point_rate(self) -> float | None:
        """C of the paper, 1/(F N) sum_i sum_j c_ij: share of planned points that collide. None without a point."""
        return _share([point for frame in self.frames for point in frame])

    @property
    def frame_rate(self) -> float | None:
        """The share of frames with any point that collides; 1 - mean(nc) of HUGSIM. None without a frame."""
        return _share([any(frame) for frame in self.frames if frame])


def _share(hits: list[bool]) -> float | None:
    return sum(hits) / len(hits) if hits else None


PlanReading = Literal["all", "hugsim"]
"""Points of a plan that count. `all`: all of them; the last has the heading of the segment before it. `hugsim`: all
but the last, which has no next point for its heading: UniAD's six points become five, the paper's N."""


def planned_collisions(
    rollout: Rollout, occupied: OccupiedSpace | None = None, reading: PlanReading = "all"
) -> PlannedCollisions:
    """Test the vehicle's box at every planned point for collisions.

    Point j of a frame is tested against the actual places of the road users (j + 1) spacings later; after the end of
    the run against their last places. `occupied` adds the background; without it only road users count.
    Sources: the paper's equation of C and its c_ij; futures after HUGSIM's `score_calculator`, see `future_times_s`.
    """
    vehicle, traffic = rollout.vehicle, LoggedTraffic(rollout)
    frames: list[tuple[bool, ...]] = []
    for step in rollout.planned_frames:
        poses = planned_poses(step, reading)
        times = future_times_s(rollout, step, len(poses), reading)
        frames.append(tuple(pose_hits(vehicle, poses, times, traffic, occupied)))
    return PlannedCollisions(tuple(frames))


def future_times_s(rollout: Rollout, step: RolloutStep, count: int, reading: PlanReading) -> Float64[np.ndarray, " n"]:
    """Return the times of a plan's points at which road users are looked up.

    HUGSIM reads the log in steps of the plan's spacing and beyond the end uses the last step that it read, up to one
    spacing before the end of the run; `all` uses the end itself.
    """
    times = step.time_s + rollout.spacing_s * np.arange(1, count + 1)
    if reading == "hugsim":
        left = rollout.steps[-1].time_s - step.time_s
        times = np.minimum(times, step.time_s + rollout.spacing_s * np.floor(left / rollout.spacing_s + 1e-6))
    return times


_SAME_S = 1e-6


class LoggedTraffic:
    """Boxes of the road users at any time of a roll-out."""

    def __init__(self, rollout: Rollout) -> None:
        self._rollout, self._times = rollout, np.array([each.time_s for each in rollout.steps])
        self._boxes = cache(self._looked_up)

    def at(self, time_s: float) -> tuple[PlanarBox, ...]:
        """Return the boxes at a time, interpolated between steps and constant after the last.

        HUGSIM looks up futures in the same way (its steps of 0.25 s match the 0.5 s of a plan), with the last step for
        times beyond the end of the run.
        """
        return self._boxes(round(float(np.clip(time_s, self._times[0], self._times[-1])), 9))

    def _looked_up(self, time_s: float) -> tuple[PlanarBox, ...]:
        steps = self._rollout.steps
        later = min(int(np.searchsorted(self._times, time_s - _SAME_S)), len(self._times) - 1)
        if abs(self._times[later] - time_s) <= _SAME_S or later == 0:
            return self._rollout.boxes(steps[later])
        share = float((time_s - self._times[later - 1]) / (self._times[later] - self._times[later - 1]))
        after = dict(zip((each.id for each in steps[later].road_users), self._rollout.boxes(steps[later]), strict=True))
        boxes: list[PlanarBox] = []
        for user, each in zip(steps[later - 1].road_users, self._rollout.boxes(steps[later - 1]), strict=True):
            if (then := after.get(user.id)) is not None:
                x, y = each.x_m + share * (then.x_m - each.x_m), each.y_m + share * (then.y_m - each.y_m)
                yaw = each.yaw_rad + share * wrap_angle(then.yaw_rad - each.yaw_rad)
                boxes.append(PlanarBox(x, y, yaw, each.length_m, each.width_m))
        return tuple(boxes)


def pose_hits(
    vehicle: Vehicle,
    poses: Float64[np.ndarray, "n 3"],
    times_s: Sequence[float] | Float64[np.ndarray, " n"],
    traffic: LoggedTraffic,
    occupied: OccupiedSpace | None,
) -> Iterator[bool]:
    """Yield, for each rear-axle pose and time, whether the vehicle hits a road user or the background."""
    for pose, time_s in zip(poses, times_s, strict=True):
        box = ego_box(vehicle, pose)
        touched = any(box.touches(other) for other in traffic.at(float(time_s)))
        yield touched or (occupied is not None and occupied.touches(box))


STANDING_M = 1.0
"""If a plan ends nearer than this to the vehicle, all its points have the vehicle's heading (HUGSIM's scorer)."""

_APART_M = 0.01  # minimum distance between points that define a direction


def ego_box(vehicle: Vehicle, pose: Float64[np.ndarray, "3"]) -> PlanarBox:
    """Return the vehicle's bounding box for a rear-axle pose."""
    return vehicle_box(vehicle, VehicleState(*(float(each) for each in pose)))


def planned_poses(step: RolloutStep, reading: PlanReading = "all") -> Float64[np.ndarray, "n 3"]:
    """Return x, y and heading of the rear axle at each planned point; n is 0 without a plan.

    A point's heading is the direction to the next point, HUGSIM's finite difference. With `hugsim`, coincident points
    have world heading 0, as in HUGSIM; with `all`, they keep the previous heading. The rule for standing plans
    (`STANDING_M`) applies to both.
    """
    start = step.ego
    points = start.state.to_world(np.array(step.plan, np.float64).reshape(-1, 2))
    steps = np.diff(points, axis=0)
    if reading == "hugsim":
        poses = np.column_stack([points[:-1], np.arctan2(steps[:, 1], steps[:, 0])])
    else:
        last = steps[-1:] if len(steps) else np.zeros_like(points)
        heading, headings = start.yaw_rad, list[float]()
        for step_m in (*steps, *last):
            if np.linalg.norm(step_m) >= _APART_M:
                heading = float(np.arctan2(step_m[1], step_m[0]))
            headings.append(heading)
        poses = np.column_stack([points, np.array(headings)])
    if len(poses) and np.linalg.norm(poses[-1, :2] - (start.x_m, start.y_m)) < STANDING_M:
        poses[:, 2] = start.yaw_rad
    return poses


def with_start(step: RolloutStep, poses: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n+1 3"]:
    """Return the vehicle's current pose followed by the planned poses."""
    return np.concatenate([[(step.ego.x_m, step.ego.y_m, step.ego.yaw_rad)], poses])


# Time to collision and gaps: the paper's TTC at every step

LONGEST_S = 10.0
"""Upper limit of the time to collision: the paper's "no collision risk"."""

Distance = Literal["bumper", "center"]
"""d_x of the paper, which does not define it. `bumper`: from the front bumper to the nearest part of the other vehicle
in the lane; `center`: between centers along the heading."""

_LANE_M = 1000.0


class RoadUserAhead(NamedTuple):
    """A road user in the ego vehicle's swept lane; distances and speed are along the ego heading."""

    gap_m: float
    """Gap from the front bumper to its nearest part within the swept lane; 0 if they overlap."""
    center_m: float
    speed_m_s: float
    """Negative when oncoming."""


def road_users_ahead(rollout: Rollout, step: RolloutStep, vehicle: Vehicle) -> list[RoadUserAhead]:
    """Return the road users in the ego vehicle's swept lane and not behind it.

    The swept lane is straight, along the heading, and as wide as the vehicle. Road users next to it do not count; those
    that overlap the vehicle's box do, with a gap of 0.
    """
    own = vehicle_box(vehicle, step.ego.state)
    lane = shapely.box(-vehicle.length_m / 2, -vehicle.width_m / 2, _LANE_M, vehicle.width_m / 2)
    cosine, sine = np.cos(own.yaw_rad), np.sin(own.yaw_rad)
    leads: list[RoadUserAhead] = []
    for record, box in zip(step.road_users, rollout.boxes(step), strict=True):
        away = np.array([box.x_m - own.x_m, box.y_m - own.y_m])
        x, y = float(away @ (cosine, sine)), float(away @ (-sine, cosine))
        local = PlanarBox(x, y, box.yaw_rad - own.yaw_rad, box.length_m, box.width_m)
        within = lane.intersection(local.polygon)
        if within.is_empty or within.area == 0:
            continue
        gap = max(float(within.bounds[0]) - vehicle.length_m / 2, 0.0)
        along = record.speed_m_s * float(np.cos(record.yaw_rad - step.ego.yaw_rad))
        leads.append(RoadUserAhead(gap, x, along))
    return leads


def gaps_m(rollout: Rollout) -> Float64[np.ndarray, " n"]:
    """Return the bumper gap to the nearest road user ahead at every step, meters; infinite without one."""
    vehicle = rollout.vehicle
    leads = [road_users_ahead(rollout, step, vehicle) for step in rollout.steps]
    return np.array([min((each.gap_m for each in ahead), default=np.inf) for ahead in leads])


def times_to_collision_s(rollout: Rollout, distance: Distance = "bumper") -> Float64[np.ndarray, " n"]:
    """Return the time to collision at every step, seconds, 0..10.

    TTC = min(d_x / (v_SUT - v_BV), 10), the minimum over road users ahead (paper, equation of TTC); v_BV is the other's
    speed along the ego heading. It is 10 if nobody ahead is slower, and 0 on overlap or any collision. The background
    counts only when it is hit.
    """
    vehicle = rollout.vehicle
    times: list[float] = []
    for step in rollout.steps:
        leads, soonest = road_users_ahead(rollout, step, vehicle), LONGEST_S
        for lead in leads:
            closing = step.ego.speed_m_s - lead.speed_m_s
            if closing > 0:
                soonest = min(soonest, max(lead.gap_m if distance == "bumper" else lead.center_m, 0.0) / closing)
        touches = step.collision is not None or any(lead.gap_m <= 0 for lead in leads)
        times.append(0.0 if touches else soonest)
    return np.array(times)
