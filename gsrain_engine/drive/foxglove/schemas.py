"""JSON Schemas of the Foxglove messages that roll-outs are exported as, so far as they are written.

Source: the schemas that Foxglove publishes for its messages (github.com/foxglove/foxglove-sdk, schemas/jsonschema);
their optional fields are left out.
"""

from typing import Any

Schema = dict[str, Any]

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
"""Ours: numbers for plots."""
MOTION["properties"]["gap_m"] = _NUMBER
"""To who is ahead; left out where nobody is."""
