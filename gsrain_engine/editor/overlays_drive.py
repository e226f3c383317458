"""Viewport overlays of drives: boxes, plan, driven path, and detections."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float64
from msgspec import Meta

from ..scene.camera import Camera
from ..scene.geometry import EDGES, box_corners
from ..scene.scene import RigCamera
from ..simulation.rollout import RolloutStep
from ..simulation.traffic.base import RoadUser
from .drive import RolloutInScene
from .viewport.picking import project_lines, project_point

_ABOVE_ROAD_M = 0.04
_DOT_M = 0.16
_MIN_PX, _MAX_PX = 2.0, 10.0
_PIECE_M = 0.5  # lines are split into pieces of this length, so that each is clipped at the near plane


class BoxMark(NamedTuple):
    """Box of a road user."""

    name: str
    lines_px: Float64[np.ndarray, "m 2 2"]
    top_px: tuple[float, float] | None
    """Position of its label; None if not visible."""
    speed_m_s: float
    is_hit: bool
    """True if the ego vehicle touches it now, or if it is the ego vehicle and touches something."""
    is_ego: bool


class PlanDot(NamedTuple):
    """A point of the plan; nearer ones are larger."""

    x: float
    y: float
    radius_px: float


@dataclass(frozen=True, slots=True, eq=False)
class RolloutOverlay:
    """Overlay in image pixels; only the parts in front of the camera."""

    boxes: list[BoxMark]
    plan_px: Float64[np.ndarray, "m 2 2"]
    dots: list[PlanDot]
    driven_px: Float64[np.ndarray, "k 2 2"]


def rollout_overlay(shown: RolloutInScene, clock_s: float, camera: Camera, *, from_inside: bool) -> RolloutOverlay:
    """Project a roll-out at a time; `from_inside` omits the ego vehicle's own box and path."""
    time_s = shown.own_time_s(clock_s)
    played, step = shown.played, shown.played.step(time_s)
    hit = step.collision if time_s >= step.time_s else None
    boxes = [_box(user, camera, is_hit=user.id == hit) for user in played.users(time_s)]
    if not from_inside:
        boxes.append(_box(_ego(shown, time_s), camera, is_hit=hit is not None, is_ego=True))
    plan = planned_points_m(shown, step, time_s)
    driven = _driven(shown, time_s) if not from_inside else np.zeros((0, 3))
    points = [point for place in plan[1:] if (point := project_point(place, camera)) is not None]
    radii_px = [float(np.clip(_DOT_M * camera.fx / each.depth_m, _MIN_PX, _MAX_PX)) for each in points]
    dots = [PlanDot(each.x, each.y, radius_px) for each, radius_px in zip(points, radii_px, strict=True)]
    return RolloutOverlay(boxes, _projected(plan, camera), dots, _projected(driven, camera))


def planned_points_m(shown: RolloutInScene, step: RolloutStep, time_s: float) -> Float64[np.ndarray, "n 3"]:
    """Points of the current plan: the ego vehicle's rear axle first, then the points still ahead of it.

    World, meters, slightly above the road, whose height is taken at the vehicle.
    """
    state = shown.played.state(time_s)
    height = step.ego.z_m + _ABOVE_ROAD_M
    if not step.plan:
        return np.zeros((0, 3))
    points = shown.played.state(step.time_s).to_world(np.array(step.plan))
    ahead = points[state.from_world(points)[:, 0] > 0]
    places = np.concatenate([[(state.x_m, state.y_m)], ahead])
    return np.column_stack([places, np.full(len(places), height)])


def _driven(shown: RolloutInScene, time_s: float) -> Float64[np.ndarray, "n 3"]:
    steps = [each.ego for each in shown.played.rollout.steps if each.time_s < time_s]
    now = shown.played.rig_to_world(time_s)[:3, 3] - (0.0, 0.0, shown.played.rig.height_m)
    places = np.array([*[(ego.x_m, ego.y_m, ego.z_m) for ego in steps], now])
    return places + (0.0, 0.0, _ABOVE_ROAD_M)


def _ego(shown: RolloutInScene, time_s: float) -> RoadUser:
    vehicle, state = shown.scenario.vehicle, shown.played.state(time_s)
    z = float(shown.played.rig_to_world(time_s)[2, 3]) - shown.played.rig.height_m
    size = vehicle.length_m, vehicle.width_m, vehicle.height_m
    axle = RoadUser("ego", "car", size, state.x_m, state.y_m, state.yaw_rad, state.speed_m_s, z)
    return axle.ahead(vehicle.middle_m)


def _box(user: RoadUser, camera: Camera, *, is_hit: bool, is_ego: bool = False) -> BoxMark:
    lines = project_lines(box_corners(user.pose, user.size_lwh)[EDGES], camera)
    top = project_point(user.pose[:3, 3] + (0.0, 0.0, user.size_lwh[2]), camera)
    return BoxMark(user.id, lines, None if top is None else (top.x, top.y), user.speed_m_s, is_hit, is_ego)


def _projected(places: Float64[np.ndarray, "n 3"], camera: Camera) -> Float64[np.ndarray, "m 2 2"]:
    """A line through positions of the world."""
    if len(places) < 2:
        return np.zeros((0, 2, 2))
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    at = np.append(np.arange(0.0, along[-1], _PIECE_M), along[-1])
    fine = np.stack([np.interp(at, along, places[:, axis]) for axis in range(3)], axis=1)
    return project_lines(np.stack([fine[:-1], fine[1:]], axis=1), camera)


# Detections of a camera agent, from the notes of its roll-out

_MIN_CONFIDENCE = 0.25
_Box = tuple[float, float, float, float]


class DetectionBox(NamedTuple):
    """A detection in pixels of the viewport."""

    low_px: tuple[float, float]
    high_px: tuple[float, float]
    words: str
    is_lead: bool
    """True if the agent follows it."""


class _DetectionNote(msgspec.Struct, frozen=True):
    box_xyxy: _Box
    confidence: Annotated[float, Meta(ge=0, le=1)] = 1.0
    class_name: str = msgspec.field(default="", name="class")


class _LeadNote(msgspec.Struct, frozen=True):
    box_xyxy: _Box | None = None
    gap_m: float | None = None


class _AgentNotes(msgspec.Struct, frozen=True):
    detections: tuple[_DetectionNote, ...] = ()
    lead: _LeadNote | None = None


def detection_boxes(step: RolloutStep, front: RigCamera, camera: Camera) -> list[DetectionBox]:
    """Return the detections of a step for a camera at the position of the rig's front camera.

    Empty if the agent noted none, or if its notes have another format.
    """
    try:
        notes = msgspec.convert(step.notes, _AgentNotes)
    except msgspec.ValidationError:
        return []
    found: list[DetectionBox] = []
    for each in notes.detections:
        is_lead = notes.lead is not None and notes.lead.box_xyxy == each.box_xyxy
        if each.confidence < _MIN_CONFIDENCE and not is_lead:
            continue
        x0, y0, x1, y1 = each.box_xyxy
        words = f"{each.class_name} {each.confidence:.2f}".strip()
        if is_lead and notes.lead is not None and notes.lead.gap_m is not None:
            words += f", {notes.lead.gap_m:.1f} m"
        found.append(DetectionBox(_moved(x0, y0, front, camera), _moved(x1, y1, front, camera), words, is_lead))
    return found


def _moved(x: float, y: float, front: RigCamera, camera: Camera) -> tuple[float, float]:
    """Convert a pixel of the rig's camera to one of another camera at the same position."""
    right, down = (x - front.cx) / front.fx, (y - front.cy) / front.fy
    return camera.fx * right + camera.cx, camera.fy * down + camera.cy
