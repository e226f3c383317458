"""Messages of cameras, lidars and poses: ROS 2 (CDR) and Foxglove's schemas (JSON, Protocol Buffers).

Facts: the .msg files of github.com/ros2/common_interfaces and geometry2, of github.com/ros-perception/vision_msgs 4,
and github.com/foxglove/foxglove-sdk/schemas.
"""

import base64
import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from ...optional_packages import MissingPackageError, import_package, require_package
from ..capture import CaptureError
from ..geometry import Pose, rigid_from_quaternion
from ..io.arrays import WRONG_VALUES, what_is_wrong
from .containers import BagMessage, Topic

Kind = Literal["image", "calibration", "cloud", "transforms", "pose", "boxes"]

KINDS: Mapping[str, Kind] = {
    "sensor_msgs/msg/Image": "image",
    "sensor_msgs/msg/CompressedImage": "image",
    "sensor_msgs/msg/CameraInfo": "calibration",
    "sensor_msgs/msg/PointCloud2": "cloud",
    "tf2_msgs/msg/TFMessage": "transforms",
    "nav_msgs/msg/Odometry": "pose",
    "vision_msgs/msg/Detection3DArray": "boxes",
    "foxglove.RawImage": "image",
    "foxglove.CompressedImage": "image",
    "foxglove.CameraCalibration": "calibration",
    "foxglove.PointCloud": "cloud",
    "foxglove.FrameTransform": "transforms",
    "foxglove.FrameTransforms": "transforms",
}
"""Types of messages that are read."""

_VISION = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id\n"
    ),
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}
"""Types that are not among those that ROS 2 comes with."""

_ENCODINGS = ("cdr", "json", "protobuf")


def kind_of(topic: Topic) -> Kind | None:
    """Kind of a topic's messages; None if they are not read."""
    kind = KINDS.get(topic.type)
    return kind if topic.encoding in _ENCODINGS and (topic.encoding == "cdr") == ("/" in topic.type) else None


class Stamp(NamedTuple):
    """Frame of reference and time of a measurement."""

    frame: str
    time_ns: int


# Encodings


def decoded(message: BagMessage) -> Any:
    """Decode a message to an object with the fields of its type; raises ValueError."""
    topic = message.topic
    try:
        if topic.encoding == "cdr":
            return ros_types().deserialize_cdr(message.data, topic.type)
        if topic.encoding == "json":
            return _namespace(msgspec.json.decode(message.data))
        found = _protobuf(topic)()
        found.ParseFromString(message.data)
        return found
    except CaptureError:
        raise
    except Exception as error:  # of rosbags, msgspec and protobuf
        raise ValueError(f"not a {topic.type} ({str(error) or type(error).__name__})") from None


def encoded(value: Any, topic: Topic) -> bytes:
    """Encode an object that `decoded` returned, with changed fields."""
    if topic.encoding == "cdr":
        return bytes(ros_types().serialize_cdr(value, topic.type))
    if topic.encoding == "json":
        return msgspec.json.encode(_plain(value))
    return value.SerializeToString(deterministic=True)


@cache
def ros_types() -> Any:
    """Types of ROS 2 and vision_msgs, the same in all releases as far as they are read.

    Those in a file are not compiled. Raises `CaptureError` without rosbags.
    """
    try:
        typesys = import_package("rosbags.typesys", "a bag of ROS 2")
    except MissingPackageError as error:
        raise CaptureError(str(error)) from None
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for name, text in _VISION.items():
        store.register(typesys.get_types_from_msg(text, name))
    return store


@cache
def _protobuf(topic: Topic) -> Any:
    """Class of a topic's messages, from the descriptors in its file."""
    try:
        require_package("google.protobuf", "an MCAP file of Protobuf messages", "recordings")
    except MissingPackageError as error:
        raise CaptureError(str(error)) from None
    descriptor = import_module("google.protobuf.descriptor_pb2")
    pool = import_module("google.protobuf.descriptor_pool").DescriptorPool()
    factory = import_module("google.protobuf.message_factory")
    files = descriptor.FileDescriptorSet.FromString(topic.definition).file
    waiting = {each.name: each for each in files}
    while waiting:
        ready = [each for each in waiting.values() if not any(name in waiting for name in each.dependency)]
        if not ready:
            raise ValueError("its descriptors refer to each other in a circle")
        for each in ready:
            pool.Add(waiting.pop(each.name))
    return factory.GetMessageClass(pool.FindMessageTypeByName(topic.type))


def _namespace(value: Any) -> Any:
    if isinstance(value, dict):
        return SimpleNamespace(**{str(name): _namespace(each) for name, each in value.items()})
    return [_namespace(each) for each in value] if isinstance(value, list) else value


def _plain(value: Any) -> Any:
    if isinstance(value, SimpleNamespace):
        return {name: _plain(each) for name, each in vars(value).items()}
    return [_plain(each) for each in value] if isinstance(value, list) else value


def _bytes_of(value: Any, topic: Topic) -> UInt8[np.ndarray, " n"]:
    content: Any = base64.b64decode(value, validate=True) if topic.encoding == "json" else value
    return np.frombuffer(content, np.uint8)


def _stored_bytes(content: bytes, topic: Topic) -> Any:
    """Bytes as the field of an object of `decoded` holds them."""
    if topic.encoding == "json":
        return base64.b64encode(content).decode()
    return np.frombuffer(content, np.uint8) if topic.encoding == "cdr" else content


def _changed(value: Any, **fields: Any) -> Any:
    """Copy an object of `decoded` with other fields."""
    changed = copy.deepcopy(value) if hasattr(value, "SerializeToString") else copy.copy(value)
    for name, each in fields.items():
        setattr(changed, name, each)
    return changed


def _stamp(value: Any) -> Stamp:
    """Stamp of a message of ROS (header) or of Foxglove."""
    if hasattr(value, "header"):
        time = value.header.stamp
        return Stamp(_frame(value.header.frame_id), int(time.sec) * 10**9 + int(time.nanosec))
    frame = _frame(getattr(value, "frame_id", ""))
    time = getattr(value, "timestamp", None)
    if time is None:
        return Stamp(frame, 0)
    seconds = time.seconds if hasattr(time, "seconds") else time.sec
    return Stamp(frame, int(seconds) * 10**9 + int(time.nanos if hasattr(time, "nanos") else time.nsec))


def _frame(name: Any) -> str:
    """Name of a frame; ROS 1 began them with a slash."""
    return str(name).removeprefix("/")


# Images


@dataclass(frozen=True, slots=True, eq=False)
class ImageMessage:
    """Picture as it was recorded: compressed, or rows of pixels."""

    stamp: Stamp
    topic: Topic
    value: Any
    """Object of `decoded`."""
    encoding: str
    """Of its pixels, such as bgr8; the format if it is compressed."""
    is_compressed: bool
    height: int = 0
    width: int = 0
    step: int = 0
    """Bytes a row; like the size 0 if it is compressed."""
    is_bigendian: bool = False
    """Order of the bytes of 16 bits."""

    @property
    def data(self) -> UInt8[np.ndarray, " n"]:
        return _bytes_of(self.value.data, self.topic)

    def with_pixels(self, content: bytes, step: int = 0) -> bytes:
        """Encode the message with other pixels or another compressed picture of the same size."""
        fields = {} if self.is_compressed else {"step": step}
        return encoded(_changed(self.value, data=_stored_bytes(content, self.topic), **fields), self.topic)


def read_image(message: BagMessage) -> ImageMessage:
    """Decode an image; raises ValueError."""
    value = decoded(message)

    def read() -> ImageMessage:
        if hasattr(value, "step"):
            size = (int(value.height), int(value.width), int(value.step))
            order = bool(getattr(value, "is_bigendian", False))
            return ImageMessage(_stamp(value), message.topic, value, str(value.encoding), False, *size, order)
        return ImageMessage(_stamp(value), message.topic, value, str(value.format), True)

    return _checked(message, read)


# Calibrations


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationMessage:
    """Calibration of a camera; the first pixel's center is (0, 0)."""

    stamp: Stamp
    width: int
    height: int
    model: str
    """Of distortion: plumb_bob, rational_polynomial, equidistant, ..."""
    distortion: tuple[float, ...]
    matrix: Float64[np.ndarray, "3 3"]
    """K, of the picture as the camera took it."""
    rectified: Float64[np.ndarray, "3 4"]
    """P, of the rectified picture; all 0 if it is not known."""


def read_calibration(message: BagMessage) -> CalibrationMessage:
    """Decode a calibration, of the pixels that are recorded (binning and region applied); raises ValueError."""
    value = decoded(message)

    def read() -> CalibrationMessage:
        d, k, p = (_numbers(value, name) for name in "DKP")
        if k.size != 9 or p.size not in (0, 12):
            raise ValueError(f"has {k.size} numbers in K and {p.size} in P; expected 9 and 12")
        matrix, rectified = k.reshape(3, 3), p.reshape(3, 4) if p.size else np.zeros((3, 4))
        width, height = int(value.width), int(value.height)
        region = getattr(value, "roi", None)
        if region is not None and (region.width or region.height):
            width, height = int(region.width), int(region.height)
            shift = np.array([[1.0, 0, -region.x_offset], [0, 1, -region.y_offset], [0, 0, 1]])
            matrix, rectified = shift @ matrix, shift @ rectified
        bins = [max(int(getattr(value, f"binning_{axis}", 1)), 1) for axis in "xy"]
        if max(bins) > 1:
            centers = [0.5 / each - 0.5 for each in bins]
            shrink = np.array([[1 / bins[0], 0, centers[0]], [0, 1 / bins[1], centers[1]], [0, 0, 1.0]])
            width, height = width // bins[0], height // bins[1]
            matrix, rectified = shrink @ matrix, shrink @ rectified
        model = str(value.distortion_model)
        return CalibrationMessage(_stamp(value), width, height, model, tuple(d.tolist()), matrix, rectified)

    return _checked(message, read)


def _numbers(value: Any, name: str) -> Float64[np.ndarray, " n"]:
    """Numbers of a field, whose name is in lower case in ROS 2."""
    return np.asarray(getattr(value, name, None) or list(getattr(value, name.lower(), ())), np.float64)


# Lidar

_ROS_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_FOXGLOVE_TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}
_INTENSITIES = ("intensity", "intensities", "i", "reflectivity", "reflectance")
_MAX_POINTS = 1 << 26


@dataclass(frozen=True, slots=True, eq=False)
class CloudMessage:
    """Turn of a lidar: points in its own frame."""

    stamp: Stamp
    topic: Topic
    value: Any
    """Object of `decoded`."""
    rows: np.ndarray
    """Structured array of all fields, a point each."""
    height: int
    """Rows of an organized cloud; 1 for a list of points."""
    to_frame: Pose
    """Points to the frame of the stamp: Foxglove's clouds have a pose in it."""

    @property
    def points_m(self) -> Float64[np.ndarray, "p 3"]:
        """Positions; not finite where a beam has no echo."""
        own = np.stack([self.rows[axis].astype(np.float64) for axis in "xyz"], axis=1)
        return own @ self.to_frame[:3, :3].T + self.to_frame[:3, 3]

    @property
    def intensity_field(self) -> str | None:
        names = self.rows.dtype.names or ()
        return next((name for name in _INTENSITIES if name in names), None)

    def rows_at(self, places: Int64[np.ndarray, " m"]) -> np.ndarray:
        """Copy some rows, with the bytes between their fields."""
        content = self.rows.view(np.uint8).reshape(len(self.rows), -1)
        return np.ascontiguousarray(content[places]).view(self.rows.dtype).reshape(-1)

    def with_rows(self, rows: np.ndarray) -> bytes:
        """Encode the message with other rows; an organized cloud keeps its number of them."""
        fields: dict[str, Any] = {"data": _stored_bytes(rows.tobytes(), self.topic)}
        if hasattr(self.value, "row_step"):
            count = len(rows) // self.height
            is_dense = bool(self.value.is_dense) and self.height == 1
            fields |= {"width": count, "row_step": count * rows.dtype.itemsize, "is_dense": is_dense}
        return encoded(_changed(self.value, **fields), self.topic)


def read_cloud(message: BagMessage) -> CloudMessage:
    """Decode a point cloud; raises ValueError, also for one without x, y and z."""
    value = decoded(message)

    def read() -> CloudMessage:
        data = _bytes_of(value.data, message.topic)
        is_ros = hasattr(value, "point_step")
        step = int(value.point_step if is_ros else value.point_stride)
        order = ">" if is_ros and value.is_bigendian else "<"
        dtype = _row_type(value.fields, step, order, _ROS_TYPES if is_ros else _FOXGLOVE_TYPES, is_ros)
        if is_ros:
            height, width, row_step = int(value.height), int(value.width), int(value.row_step)
            if height * width > _MAX_POINTS or row_step < width * step or len(data) < height * row_step:
                raise ValueError(f"says that it has {height}x{width} points of {step} bytes in {len(data)} bytes")
            lines = data[: height * row_step].reshape(height, row_step) if height and row_step else data[:0, None]
            data = np.ascontiguousarray(lines[:, : width * step]).ravel()
            pose = np.eye(4)
        else:
            height, pose = 1, _pose(value.pose.position, value.pose.orientation)
            if len(data) % step or len(data) // step > _MAX_POINTS:
                raise ValueError(f"has {len(data)} bytes, which are no points of {step} bytes")
        rows = np.frombuffer(data.tobytes(), dtype)
        return CloudMessage(_stamp(value), message.topic, value, rows, max(height, 1), pose)

    return _checked(message, read)


def _row_type(fields: Sequence[Any], step: int, order: str, types: Mapping[int, str], is_ros: bool) -> np.dtype[Any]:
    names: list[str] = []
    formats: list[Any] = []
    offsets: list[int] = []
    for each in fields:
        number = int(each.datatype if is_ros else each.type)
        if number not in types:
            raise ValueError(f"its field {each.name!r} has the unknown type {number}")
        form, count = np.dtype(order + types[number]), max(int(getattr(each, "count", 1)), 1)
        names.append(str(each.name))
        formats.append(form if count == 1 else (form, (count,)))
        offsets.append(int(each.offset))
        if not 0 <= offsets[-1] <= offsets[-1] + form.itemsize * count <= step:
            raise ValueError(f"its field {each.name!r} lies outside of the {step} bytes of a point")
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise ValueError(f"has no field {missing[0]!r}")
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})


# Poses


class Transform(NamedTuple):
    """Pose of a frame in its parent at a time."""

    parent: str
    child: str
    time_ns: int
    to_parent: Pose


def read_transforms(message: BagMessage) -> list[Transform]:
    """Decode a message of transforms, or an odometry; raises ValueError."""
    value = decoded(message)

    def read() -> list[Transform]:
        if hasattr(value, "twist"):
            stamp, pose = _stamp(value), value.pose.pose
            to_parent = _pose(pose.position, pose.orientation)
            return [Transform(stamp.frame, _frame(value.child_frame_id), stamp.time_ns, to_parent)]
        found: list[Transform] = []
        for each in getattr(value, "transforms", None) or [value]:
            stamp = _stamp(each)
            if hasattr(each, "transform"):
                pose = _pose(each.transform.translation, each.transform.rotation)
                found.append(Transform(stamp.frame, _frame(each.child_frame_id), stamp.time_ns, pose))
            elif hasattr(each, "parent_frame_id"):
                pose = _pose(each.translation, each.rotation)
                found.append(Transform(_frame(each.parent_frame_id), _frame(each.child_frame_id), stamp.time_ns, pose))
        return found

    return _checked(message, read)


# Boxes


class LabelBox(NamedTuple):
    """Labeled box of a road user, in the frame of its stamp."""

    id: str
    class_name: str
    size_lwh: tuple[float, float, float]
    center_to_frame: Pose


def read_boxes(message: BagMessage) -> tuple[Stamp, list[LabelBox]]:
    """Decode an array of detections; raises ValueError. Those without an id are of a detector, and left out."""
    value = decoded(message)

    def read() -> tuple[Stamp, list[LabelBox]]:
        found: list[LabelBox] = []
        for each in value.detections:
            center, size = each.bbox.center, each.bbox.size
            name = str(each.results[0].hypothesis.class_id) if each.results else ""
            if each.id:
                pose = _pose(center.position, center.orientation)
                found.append(LabelBox(str(each.id), name, (size.x, size.y, size.z), pose))
        return _stamp(value), found

    return _checked(message, read)


def _pose(position: Any, turn: Any) -> Pose:
    return rigid_from_quaternion([turn.w, turn.x, turn.y, turn.z], [position.x, position.y, position.z])


def _checked(message: BagMessage, read: Callable[[], Any]) -> Any:
    """Return what a function reads; turns the errors of unexpected fields into ValueError."""
    try:
        return read()
    except WRONG_VALUES as error:
        raise ValueError(f"not a {message.topic.type}: {what_is_wrong(error)}") from None
