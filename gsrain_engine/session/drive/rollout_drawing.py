"""A roll-out as lines in the picture: everybody's box, the plan on the road, the way that was driven."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from gsrain_engine.drive.rollouts.rollout import RolloutStep
from gsrain_engine.drive.traffic.road_user import RoadUser
from gsrain_engine.scene.box_corners import EDGES, box_corners
from gsrain_engine.scene.camera import Camera

from ..view.projection import projected_lines, projected_point
from .shown_rollout import ShownRollout

_ABOVE_ROAD_M = 0.04
_DOT_M = 0.16
_LEAST_PX, _MOST_PX = 2.0, 10.0
_PIECE_M = 0.5
"""Lines are cut into pieces, so that each is cut off where it leaves the picture behind the eye."""


class BoxMark(NamedTuple):
    """Somebody's box."""

    name: str
    lines_px: Float64[np.ndarray, "m 2 2"]
    top_px: tuple[float, float] | None
    """Where its name stands; None where that is not seen."""
    speed_m_s: float
    is_hit: bool
    """Whether the ego vehicle touches it now, or it is the ego vehicle that touches something."""
    is_ego: bool


class Dot(NamedTuple):
    """A planned point; nearer ones are larger."""

    x: float
    y: float
    radius_px: float


@dataclass(frozen=True, slots=True, eq=False)
class RolloutDrawing:
    """Pixels of the picture; only what is in front of the camera."""

    boxes: list[BoxMark]
    plan_px: Float64[np.ndarray, "m 2 2"]
    dots: list[Dot]
    driven_px: Float64[np.ndarray, "k 2 2"]


def rollout_drawing(shown: ShownRollout, clock_s: float, camera: Camera, *, from_inside: bool) -> RolloutDrawing:
    """Project a moment of a roll-out; `from_inside` leaves out the ego vehicle's own box and way."""
    time_s = shown.own_time_s(clock_s)
    played, step = shown.played, shown.played.step(time_s)
    hit = step.collision if time_s >= step.time_s else None
    boxes = [_box(user, camera, is_hit=user.id == hit) for user in played.users(time_s)]
    if not from_inside:
        boxes.append(_box(_ego(shown, time_s), camera, is_hit=hit is not None, is_ego=True))
    plan = planned_places(shown, step, time_s)
    driven = _driven(shown, time_s) if not from_inside else np.zeros((0, 3))
    dots = [dot for place in plan[1:] if (dot := _dot(place, camera)) is not None]
    return RolloutDrawing(boxes, _projected(plan, camera), dots, _projected(driven, camera))


def planned_places(shown: ShownRollout, step: RolloutStep, time_s: float) -> Float64[np.ndarray, "n 3"]:
    """Where the plan that is followed now leads: the ego vehicle's rear axle first, then what is still ahead of it.

    World, metres, a little above the road, which is taken as high as where the vehicle is.
    """
    state = shown.played.state(time_s)
    height = step.ego.z_m + _ABOVE_ROAD_M
    if not step.plan:
        return np.zeros((0, 3))
    points = shown.played.state(step.time_s).to_world(np.array(step.plan))
    ahead = points[state.from_world(points)[:, 0] > 0]
    places = np.concatenate([[(state.x_m, state.y_m)], ahead])
    return np.column_stack([places, np.full(len(places), height)])


def _driven(shown: ShownRollout, time_s: float) -> Float64[np.ndarray, "n 3"]:
    steps = [each.ego for each in shown.played.rollout.steps if each.time_s < time_s]
    now = shown.played.rig_to_world(time_s)[:3, 3] - (0.0, 0.0, shown.played.rig.height_m)
    places = np.array([*[(ego.x_m, ego.y_m, ego.z_m) for ego in steps], now])
    return places + (0.0, 0.0, _ABOVE_ROAD_M)


def _ego(shown: ShownRollout, time_s: float) -> RoadUser:
    vehicle, state = shown.scenario.vehicle, shown.played.state(time_s)
    z = float(shown.played.rig_to_world(time_s)[2, 3]) - shown.played.rig.height_m
    size = vehicle.length_m, vehicle.width_m, vehicle.height_m
    axle = RoadUser("ego", "car", size, state.x_m, state.y_m, state.yaw_rad, state.speed_m_s, z)
    return axle.ahead(vehicle.middle_m)


def _box(user: RoadUser, camera: Camera, *, is_hit: bool, is_ego: bool = False) -> BoxMark:
    lines = projected_lines(box_corners(user.pose, user.size_lwh)[EDGES], camera)
    top = projected_point(user.pose[:3, 3] + (0.0, 0.0, user.size_lwh[2]), camera)
    return BoxMark(user.id, lines, None if top is None else (top.x, top.y), user.speed_m_s, is_hit, is_ego)


def _projected(places: Float64[np.ndarray, "n 3"], camera: Camera) -> Float64[np.ndarray, "m 2 2"]:
    """A line through places of the world."""
    if len(places) < 2:
        return np.zeros((0, 2, 2))
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    at = np.append(np.arange(0.0, along[-1], _PIECE_M), along[-1])
    fine = np.stack([np.interp(at, along, places[:, axis]) for axis in range(3)], axis=1)
    return projected_lines(np.stack([fine[:-1], fine[1:]], axis=1), camera)


def _dot(place: Float64[np.ndarray, "3"], camera: Camera) -> Dot | None:
    seen = projected_point(place, camera)
    if seen is None:
        return None
    return Dot(seen.x, seen.y, float(np.clip(_DOT_M * camera.fx / seen.depth_m, _LEAST_PX, _MOST_PX)))
