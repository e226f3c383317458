"""MCAP export of roll-outs for Foxglove: frames, boxes, planned points, plots and camera images."""

import base64
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from ...scene.camera import Camera
from ...scene.files import whole_file
from ..geometry import Route
from ..metrics.collisions import gaps_m, times_to_collision_s
from ..rollout import CameraImage, Rollout, RolloutStep, UserModel, UserRecord
from ..vehicle import Vehicle

_CHUNK_BYTES = 1 << 20


def write_rollout_mcap(
    path: Path, rollout: Rollout, route: Route | None = None, pictures: Iterable[CameraImage] = ()
) -> None:
    """Write a roll-out for Foxglove atomically; the same input gives the same bytes.

    Times are those of the simulation, from 0. Topics: /tf, /ego/pose, /ego/box, /ego/motion (speed, acceleration, TTC,
    gap and more), /road_users, /plan, /route, /log and for each camera /camera/NAME/image and /camera/NAME/calibration.
    The file's metadata describe the drive. `pictures` are in the order of steps and are consumed lazily, so that they
    can be rendered on demand.

    Raises ImportError with install instructions if mcap is missing, and ValueError for an image without a step.
    """
    try:
        from mcap.writer import CompressionType, Writer
    except ModuleNotFoundError:
        raise ImportError("MCAP files need mcap: pip install 'gsrain[drive]'") from None
    with whole_file(path) as partial, partial.open("wb") as stream:
        writer = Writer(stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(library="gsrain")
        _McapWriter(writer, rollout, route).write(iter(pictures))
        writer.finish()


Message = dict[str, Any]


class _McapWriter:
    def __init__(self, writer: Any, rollout: Rollout, route: Route | None) -> None:
        self._writer, self._rollout, self._route = writer, rollout, route
        self._vehicle, self._schemas = rollout.vehicle, _schemas()
        self._schema_ids: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._here: set[str] = set()

    def write(self, pictures: Iterator[CameraImage]) -> None:
        rollout, waiting = self._rollout, next(pictures, None)
        about = {
            "scenario": msgspec.json.encode(rollout.scenario, order="sorted").decode(), "scene": rollout.scene,
            "scene_hash": rollout.scene_hash, "agent": rollout.agent, "seed": str(rollout.seed), "end": rollout.end,
            **{f"version of {name}": version for name, version in sorted(rollout.software.items())},
        }  # fmt: skip
        self._writer.add_metadata("gsrain.rollout", about)
        times, gaps = times_to_collision_s(rollout), gaps_m(rollout)
        for step, ttc, gap in zip(rollout.steps, times, gaps, strict=True):
            self._step(step, float(ttc), float(gap))
            while waiting is not None and waiting.step == step.step:
                self._image(step, waiting)
                waiting = next(pictures, None)
        if waiting is not None:
            first, last = rollout.steps[0].step, rollout.steps[-1].step
            raise ValueError(f"picture of step {waiting.step}: expected rising steps within {first}..{last}")

    def _step(self, step: RolloutStep, ttc_s: float, gap_m: float) -> None:
        ego, stamp = step.ego, _timestamp(step)
        place, turn = _vector(ego.x_m, ego.y_m, ego.z_m), _turn(ego.yaw_rad)
        transform = {"parent_frame_id": WORLD, "child_frame_id": EGO, "translation": place, "rotation": turn}
        self._add(step, "/tf", "foxglove.FrameTransform", stamp | transform)
        pose = {"frame_id": WORLD, "pose": {"position": place, "orientation": turn}}
        self._add(step, "/ego/pose", "foxglove.PoseInFrame", stamp | pose)
        self._add(step, "/ego/box", "foxglove.SceneUpdate", _ego_box(step, self._vehicle))
        motion = {
            "speed_m_s": ego.speed_m_s, "acceleration_m_s2": ego.acceleration_m_s2, "steer_rad": ego.steer_rad,
            "yaw_rate_rad_s": ego.yaw_rate_rad_s, "ttc_s": ttc_s, "route_left_m": step.route_left_m,
            "route_completion": step.route_completion, "intensity_mm_h": self._rollout.intensity_mm_h,
            **({"gap_m": gap_m} if np.isfinite(gap_m) else {}),
        }  # fmt: skip
        self._add(step, "/ego/motion", "gsrain.Motion", stamp | motion)
        here = {user.id for user in step.road_users}
        users = _update(*(_road_user(step, user, self._rollout.users[user.id]) for user in step.road_users))
        users["deletions"] = [_deletion(step, name) for name in sorted(self._here - here)]
        self._here = here
        self._add(step, "/road_users", "foxglove.SceneUpdate", users)
        self._add(step, "/plan", "foxglove.SceneUpdate", _plan(step))
        if step is self._rollout.steps[0] and self._route is not None:
            self._add(step, "/route", "foxglove.SceneUpdate", _route(step, self._route.points))
        for level, text in self._log_lines(step):
            line = {"level": level, "message": text, "name": "gsrain", "file": "", "line": 0}
            self._add(step, "/log", "foxglove.Log", stamp | line)

    def _image(self, step: RolloutStep, picture: CameraImage) -> None:
        name, stamp = picture.name, _timestamp(step)
        self._add(step, "/tf", "foxglove.FrameTransform", stamp | _camera_transform(name, picture.camera))
        calibration = stamp | _calibration(name, picture.camera)
        self._add(step, f"/camera/{name}/calibration", "foxglove.CameraCalibration", calibration)
        bgr = np.ascontiguousarray(picture.image[..., ::-1])
        _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        image = {"frame_id": name, "data": base64.b64encode(encoded.tobytes()).decode(), "format": "jpeg"}
        self._add(step, f"/camera/{name}/image", "foxglove.CompressedImage", stamp | image)

    def _log_lines(self, step: RolloutStep) -> Iterator[tuple[int, str]]:
        if step is self._rollout.steps[0]:
            run = self._rollout
            yield _INFORMATION, f"{run.scenario_name}: {run.agent} drives in {run.intensity_mm_h:g} mm/h"
        if step.collision is not None:
            yield _ERROR, f"collision with {step.collision} at {step.ego.speed_m_s:.2f} m/s"
        if step is self._rollout.steps[-1]:
            yield _INFORMATION, f"end: {self._rollout.end}"

    def _add(self, step: RolloutStep, topic: str, title: str, message: Message) -> None:
        if topic not in self._channels:
            if title not in self._schema_ids:
                schema = msgspec.json.encode(self._schemas[title])
                self._schema_ids[title] = self._writer.register_schema(title, "jsonschema", schema)
            self._channels[topic] = self._writer.register_channel(topic, "json", self._schema_ids[title])
        time_ns, data = round(step.time_s * 1e9), msgspec.json.encode(message)
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns, sequence=step.step)


# Messages: world frame, meters, z up

WORLD, EGO = "world", "ego"
"""Frames: the scene's world, and the ego vehicle (x forward, y left, z up, origin below its rear axle)."""

_INFORMATION, _ERROR = 2, 4
_JPEG_QUALITY = 90
_ABOVE_GROUND_M = 0.05
_EGO_COLOR, _USER_COLOR = (0.12, 0.45, 0.75, 0.55), (0.85, 0.55, 0.2, 0.75)
_HIT_COLOR, _PLAN_COLOR, _ROUTE_COLOR = (0.86, 0.12, 0.15, 0.9), (0.15, 0.75, 0.35, 1.0), (0.6, 0.64, 0.68, 0.8)


def _ego_box(step: RolloutStep, vehicle: Vehicle) -> Message:
    """Return the ego vehicle's box, red after a collision."""
    color = _EGO_COLOR if step.collision is None else _HIT_COLOR
    size = _vector(vehicle.length_m, vehicle.width_m, vehicle.height_m)
    cube = _shape(_vector(vehicle.middle_m, 0.0, vehicle.height_m / 2), 0.0, size, color)
    return _update(_entity(step, EGO, EGO, cubes=[cube]))


def _road_user(step: RolloutStep, user: UserRecord, model: UserModel) -> Message:
    length, width, height = model.size_lwh_m
    middle = _vector(user.x_m, user.y_m, user.z_m + height / 2)
    color = _HIT_COLOR if step.collision == user.id else _USER_COLOR
    cube = _shape(middle, user.yaw_rad, _vector(length, width, height), color)
    above = _vector(user.x_m, user.y_m, user.z_m + height + 0.6)
    text = {
        "pose": {"position": above, "orientation": _turn(0.0)}, "billboard": True, "font_size": 0.7,
        "scale_invariant": False, "color": _color((1.0, 1.0, 1.0, 1.0)), "text": user.id,
    }  # fmt: skip
    about = [{"key": "class", "value": model.class_name}, {"key": "speed_m_s", "value": f"{user.speed_m_s:.3f}"}]
    return {**_entity(step, user.id, WORLD, cubes=[cube], texts=[text]), "metadata": about}


def _plan(step: RolloutStep) -> Message:
    """Return the planned points as dots on a line just above the ground; without a plan, deletes them."""
    if not step.plan:
        return {"deletions": [_deletion(step, "plan")], "entities": []}
    height = step.ego.z_m + _ABOVE_GROUND_M
    points = [_vector(float(x), float(y), height) for x, y in step.ego.state.to_world(np.array(step.plan, np.float64))]
    dots = [_shape(point, 0.0, _vector(0.4, 0.4, 0.4), _PLAN_COLOR) for point in points]
    start = _vector(step.ego.x_m, step.ego.y_m, height)
    return _update(_entity(step, "plan", WORLD, spheres=dots, lines=[_line([start, *points], 0.12, _PLAN_COLOR)]))


def _route(step: RolloutStep, points: Float64[np.ndarray, "n 2"]) -> Message:
    """Return the route, at the ground height of the vehicle."""
    height = step.ego.z_m + _ABOVE_GROUND_M / 2
    line = _line([_vector(float(x), float(y), height) for x, y in points], 0.08, _ROUTE_COLOR)
    return _update(_entity(step, "route", WORLD, lines=[line]))


def _camera_transform(name: str, camera: Camera) -> Message:
    """Return the transform of a camera's frame (x right, y down, z forward)."""
    to_world = np.linalg.inv(camera.world_to_camera)
    turn = (float(each) for each in Rotation.from_matrix(to_world[:3, :3]).as_quat())
    return {
        "parent_frame_id": WORLD, "child_frame_id": name,
        "translation": _vector(*(float(each) for each in to_world[:3, 3])),
        "rotation": dict(zip("xyzw", turn, strict=True)),
    }  # fmt: skip


def _calibration(name: str, camera: Camera) -> Message:
    """Return a camera's intrinsics, without distortion."""
    fx, fy, cx, cy = (float(each) for each in (camera.fx, camera.fy, camera.cx, camera.cy))
    return {
        "frame_id": name, "width": camera.width, "height": camera.height,
        "distortion_model": "plumb_bob", "D": [0.0] * 5, "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }  # fmt: skip


def _entity(step: RolloutStep, name: str, frame: str, **primitives: list[Message]) -> Message:
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return _timestamp(step) | {
        "frame_id": frame, "id": name, "lifetime": {"sec": 0, "nsec": 0}, "frame_locked": True, "metadata": [],
        **{kind: primitives.get(kind, []) for kind in kinds},
    }  # fmt: skip


def _update(*entities: Message) -> Message:
    return {"deletions": [], "entities": list(entities)}


def _deletion(step: RolloutStep, name: str) -> Message:
    return _timestamp(step) | {"type": 0, "id": name}


def _shape(position: Message, yaw_rad: float, size: Message, color: tuple[float, ...]) -> Message:
    return {"pose": {"position": position, "orientation": _turn(yaw_rad)}, "size": size, "color": _color(color)}


def _line(points: list[Message], thickness_m: float, color: tuple[float, ...]) -> Message:
    return {
        "type": 0, "pose": {"position": _vector(0.0, 0.0, 0.0), "orientation": _turn(0.0)}, "thickness": thickness_m,
        "scale_invariant": False, "points": points, "color": _color(color), "colors": [], "indices": [],
    }  # fmt: skip


def _timestamp(step: RolloutStep) -> Message:
    """Return the time of a step since the scenario began as seconds and nanoseconds."""
    seconds, nanoseconds = divmod(round(step.time_s * 1e9), 1_000_000_000)
    return {"timestamp": {"sec": seconds, "nsec": nanoseconds}}


def _vector(x: float, y: float, z: float) -> Message:
    return {"x": x, "y": y, "z": z}


def _turn(yaw_rad: float) -> Message:
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw_rad / 2)), "w": float(np.cos(yaw_rad / 2))}


def _color(rgba: tuple[float, ...]) -> Message:
    return dict(zip("rgba", rgba, strict=True))


# JSON schemas
# Source: github.com/foxglove/foxglove-sdk, schemas/jsonschema, without optional fields; and GSRAIN's own, for plots.

Schema = dict[str, Any]

_PLAIN: dict[str, Schema] = {
    "number": {"type": "number"},
    "string": {"type": "string"},
    "boolean": {"type": "boolean"},
    "bytes": {"type": "string", "contentEncoding": "base64"},
    "count": {"type": "integer", "minimum": 0},
}

_NANOSECONDS: Schema = {"type": "integer", "minimum": 0, "maximum": 999_999_999}
_TIMES: dict[str, Schema] = {
    name: {"type": "object", "title": name, "properties": {"sec": seconds, "nsec": _NANOSECONDS}}
    for name, seconds in (("time", _PLAIN["count"]), ("duration", {"type": "integer"}))
}

_CHOICES = {
    "LineType": ("LINE_STRIP", "LINE_LOOP", "LINE_LIST"),
    "SceneEntityDeletionType": ("MATCHING_ID", "ALL"),
    "LogLevel": ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"),
}

_FIELDS = {
    "Vector3": "x:number y:number z:number",
    "Point3": "x:number y:number z:number",
    "Quaternion": "x:number y:number z:number w:number",
    "Pose": "position:Vector3 orientation:Quaternion",
    "Color": "r:number g:number b:number a:number",
    "KeyValuePair": "key:string value:string",
    "CubePrimitive": "pose:Pose size:Vector3 color:Color",
    "SpherePrimitive": "pose:Pose size:Vector3 color:Color",
    "LinePrimitive": "type:LineType pose:Pose thickness:number scale_invariant:boolean points:Point3[] color:Color "
    "colors:Color[] indices:count[]",
    "TextPrimitive": "pose:Pose billboard:boolean font_size:number scale_invariant:boolean color:Color text:string",
    "ArrowPrimitive": "pose:Pose shaft_length:number shaft_diameter:number head_length:number head_diameter:number "
    "color:Color",
    "CylinderPrimitive": "pose:Pose size:Vector3 bottom_scale:number top_scale:number color:Color",
    "TriangleListPrimitive": "pose:Pose points:Point3[] color:Color colors:Color[] indices:count[]",
    "ModelPrimitive": "pose:Pose scale:Vector3 color:Color override_color:boolean url:string media_type:string "
    "data:bytes",
    "SceneEntity": "timestamp:time frame_id:string id:string lifetime:duration frame_locked:boolean "
    "metadata:KeyValuePair[] arrows:ArrowPrimitive[] cubes:CubePrimitive[] spheres:SpherePrimitive[] "
    "cylinders:CylinderPrimitive[] lines:LinePrimitive[] triangles:TriangleListPrimitive[] texts:TextPrimitive[] "
    "models:ModelPrimitive[]",
    "SceneEntityDeletion": "timestamp:time type:SceneEntityDeletionType id:string",
    "FrameTransform": "timestamp:time parent_frame_id:string child_frame_id:string translation:Vector3 "
    "rotation:Quaternion",
    "PoseInFrame": "timestamp:time frame_id:string pose:Pose",
    "SceneUpdate": "deletions:SceneEntityDeletion[] entities:SceneEntity[]",
    "CompressedImage": "timestamp:time frame_id:string data:bytes format:string",
    "CameraCalibration": "timestamp:time frame_id:string width:count height:count distortion_model:string D:number[] "
    "K:number[9] R:number[9] P:number[12]",
    "Log": "timestamp:time level:LogLevel message:string name:string file:string line:count",
    "gsrain.Motion": "timestamp:time speed_m_s:number acceleration_m_s2:number steer_rad:number yaw_rate_rad_s:number "
    "ttc_s:number route_left_m:number route_completion:number intensity_mm_h:number gap_m?:number",
}
"""Fields and types by schema; `?` marks an optional field: the gap, absent without a lead."""


def _schemas() -> dict[str, Schema]:
    """Return the schemas by title."""
    known = _PLAIN | _TIMES
    for name, values in _CHOICES.items():
        options = [{"title": title, "const": value} for value, title in enumerate(values)]
        known[name] = {"title": f"foxglove.{name}", "oneOf": options}
    known |= {f"{name}[]": {"type": "array", "items": schema} for name, schema in known.items()}
    known |= {f"number[{count}]": known["number[]"] | {"minItems": count, "maxItems": count} for count in (9, 12)}
    for name, fields in _FIELDS.items():
        pairs = [field.split(":") for field in fields.split()]
        known[name] = {
            "title": name if "." in name else f"foxglove.{name}",
            "type": "object",
            "properties": {field.rstrip("?"): known[kind] for field, kind in pairs},
            "required": [field for field, _ in pairs if not field.endswith("?")],
        }
        known[f"{name}[]"] = {"type": "array", "items": known[name]}
    return {schema["title"]: schema for name, schema in known.items() if name in _FIELDS}
