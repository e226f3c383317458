"""Where a plan wants the vehicle to be, with headings. World frame: metres, radians."""

from typing import Literal

import numpy as np
from jaxtyping import Float64

from ..road.planar_box import PlanarBox
from ..rollouts.rollout import EgoRecord, RolloutStep
from ..vehicle.body import vehicle_box
from ..vehicle.state import VehicleState
from ..vehicle.vehicle import Vehicle

PlanReading = Literal["all", "hugsim"]
"""Which points of a plan count. `all`: all of them; the last has the heading with which it is reached. `hugsim`: all
but the last, which has no next point to take its heading from: UniAD's six points become five, the paper's N."""

STANDING_M = 1.0
"""A plan that ends nearer than this to the vehicle has the vehicle's heading throughout (HUGSIM's scorer)."""
_APART_M = 0.01
"""Points nearer than this to each other have no direction."""


def ego_pose(ego: EgoRecord) -> Float64[np.ndarray, "3"]:
    """Return x, y and heading of the rear axle at a moment."""
    return np.array([ego.x_m, ego.y_m, ego.yaw_rad])


def ego_box(vehicle: Vehicle, pose: Float64[np.ndarray, "3"]) -> PlanarBox:
    """Return the box on the ground that the vehicle takes up with its rear axle at a pose."""
    return vehicle_box(vehicle, VehicleState(*(float(each) for each in pose)))


def planned_poses(step: RolloutStep, reading: PlanReading = "all") -> Float64[np.ndarray, "n 3"]:
    """Return x, y and heading of the rear axle at each planned point; n is 0 where there is no plan.

    A point's heading is the direction to the next point, which is HUGSIM's finite difference. Under `hugsim` two points
    in one place have heading 0 in the world, as there; under `all` they keep the heading before. The rule for plans
    that stand (`STANDING_M`) holds in both.
    """
    start = ego_pose(step.ego)
    points = VehicleState(*start).to_world(np.array(step.plan, np.float64).reshape(-1, 2))
    poses = _with_next_direction(points) if reading == "hugsim" else _with_directions(points, float(start[2]))
    if len(poses) and np.linalg.norm(poses[-1, :2] - start[:2]) < STANDING_M:
        poses[:, 2] = start[2]
    return poses


def with_start(step: RolloutStep, poses: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n+1 3"]:
    """Return planned poses after the pose of the vehicle itself."""
    return np.concatenate([ego_pose(step.ego)[None], poses])


def _with_next_direction(points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "m 3"]:
    if len(points) < 2:
        return np.zeros((0, 3))
    steps = np.diff(points, axis=0)
    return np.column_stack([points[:-1], np.arctan2(steps[:, 1], steps[:, 0])])


def _with_directions(points: Float64[np.ndarray, "n 2"], yaw_rad: float) -> Float64[np.ndarray, "n 3"]:
    headings: list[float] = []
    for index in range(len(points)):
        i = min(index, len(points) - 2)
        step = points[i + 1] - points[i] if len(points) > 1 else np.zeros(2)
        if np.linalg.norm(step) >= _APART_M:
            yaw_rad = float(np.arctan2(step[1], step[0]))
        headings.append(yaw_rad)
    return np.column_stack([points, np.array(headings)]) if len(points) else np.zeros((0, 3))
