"""Protocol buffers of Waymo's frames, as far as a capture needs them, made here so that no TensorFlow is.

Names and numbers of fields are facts of dataset.proto and label.proto of github.com/waymo-research/waymo-open-dataset.
"""

from functools import cache
from importlib import import_module
from typing import Any

from ..capture import CaptureError

_SCALARS = {"double": 1, "float": 2, "int64": 3, "int32": 5, "string": 9, "bytes": 12}
"""Numbers of FieldDescriptorProto.Type; enumerations are read as int32."""

_FIELDS: dict[str, dict[str, tuple[int, str]]] = {
    "Transform": {"transform": (1, "double*")},
    "CameraCalibration": {
        "name": (1, "int32"),
        "intrinsic": (2, "double*"),
        "extrinsic": (3, "Transform"),
        "width": (4, "int32"),
        "height": (5, "int32"),
    },
    "LaserCalibration": {
        "name": (1, "int32"),
        "beam_inclinations": (2, "double*"),
        "beam_inclination_min": (3, "double"),
        "beam_inclination_max": (4, "double"),
        "extrinsic": (5, "Transform"),
    },
    "Context": {
        "name": (1, "string"),
        "camera_calibrations": (2, "CameraCalibration*"),
        "laser_calibrations": (3, "LaserCalibration*"),
    },
    "CameraImage": {
        "name": (1, "int32"),
        "image": (2, "bytes"),
        "pose": (3, "Transform"),
        "pose_timestamp": (5, "double"),
        "shutter": (6, "double"),
    },
    "MatrixShape": {"dims": (1, "int32*")},
    "MatrixFloat": {"data": (1, "bytes"), "shape": (2, "MatrixShape")},
    "RangeImage": {"range_image_compressed": (2, "bytes"), "range_image_pose_compressed": (4, "bytes")},
    "Laser": {"name": (1, "int32"), "ri_return1": (2, "RangeImage"), "ri_return2": (3, "RangeImage")},
    "Box": {
        "center_x": (1, "double"),
        "center_y": (2, "double"),
        "center_z": (3, "double"),
        "width": (4, "double"),
        "length": (5, "double"),
        "height": (6, "double"),
        "heading": (7, "double"),
    },
    "Label": {"box": (1, "Box"), "type": (3, "int32"), "id": (4, "string")},
    "Frame": {
        "context": (1, "Context"),
        "timestamp_micros": (2, "int64"),
        "pose": (3, "Transform"),
        "images": (4, "CameraImage*"),
        "lasers": (5, "Laser*"),
        "laser_labels": (6, "Label*"),
    },
    "FramePictures": {"images": (4, "CameraImage*")},
}
"""Message -> field -> number and type; a star means repeated. FramePictures is a Frame without all but its pictures.

The numbers of a MatrixFloat are packed: read as bytes they are an array without a detour through Python.
"""

_PACKAGE = "gsrain.waymo"


def parsed(message: str, content: bytes) -> Any:
    """Parse a message by its name. Raises `CaptureError` where it is damaged or protobuf is not installed."""
    kind = _kinds()[message]
    found = kind()
    try:
        found.ParseFromString(content)
    except Exception as error:  # DecodeError, whose module is not imported here
        raise CaptureError(f"not a message of Waymo's ({error})") from None
    return found


def new_message(message: str) -> Any:
    """Make an empty message, which can be filled and serialized."""
    return _kinds()[message]()


@cache
def _kinds() -> dict[str, Any]:
    try:
        descriptor = import_module("google.protobuf.descriptor_pb2")
        pool = import_module("google.protobuf.descriptor_pool").DescriptorPool()
        factory = import_module("google.protobuf.message_factory")
    except ImportError:
        raise CaptureError("Waymo's TFRecord files need the package protobuf: pip install 'gsrain[waymo]'") from None
    file = descriptor.FileDescriptorProto(name="gsrain_waymo.proto", package=_PACKAGE, syntax="proto2")
    for message, fields in _FIELDS.items():
        described = file.message_type.add(name=message)
        for name, (number, kind) in fields.items():
            plain = kind.rstrip("*")
            field = described.field.add(name=name, number=number, label=3 if kind.endswith("*") else 1)
            if plain in _SCALARS:
                field.type = _SCALARS[plain]
            else:
                field.type, field.type_name = 11, f".{_PACKAGE}.{plain}"
    pool.Add(file)
    return {name: factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}")) for name in _FIELDS}
