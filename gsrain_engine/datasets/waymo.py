"""Waymo Perception: cameras, boxes, range images, and protocol buffers, shared by both releases."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float32, Float64, UInt8
from numba import njit

from ..scene.camera import DEFAULT_EXPOSURE_S, Camera
from .capture import CaptureError, CaptureFrame, Lens
from .geometry import OPENCV_FROM_VEHICLE_AXES, invert_pose, rigid_pose
from .io.images import opened_image

CAMERAS = {
    1: "FRONT",
    2: "FRONT_LEFT",
    3: "FRONT_RIGHT",
    4: "SIDE_LEFT",
    5: "SIDE_RIGHT",
    6: "REAR_LEFT",
    7: "REAR",
    8: "REAR_RIGHT",
}

CLASSES = {1: "vehicle", 2: "pedestrian", 3: "sign", 4: "cyclist"}
_LONGEST_EXPOSURE_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class WaymoCamera:
    """Calibration of one camera. Its own axes are x forward, y left, z up; converted here to OpenCV's."""

    name: str
    intrinsics: tuple[float, ...]
    """f_u f_v c_u c_v k1 k2 p1 p2 k3; the first pixel's center is (0.5, 0.5)."""
    to_vehicle: Float64[np.ndarray, "4 4"]
    width: int
    height: int

    def __post_init__(self) -> None:
        if len(self.intrinsics) != 9 or not np.isfinite(self.intrinsics).all() or min(self.intrinsics[:2]) <= 0:
            raise ValueError(f"camera {self.name} has the intrinsics {self.intrinsics}, expected 9 numbers")
        if self.width < 1 or self.height < 1:
            raise ValueError(f"camera {self.name} has pictures of {self.width}x{self.height} px")

    def view(
        self,
        name: str,
        vehicle_to_world: Float64[np.ndarray, "4 4"],
        time_s: float,
        shutter_s: float,
        jpeg: Callable[[], bytes],
    ) -> CaptureFrame:
        """View of one image at the vehicle's pose. An impossible shutter time is replaced by the default."""
        to_world = vehicle_to_world @ self.to_vehicle @ invert_pose(OPENCV_FROM_VEHICLE_AXES)
        fx, fy, cx, cy = self.intrinsics[:4]
        exposure = shutter_s if 0 < shutter_s <= _LONGEST_EXPOSURE_S else DEFAULT_EXPOSURE_S
        camera = Camera(self.width, self.height, fx, fy, cx, cy, invert_pose(to_world), exposure)
        lens = Lens("opencv", self.intrinsics[4:]) if any(self.intrinsics[4:]) else None
        return CaptureFrame(name, camera, lambda: decoded(jpeg(), name), time_s, self.name, lens)


def check_jpeg(content: bytes, size: tuple[int, int]) -> None:
    """Raise ValueError unless bytes are a complete JPEG of a width and height."""
    with opened_image(content, "its picture") as picture:
        found = picture.size
    if found != size:
        raise ValueError(f"a picture of {found[0]}x{found[1]} px, its calibration says {size[0]}x{size[1]}")
    if b"\xff\xd9" not in content[-1024:]:
        raise ValueError("the picture is cut off; its end is missing")


def decoded(content: bytes, name: str) -> UInt8[np.ndarray, "h w 3"]:
    """Decode a JPEG. Raises `CaptureError` if it is damaged."""
    with opened_image(content, name) as picture:
        return np.array(picture.convert("RGB"), np.uint8)


def heading_pose(center_m: Sequence[float], heading_rad: float) -> Float64[np.ndarray, "4 4"]:
    """Pose of an upright box in the vehicle's frame."""
    cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return rigid_pose(turn, np.asarray(center_m, np.float64))


# Range images
# Facts: RangeImage in dataset.proto and v2/perception/lidar.py of github.com/waymo-research/waymo-open-dataset.

LASERS = {1: "TOP", 2: "FRONT", 3: "SIDE_LEFT", 4: "SIDE_RIGHT", 5: "REAR"}


@dataclass(frozen=True, slots=True, eq=False)
class WaymoLaser:
    """Pose and beams of a lidar: row 0 of a range image is the highest beam."""

    to_vehicle: Float64[np.ndarray, "4 4"]
    inclinations_rad: Float64[np.ndarray, " k"]
    """Inclination of each row from the lowest up, or the lowest and highest edge (2) of evenly spaced rows."""
    is_even: bool

    def points(
        self,
        ranges: Float32[np.ndarray, "h w c"],
        pixel_poses: Float32[np.ndarray, "u v d"] | None,
        vehicle_to_world: Float64[np.ndarray, "4 4"],
    ) -> tuple[Float64[np.ndarray, "p 3"], Float32[np.ndarray, " p"]]:
        """Points (m) in the vehicle's frame at the frame's pose, and intensities; ValueError if shapes disagree.

        Column 0 is the backward direction, and columns rotate clockwise seen from above, in the vehicle's frame.
        `pixel_poses` (height, width; roll pitch yaw x y z) are the vehicle's poses at each pixel's own time, if known.
        """
        height, width = ranges.shape[:2]
        if pixel_poses is not None and pixel_poses.shape != (height, width, 6):
            raise ValueError(f"poses of the shape {pixel_poses.shape} belong to a range image of {height}x{width}")
        turned = np.arctan2(self.to_vehicle[1, 0], self.to_vehicle[0, 0])
        yaw = np.pi - 2 * np.pi * (np.arange(width) + 0.5) / width - turned
        pitch = self._row_pitches(height)
        poses = np.zeros((0, 0, 6), np.float32) if pixel_poses is None else np.ascontiguousarray(pixel_poses)
        back = invert_pose(vehicle_to_world)
        points = _points(np.ascontiguousarray(ranges), pitch, yaw, self.to_vehicle, poses, back)
        seen = ranges[..., 0] > 0
        light = ranges[..., 1][seen] if ranges.shape[2] > 1 else np.zeros(len(points), np.float32)
        return points, np.ascontiguousarray(light, np.float32)

    def _row_pitches(self, height: int) -> Float64[np.ndarray, " h"]:
        if self.is_even:
            low, high = self.inclinations_rad
            return (low + (high - low) * (np.arange(height) + 0.5) / height)[::-1]
        if len(self.inclinations_rad) != height:
            raise ValueError(f"a lidar of {len(self.inclinations_rad)} beams has a range image of {height} rows")
        return self.inclinations_rad[::-1]


@njit(cache=True)
@no_type_check
def _points(ranges, pitch, yaw, to_vehicle, poses, back):
    """Points of all pixels with a range, row by row; `poses` is empty if the vehicle did not move."""
    count = 0
    for row in range(ranges.shape[0]):
        for column in range(ranges.shape[1]):
            count += ranges[row, column, 0] > 0
    points = np.empty((count, 3))
    k = 0
    for row in range(ranges.shape[0]):
        flat, rise = np.cos(pitch[row]), np.sin(pitch[row])
        for column in range(ranges.shape[1]):
            distance = float(ranges[row, column, 0])
            if not distance > 0:
                continue
            x, y, z = distance * flat * np.cos(yaw[column]), distance * flat * np.sin(yaw[column]), distance * rise
            x, y, z = _moved(to_vehicle, x, y, z)
            if poses.shape[0] > 0:
                # To the world from the pixel's own pose: roll about x, pitch about y, yaw about z, in this order.
                roll, nod, heading = poses[row, column, 0], poses[row, column, 1], poses[row, column, 2]
                y, z = np.cos(roll) * y - np.sin(roll) * z, np.sin(roll) * y + np.cos(roll) * z
                x, z = np.cos(nod) * x + np.sin(nod) * z, np.cos(nod) * z - np.sin(nod) * x
                x, y = np.cos(heading) * x - np.sin(heading) * y, np.sin(heading) * x + np.cos(heading) * y
                x, y, z = x + poses[row, column, 3], y + poses[row, column, 4], z + poses[row, column, 5]
                x, y, z = _moved(back, x, y, z)
            points[k, 0], points[k, 1], points[k, 2] = x, y, z
            k += 1
    return points


@njit(cache=True)
@no_type_check
def _moved(pose, x, y, z):
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
    )


# Protocol buffers, so that TensorFlow is not required
# Names and numbers are facts of dataset.proto and label.proto of github.com/waymo-research/waymo-open-dataset.

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
"""Message -> field -> number and type; a star means repeated. FramePictures is a Frame with only its images.

The numbers of a MatrixFloat are packed: read as bytes they become an array directly.
"""

_PACKAGE = "gsrain.waymo"


def parsed(message: str, content: bytes) -> Any:
    """Parse a message by its name. Raises `CaptureError` if it is damaged or protobuf is not installed."""
    kind = _kinds()[message]
    found = kind()
    try:
        found.ParseFromString(content)
    except Exception as error:  # DecodeError, whose module is not imported here
        raise CaptureError(f"not a message of Waymo's ({error})") from None
    return found


def new_message(message: str) -> Any:
    """Create an empty message to be filled and serialized."""
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
