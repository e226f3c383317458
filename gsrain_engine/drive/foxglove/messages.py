"""Moments of a roll-out as Foxglove messages: poses, boxes, planned points, numbers, pictures. World: metres, z up."""

import base64
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64, UInt8
from scipy.spatial.transform import Rotation

from gsrain_engine.scene.camera import Camera

from ..rollouts.rollout import EgoRecord, RolloutStep, UserModel, UserRecord
from ..vehicle.state import VehicleState
from ..vehicle.vehicle import Vehicle

Message = dict[str, Any]

WORLD, EGO = "world", "ego"
"""Frames: the scene's world, and the ego vehicle's (x forward, y left, z up, origin below its rear axle)."""
INFORMATION, ERROR = 2, 4
"""Levels of a log message."""
_JPEG_QUALITY = 90
_ABOVE_GROUND_M = 0.05
_EGO_COLOR, _USER_COLOR = (0.12, 0.45, 0.75, 0.55), (0.85, 0.55, 0.2, 0.75)
_HIT_COLOR, _PLAN_COLOR, _ROUTE_COLOR = (0.86, 0.12, 0.15, 0.9), (0.15, 0.75, 0.35, 1.0), (0.6, 0.64, 0.68, 0.8)


def stamp(time_s: float) -> Message:
    """Return a time since the scenario began as seconds and nanoseconds."""
    seconds, nanoseconds = divmod(nanoseconds_of(time_s), 1_000_000_000)
    return {"sec": seconds, "nsec": nanoseconds}


def nanoseconds_of(time_s: float) -> int:
    return round(time_s * 1e9)


def ego_transform(step: RolloutStep) -> Message:
    """Return where the ego vehicle's frame is."""
    ego = step.ego
    return {
        "timestamp": stamp(step.time_s), "parent_frame_id": WORLD, "child_frame_id": EGO,
        "translation": _vector(ego.x_m, ego.y_m, ego.z_m), "rotation": _turn(ego.yaw_rad),
    }  # fmt: skip


def ego_pose_in_world(step: RolloutStep) -> Message:
    """Return the ego vehicle's pose."""
    return {"timestamp": stamp(step.time_s), "frame_id": WORLD, "pose": _pose(step.ego)}


def ego_box_update(step: RolloutStep, vehicle: Vehicle) -> Message:
    """Return the ego vehicle's box; red where it has hit something."""
    position = _vector(vehicle.middle_m, 0.0, vehicle.height_m / 2)
    cube = {
        "pose": {"position": position, "orientation": _turn(0.0)},
        "size": _vector(vehicle.length_m, vehicle.width_m, vehicle.height_m),
        "color": _color(_EGO_COLOR if step.collision is None else _HIT_COLOR),
    }
    return _update(_entity(step, EGO, EGO, cubes=[cube]))


def road_users_update(step: RolloutStep, users: dict[str, UserModel], gone: Sequence[str]) -> Message:
    """Return the boxes and names of the road users; `gone` are those who are there no more."""
    entities = [_road_user(step, user, users[user.id]) for user in step.road_users]
    deletions = [{"timestamp": stamp(step.time_s), "type": 0, "id": name} for name in gone]
    return {"deletions": deletions, "entities": entities}


def plan_update(step: RolloutStep) -> Message:
    """Return the planned points as dots on a line, just above the ground; without a plan what was drawn is deleted."""
    if not step.plan:
        return {"deletions": [{"timestamp": stamp(step.time_s), "type": 0, "id": "plan"}], "entities": []}
    state = VehicleState(step.ego.x_m, step.ego.y_m, step.ego.yaw_rad)
    places = state.to_world(np.array(step.plan, np.float64))
    height = step.ego.z_m + _ABOVE_GROUND_M
    points = [_vector(float(x), float(y), height) for x, y in places]
    dots = [
        {"pose": {"position": point, "orientation": _turn(0.0)}, "size": _vector(0.4, 0.4, 0.4),
         "color": _color(_PLAN_COLOR)}
        for point in points
    ]  # fmt: skip
    start = _vector(step.ego.x_m, step.ego.y_m, height)
    return _update(_entity(step, "plan", WORLD, spheres=dots, lines=[_line([start, *points], 0.12, _PLAN_COLOR)]))


def route_update(step: RolloutStep, points: Float64[np.ndarray, "n 2"]) -> Message:
    """Return the way to take, at the height of the ground below the vehicle."""
    height = step.ego.z_m + _ABOVE_GROUND_M / 2
    line = _line([_vector(float(x), float(y), height) for x, y in points], 0.08, _ROUTE_COLOR)
    return _update(_entity(step, "route", WORLD, lines=[line]))


def log_message(time_s: float, level: int, text: str) -> Message:
    return {"timestamp": stamp(time_s), "level": level, "message": text, "name": "gsrain", "file": "", "line": 0}


def camera_transform(time_s: float, name: str, camera: Camera) -> Message:
    """Return where a camera's frame is (x right, y down, z forward)."""
    to_world = np.linalg.inv(camera.world_to_camera)
    x, y, z, w = (float(each) for each in Rotation.from_matrix(to_world[:3, :3]).as_quat())
    return {
        "timestamp": stamp(time_s), "parent_frame_id": WORLD, "child_frame_id": name,
        "translation": _vector(*(float(each) for each in to_world[:3, 3])),
        "rotation": {"x": x, "y": y, "z": z, "w": w},
    }  # fmt: skip


def camera_calibration(time_s: float, name: str, camera: Camera) -> Message:
    """Return a camera's intrinsics, without distortion."""
    fx, fy, cx, cy = (float(each) for each in (camera.fx, camera.fy, camera.cx, camera.cy))
    return {
        "timestamp": stamp(time_s), "frame_id": name, "width": camera.width, "height": camera.height,
        "distortion_model": "plumb_bob", "D": [0.0] * 5, "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }  # fmt: skip


def compressed_image(time_s: float, name: str, image: UInt8[np.ndarray, "h w 3"]) -> Message:
    """Return a picture (RGB) as a JPEG."""
    _, encoded = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    data = base64.b64encode(encoded.tobytes()).decode()
    return {"timestamp": stamp(time_s), "frame_id": name, "data": data, "format": "jpeg"}


def _road_user(step: RolloutStep, user: UserRecord, model: UserModel) -> Message:
    length, width, height = model.size_lwh_m
    middle = _vector(user.x_m, user.y_m, user.z_m + height / 2)
    color = _HIT_COLOR if step.collision == user.id else _USER_COLOR
    cube = {
        "pose": {"position": middle, "orientation": _turn(user.yaw_rad)},
        "size": _vector(length, width, height),
        "color": _color(color),
    }
    above = _vector(user.x_m, user.y_m, user.z_m + height + 0.6)
    text = {
        "pose": {"position": above, "orientation": _turn(0.0)}, "billboard": True, "font_size": 0.7,
        "scale_invariant": False, "color": _color((1.0, 1.0, 1.0, 1.0)), "text": user.id,
    }  # fmt: skip
    about = [{"key": "class", "value": model.class_name}, {"key": "speed_m_s", "value": f"{user.speed_m_s:.3f}"}]
    return {**_entity(step, user.id, WORLD, cubes=[cube], texts=[text]), "metadata": about}


def _entity(step: RolloutStep, name: str, frame: str, **primitives: list[Message]) -> Message:
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        "timestamp": stamp(step.time_s), "frame_id": frame, "id": name, "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True, "metadata": [], **{kind: primitives.get(kind, []) for kind in kinds},
    }  # fmt: skip


def _update(entity: Message) -> Message:
    return {"deletions": [], "entities": [entity]}


def _line(points: list[Message], thickness_m: float, color: tuple[float, ...]) -> Message:
    return {
        "type": 0, "pose": {"position": _vector(0.0, 0.0, 0.0), "orientation": _turn(0.0)}, "thickness": thickness_m,
        "scale_invariant": False, "points": points, "color": _color(color), "colors": [], "indices": [],
    }  # fmt: skip


def _pose(ego: EgoRecord) -> Message:
    return {"position": _vector(ego.x_m, ego.y_m, ego.z_m), "orientation": _turn(ego.yaw_rad)}


def _vector(x: float, y: float, z: float) -> Message:
    return {"x": x, "y": y, "z": z}


def _turn(yaw_rad: float) -> Message:
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw_rad / 2)), "w": float(np.cos(yaw_rad / 2))}


def _color(rgba: tuple[float, ...]) -> Message:
    return dict(zip("rgba", rgba, strict=True))
