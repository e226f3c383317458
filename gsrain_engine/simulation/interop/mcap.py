"""MCAP export of roll-outs for Foxglove: frames, boxes, planned points, plots and camera images."""

import base64
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import msgspec
import numpy as np
from jaxtyping import Float64, UInt8
from scipy.spatial.transform import Rotation

from ...scene.camera import Camera
from ...scene.files import whole_file
from ..metrics.collisions import gaps_m, times_to_collision_s
from ..rollout import EgoRecord, Rollout, RolloutStep, RunSetting, UserModel, UserRecord, run_setting
from ..route import Route
from ..vehicle import Vehicle, VehicleState

_MISSING = "MCAP files need mcap: pip install 'gsrain[drive]'"
_CHUNK_BYTES = 1 << 20
_LIBRARY = "gsrain"


class CameraImage(NamedTuple):
    """Image of a rig camera at one step."""

    step: int
    name: str
    """Camera name, used as frame and topic."""
    image: UInt8[np.ndarray, "h w 3"]
    """RGB, display-referred."""
    camera: Camera
    """World frame."""


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
        raise ImportError(_MISSING) from None
    with whole_file(path) as beside, beside.open("wb") as stream:
        writer = Writer(stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(library=_LIBRARY)
        _McapWriter(writer, rollout, route).write(iter(pictures))
        writer.finish()


# Messages
# World frame: meters, z up.

Message = dict[str, Any]

# Foxglove JSON schemas
# Source: github.com/foxglove/foxglove-sdk, schemas/jsonschema, without optional fields.

Schema = dict[str, Any]


class _McapWriter:
    def __init__(self, writer: Any, rollout: Rollout, route: Route | None) -> None:
        self._writer, self._rollout, self._route = writer, rollout, route
        self._setting: RunSetting = run_setting(rollout)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._here: set[str] = set()

    def write(self, pictures: Iterator[CameraImage]) -> None:
        self._writer.add_metadata("gsrain.rollout", self._about())
        times, gaps = times_to_collision_s(self._rollout), gaps_m(self._rollout)
        waiting = next(pictures, None)
        for step, ttc, gap in zip(self._rollout.steps, times, gaps, strict=True):
            self._moment(step, float(ttc), float(gap))
            while waiting is not None and waiting.step == step.step:
                self._image(step, waiting)
                waiting = next(pictures, None)
        if waiting is not None:
            first, last = self._rollout.steps[0].step, self._rollout.steps[-1].step
            raise ValueError(f"picture of step {waiting.step}: expected rising steps within {first}..{last}")

    def _moment(self, step: RolloutStep, ttc_s: float, gap_m: float) -> None:
        setting, first = self._setting, step is self._rollout.steps[0]
        self._add(step, "/tf", FRAME_TRANSFORM, ego_transform(step))
        self._add(step, "/ego/pose", POSE_IN_FRAME, ego_pose_in_world(step))
        self._add(step, "/ego/box", SCENE_UPDATE, ego_box_update(step, setting.vehicle))
        self._add(step, "/ego/motion", MOTION, self._motion(step, ttc_s, gap_m))
        here = {user.id for user in step.road_users}
        users = road_users_update(step, self._rollout.users, sorted(self._here - here))
        self._here = here
        self._add(step, "/road_users", SCENE_UPDATE, users)
        self._add(step, "/plan", SCENE_UPDATE, plan_update(step))
        if first and self._route is not None:
            self._add(step, "/route", SCENE_UPDATE, route_update(step, self._route.points))
        for level, text in self._log_lines(step):
            self._add(step, "/log", LOG, log_message(step.time_s, level, text))

    def _image(self, step: RolloutStep, picture: CameraImage) -> None:
        time_s, name, camera = step.time_s, picture.name, picture.camera
        self._add(step, "/tf", FRAME_TRANSFORM, camera_transform(time_s, name, camera))
        calibration = camera_calibration(time_s, name, camera)
        self._add(step, f"/camera/{name}/calibration", CAMERA_CALIBRATION, calibration)
        image = compressed_image(time_s, name, picture.image)
        self._add(step, f"/camera/{name}/image", COMPRESSED_IMAGE, image)

    def _motion(self, step: RolloutStep, ttc_s: float, gap_m: float) -> Message:
        ego = step.ego
        motion = {
            "timestamp": timestamp_of(step.time_s), "speed_m_s": ego.speed_m_s,
            "acceleration_m_s2": ego.acceleration_m_s2, "steer_rad": ego.steer_rad,
            "yaw_rate_rad_s": ego.yaw_rate_rad_s, "ttc_s": ttc_s, "route_left_m": step.route_left_m,
            "route_completion": step.route_completion, "intensity_mm_h": self._setting.intensity_mm_h,
        }  # fmt: skip
        return {**motion, "gap_m": gap_m} if np.isfinite(gap_m) else motion

    def _log_lines(self, step: RolloutStep) -> list[tuple[int, str]]:
        lines: list[tuple[int, str]] = []
        if step is self._rollout.steps[0]:
            rain, agent = self._setting.intensity_mm_h, self._rollout.agent
            lines.append((INFORMATION, f"{self._setting.scenario}: {agent} drives in {rain:g} mm/h"))
        if step.collision is not None:
            lines.append((ERROR, f"collision with {step.collision} at {step.ego.speed_m_s:.2f} m/s"))
        if step is self._rollout.steps[-1]:
            lines.append((INFORMATION, f"end: {self._rollout.end}"))
        return lines

    def _about(self) -> dict[str, str]:
        rollout = self._rollout
        return {
            "scenario": msgspec.json.encode(rollout.scenario, order="sorted").decode(), "scene": rollout.scene,
            "scene_hash": rollout.scene_hash, "agent": rollout.agent, "seed": str(rollout.seed), "end": rollout.end,
            **{f"version of {name}": version for name, version in sorted(rollout.software.items())},
        }  # fmt: skip

    def _add(self, step: RolloutStep, topic: str, schema: Schema, message: Message) -> None:
        time_ns = nanoseconds_of(step.time_s)
        data = msgspec.json.encode(message)
        self._writer.add_message(self._channel(topic, schema), time_ns, data, time_ns, sequence=step.step)

    def _channel(self, topic: str, schema: Schema) -> int:
        if topic not in self._channels:
            title = schema["title"]
            if title not in self._schemas:
                data = msgspec.json.encode(schema)
                self._schemas[title] = self._writer.register_schema(title, "jsonschema", data)
            self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[title])
        return self._channels[topic]


WORLD, EGO = "world", "ego"
"""Frames: the scene's world, and the ego vehicle (x forward, y left, z up, origin below its rear axle)."""

INFORMATION, ERROR = 2, 4
_JPEG_QUALITY = 90
_ABOVE_GROUND_M = 0.05
_EGO_COLOR, _USER_COLOR = (0.12, 0.45, 0.75, 0.55), (0.85, 0.55, 0.2, 0.75)
_HIT_COLOR, _PLAN_COLOR, _ROUTE_COLOR = (0.86, 0.12, 0.15, 0.9), (0.15, 0.75, 0.35, 1.0), (0.6, 0.64, 0.68, 0.8)


def timestamp_of(time_s: float) -> Message:
    """Return a time since the scenario began as seconds and nanoseconds."""
    seconds, nanoseconds = divmod(nanoseconds_of(time_s), 1_000_000_000)
    return {"sec": seconds, "nsec": nanoseconds}


def nanoseconds_of(time_s: float) -> int:
    return round(time_s * 1e9)


def ego_transform(step: RolloutStep) -> Message:
    """Return the transform of the ego vehicle's frame."""
    ego = step.ego
    return {
        "timestamp": timestamp_of(step.time_s), "parent_frame_id": WORLD, "child_frame_id": EGO,
        "translation": _vector(ego.x_m, ego.y_m, ego.z_m), "rotation": _turn(ego.yaw_rad),
    }  # fmt: skip


def ego_pose_in_world(step: RolloutStep) -> Message:
    """Return the ego vehicle's pose."""
    return {"timestamp": timestamp_of(step.time_s), "frame_id": WORLD, "pose": _pose(step.ego)}


def ego_box_update(step: RolloutStep, vehicle: Vehicle) -> Message:
    """Return the ego vehicle's box, red after a collision."""
    position = _vector(vehicle.middle_m, 0.0, vehicle.height_m / 2)
    cube = {
        "pose": {"position": position, "orientation": _turn(0.0)},
        "size": _vector(vehicle.length_m, vehicle.width_m, vehicle.height_m),
        "color": _color(_EGO_COLOR if step.collision is None else _HIT_COLOR),
    }
    return _update(_entity(step, EGO, EGO, cubes=[cube]))


def road_users_update(step: RolloutStep, users: dict[str, UserModel], gone: Sequence[str]) -> Message:
    """Return the boxes and names of the road users; `gone` are the ids of those that disappeared."""
    entities = [_road_user(step, user, users[user.id]) for user in step.road_users]
    deletions = [{"timestamp": timestamp_of(step.time_s), "type": 0, "id": name} for name in gone]
    return {"deletions": deletions, "entities": entities}


def plan_update(step: RolloutStep) -> Message:
    """Return the planned points as dots on a line just above the ground; without a plan, deletes them."""
    if not step.plan:
        return {"deletions": [{"timestamp": timestamp_of(step.time_s), "type": 0, "id": "plan"}], "entities": []}
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
    """Return the route, at the ground height of the vehicle."""
    height = step.ego.z_m + _ABOVE_GROUND_M / 2
    line = _line([_vector(float(x), float(y), height) for x, y in points], 0.08, _ROUTE_COLOR)
    return _update(_entity(step, "route", WORLD, lines=[line]))


def log_message(time_s: float, level: int, text: str) -> Message:
    return {"timestamp": timestamp_of(time_s), "level": level, "message": text, "name": "gsrain", "file": "", "line": 0}


def camera_transform(time_s: float, name: str, camera: Camera) -> Message:
    """Return the transform of a camera's frame (x right, y down, z forward)."""
    to_world = np.linalg.inv(camera.world_to_camera)
    x, y, z, w = (float(each) for each in Rotation.from_matrix(to_world[:3, :3]).as_quat())
    return {
        "timestamp": timestamp_of(time_s), "parent_frame_id": WORLD, "child_frame_id": name,
        "translation": _vector(*(float(each) for each in to_world[:3, 3])),
        "rotation": {"x": x, "y": y, "z": z, "w": w},
    }  # fmt: skip


def camera_calibration(time_s: float, name: str, camera: Camera) -> Message:
    """Return a camera's intrinsics, without distortion."""
    fx, fy, cx, cy = (float(each) for each in (camera.fx, camera.fy, camera.cx, camera.cy))
    return {
        "timestamp": timestamp_of(time_s), "frame_id": name, "width": camera.width, "height": camera.height,
        "distortion_model": "plumb_bob", "D": [0.0] * 5, "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }  # fmt: skip


def compressed_image(time_s: float, name: str, image: UInt8[np.ndarray, "h w 3"]) -> Message:
    """Return an image (RGB) as a JPEG."""
    _, encoded = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    data = base64.b64encode(encoded.tobytes()).decode()
    return {"timestamp": timestamp_of(time_s), "frame_id": name, "data": data, "format": "jpeg"}


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
        "timestamp": timestamp_of(step.time_s), "frame_id": frame, "id": name, "lifetime": {"sec": 0, "nsec": 0},
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


_NUMBER: Schema = {"type": "number"}
_STRING: Schema = {"type": "string"}
_BOOLEAN: Schema = {"type": "boolean"}
_BYTES: Schema = {"type": "string", "contentEncoding": "base64"}
_COUNT: Schema = {"type": "integer", "minimum": 0}


def _object(title: str, **fields: Schema) -> Schema:
    return {"title": title, "type": "object", "properties": fields, "required": list(fields)}


def _list(of: Schema) -> Schema:
    return {"type": "array", "items": of}


def _choice(title: str, *names: str) -> Schema:
    return {"title": title, "oneOf": [{"title": name, "const": value} for value, name in enumerate(names)]}


def _numbers(count: int) -> Schema:
    return {"type": "array", "items": _NUMBER, "minItems": count, "maxItems": count}


_NANOSECONDS: Schema = {"type": "integer", "minimum": 0, "maximum": 999_999_999}
_TIME: Schema = {"type": "object", "title": "time", "properties": {"sec": _COUNT, "nsec": _NANOSECONDS}}

_DURATION: Schema = {
    "type": "object", "title": "duration", "properties": {"sec": {"type": "integer"}, "nsec": _NANOSECONDS},
}  # fmt: skip

_VECTOR = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_POINT = _object("foxglove.Point3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_COLOR = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_PAIR = _object("foxglove.KeyValuePair", key=_STRING, value=_STRING)
_CUBE = _object("foxglove.CubePrimitive", pose=_POSE, size=_VECTOR, color=_COLOR)
_SPHERE = _object("foxglove.SpherePrimitive", pose=_POSE, size=_VECTOR, color=_COLOR)

_LINE = _object(
    "foxglove.LinePrimitive",
    type=_choice("foxglove.LineType", "LINE_STRIP", "LINE_LOOP", "LINE_LIST"),
    pose=_POSE, thickness=_NUMBER, scale_invariant=_BOOLEAN, points=_list(_POINT), color=_COLOR, colors=_list(_COLOR),
    indices=_list(_COUNT),
)  # fmt: skip

_TEXT = _object(
    "foxglove.TextPrimitive",
    pose=_POSE, billboard=_BOOLEAN, font_size=_NUMBER, scale_invariant=_BOOLEAN, color=_COLOR, text=_STRING,
)  # fmt: skip

_ARROW = _object(
    "foxglove.ArrowPrimitive",
    pose=_POSE, shaft_length=_NUMBER, shaft_diameter=_NUMBER, head_length=_NUMBER, head_diameter=_NUMBER, color=_COLOR,
)  # fmt: skip

_CYLINDER = _object(
    "foxglove.CylinderPrimitive", pose=_POSE, size=_VECTOR, bottom_scale=_NUMBER, top_scale=_NUMBER, color=_COLOR
)

_TRIANGLES = _object(
    "foxglove.TriangleListPrimitive",
    pose=_POSE, points=_list(_POINT), color=_COLOR, colors=_list(_COLOR), indices=_list(_COUNT),
)  # fmt: skip

_MODEL = _object(
    "foxglove.ModelPrimitive",
    pose=_POSE, scale=_VECTOR, color=_COLOR, override_color=_BOOLEAN, url=_STRING, media_type=_STRING, data=_BYTES,
)  # fmt: skip

_ENTITY = _object(
    "foxglove.SceneEntity",
    timestamp=_TIME, frame_id=_STRING, id=_STRING, lifetime=_DURATION, frame_locked=_BOOLEAN, metadata=_list(_PAIR),
    arrows=_list(_ARROW), cubes=_list(_CUBE), spheres=_list(_SPHERE), cylinders=_list(_CYLINDER), lines=_list(_LINE),
    triangles=_list(_TRIANGLES), texts=_list(_TEXT), models=_list(_MODEL),
)  # fmt: skip

_DELETION = _object(
    "foxglove.SceneEntityDeletion",
    timestamp=_TIME, type=_choice("foxglove.SceneEntityDeletionType", "MATCHING_ID", "ALL"), id=_STRING,
)  # fmt: skip

FRAME_TRANSFORM = _object(
    "foxglove.FrameTransform",
    timestamp=_TIME, parent_frame_id=_STRING, child_frame_id=_STRING, translation=_VECTOR, rotation=_QUATERNION,
)  # fmt: skip

POSE_IN_FRAME = _object("foxglove.PoseInFrame", timestamp=_TIME, frame_id=_STRING, pose=_POSE)
SCENE_UPDATE = _object("foxglove.SceneUpdate", deletions=_list(_DELETION), entities=_list(_ENTITY))

COMPRESSED_IMAGE = _object(
    "foxglove.CompressedImage",
    timestamp=_TIME, frame_id=_STRING, data=_BYTES, format=_STRING,
)  # fmt: skip

CAMERA_CALIBRATION = _object(
    "foxglove.CameraCalibration",
    timestamp=_TIME, frame_id=_STRING, width=_COUNT, height=_COUNT, distortion_model=_STRING, D=_list(_NUMBER),
    K=_numbers(9), R=_numbers(9), P=_numbers(12),
)  # fmt: skip

LOG = _object(
    "foxglove.Log",
    timestamp=_TIME, level=_choice("foxglove.LogLevel", "UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"),
    message=_STRING, name=_STRING, file=_STRING, line=_COUNT,
)  # fmt: skip

MOTION = _object(
    "gsrain.Motion",
    timestamp=_TIME, speed_m_s=_NUMBER, acceleration_m_s2=_NUMBER, steer_rad=_NUMBER, yaw_rate_rad_s=_NUMBER,
    ttc_s=_NUMBER, route_left_m=_NUMBER, route_completion=_NUMBER, intensity_mm_h=_NUMBER,
)  # fmt: skip
"""GSRAIN's own schema: values for plots."""

MOTION["properties"]["gap_m"] = _NUMBER
"""Gap to the lead; omitted without one."""
