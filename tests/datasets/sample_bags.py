"""The miniature drive as recordings of ROS 2 (written by rosbags) and of Foxglove (written by mcap)."""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mini_drive import FOCAL, HEIGHT, WIDTH, MiniDrive, quaternion

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")
pytest.importorskip("mcap")

STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
TYPES = STORE.types
K = np.array([FOCAL, 0, WIDTH / 2 - 0.5, 0, FOCAL, HEIGHT / 2 - 0.5, 0, 0, 1])
IMAGES, CLOUDS = "/front/image_raw/compressed", "/lidar/points"
CLOUD_FIELDS = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 16, 7), ("ring", 20, 4)]
CLOUD = np.dtype({"names": [name for name, _, _ in CLOUD_FIELDS], "formats": ["<f4"] * 4 + ["<u2"],
                  "offsets": [offset for _, offset, _ in CLOUD_FIELDS], "itemsize": 32})  # fmt: skip


def ros(kind: str, /, **fields: Any) -> Any:
    return TYPES[kind](**fields)


def header(frame: str, seconds: float) -> Any:
    stamp = ros("builtin_interfaces/msg/Time", sec=int(seconds), nanosec=round(seconds % 1 * 1e9))
    return ros("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def transform(parent: str, child: str, pose: np.ndarray, seconds: float) -> Any:
    w, x, y, z = quaternion(pose)
    return ros(
        "geometry_msgs/msg/TransformStamped", header=header(parent, seconds), child_frame_id=child,
        transform=ros(
            "geometry_msgs/msg/Transform",
            translation=ros("geometry_msgs/msg/Vector3", x=pose[0, 3], y=pose[1, 3], z=pose[2, 3]),
            rotation=ros("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        ),
    )  # fmt: skip


def odometry(pose: np.ndarray, seconds: float) -> Any:
    w, x, y, z = quaternion(pose)
    zero = ros("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    place = ros("geometry_msgs/msg/Point", x=pose[0, 3], y=pose[1, 3], z=pose[2, 3])
    turn = ros("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
    return ros(
        "nav_msgs/msg/Odometry", header=header("odom", seconds), child_frame_id="base_link",
        pose=ros("geometry_msgs/msg/PoseWithCovariance", covariance=np.zeros(36),
                 pose=ros("geometry_msgs/msg/Pose", position=place, orientation=turn)),
        twist=ros("geometry_msgs/msg/TwistWithCovariance", covariance=np.zeros(36),
                  twist=ros("geometry_msgs/msg/Twist", linear=zero, angular=zero)),
    )  # fmt: skip


def camera_info(seconds: float, d: tuple[float, ...] = (), model: str = "plumb_bob") -> Any:
    region = ros("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return ros(
        "sensor_msgs/msg/CameraInfo", header=header("front", seconds), height=HEIGHT, width=WIDTH,
        distortion_model=model, d=np.array(d), k=K, r=np.eye(3).ravel(),
        p=np.insert(K.reshape(3, 3), 3, 0, axis=1).ravel(), binning_x=0, binning_y=0, roi=region,
    )  # fmt: skip


def raw_image(pixels: np.ndarray, encoding: str, seconds: float, padding: int = 0) -> Any:
    height, width = pixels.shape[:2]
    rows = np.pad(pixels.reshape(height, -1), ((0, 0), (0, padding)))
    return ros("sensor_msgs/msg/Image", header=header("front", seconds), height=height, width=width,
               encoding=encoding, is_bigendian=0, step=rows.shape[1], data=rows.ravel())  # fmt: skip


def compressed_image(content: bytes, seconds: float, form: str = "jpeg") -> Any:
    return ros("sensor_msgs/msg/CompressedImage", header=header("front", seconds), format=form,
               data=np.frombuffer(content, np.uint8))  # fmt: skip


def cloud_rows(points: np.ndarray, intensity: float = 9.0) -> np.ndarray:
    rows = np.zeros(len(points), CLOUD)
    for k, axis in enumerate("xyz"):
        rows[axis] = points[:, k]
    rows["intensity"], rows["ring"] = intensity, np.arange(len(points)) % 32
    return rows


def cloud(rows: np.ndarray, seconds: float, height: int = 1) -> Any:
    fields = [ros("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=kind, count=1)
              for name, offset, kind in CLOUD_FIELDS]  # fmt: skip
    width = len(rows) // height
    return ros("sensor_msgs/msg/PointCloud2", header=header("lidar", seconds), height=height, width=width,
               fields=fields, is_bigendian=False, point_step=32, row_step=32 * width,
               data=np.frombuffer(rows.tobytes(), np.uint8), is_dense=True)  # fmt: skip


def drive_messages(drive: MiniDrive, poses: str = "tf") -> list[tuple[str, str, float, Any]]:
    """Topic, type, time and message of a drive; `poses` by tf, odometry, or none."""
    start = drive.time(0)
    found: list[tuple[str, str, float, Any]] = []
    sensors = [transform("base_link", "front", drive.camera_to_vehicle, start),
               transform("base_link", "lidar", drive.lidar_to_vehicle, start)]  # fmt: skip
    if poses != "none":
        found.append(("/tf_static", "tf2_msgs/msg/TFMessage", start, ros("tf2_msgs/msg/TFMessage", transforms=sensors)))
    for k in range(drive.samples):
        time, pose = drive.time(k), drive.vehicle_to_world(k)
        if poses == "tf":
            moved = ros("tf2_msgs/msg/TFMessage", transforms=[transform("map", "base_link", pose, time)])
            found.append(("/tf", "tf2_msgs/msg/TFMessage", time, moved))
        if poses == "odometry":
            found.append(("/odom", "nav_msgs/msg/Odometry", time, odometry(pose, time)))
        note = ros("std_msgs/msg/String", data=f"moment {k}")
        found += [
            ("/front/camera_info", "sensor_msgs/msg/CameraInfo", time, camera_info(time)),
            (IMAGES, "sensor_msgs/msg/CompressedImage", time, compressed_image(drive.jpeg(k), time)),
            (CLOUDS, "sensor_msgs/msg/PointCloud2", time, cloud(cloud_rows(drive.lidar_points(k)), time)),
            ("/labels", "std_msgs/msg/String", time, note),
        ]  # fmt: skip
    return found


def write_bag(folder: Path, messages: list[tuple[str, str, float, Any]], storage: str = "mcap") -> Path:
    """Write a ROS 2 bag of MCAP or SQLite (`mcap`, `sqlite3`, `sqlite3-zstd`)."""
    plugin = rosbag2.StoragePlugin.MCAP if storage == "mcap" else rosbag2.StoragePlugin.SQLITE3
    writer = rosbag2.Writer(folder, version=9 if storage == "mcap" else 8, storage_plugin=plugin)
    if storage.endswith("zstd"):
        writer.set_compression(rosbag2.CompressionMode.MESSAGE, rosbag2.CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, seconds, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], round(seconds * 1e9), STORE.serialize_cdr(message, kind))
    return folder


# Foxglove


def write_foxglove(path: Path, drive: MiniDrive, encoding: str = "json", compression: str = "ZSTD") -> Path:
    """Write the drive as messages of Foxglove's schemas (json, protobuf), with metadata and an attachment."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType[compression])
        writer.start(profile="", library="test")
        channels: dict[str, int] = {}
        kinds_of: dict[str, Any] = {}

        def add(topic: str, kind: str, seconds: float, value: dict[str, Any]) -> None:
            names = ("sec", "nsec") if encoding == "json" else ("seconds", "nanos")
            parts = (int(seconds), round(seconds % 1 * 1e9))
            value = {"timestamp": dict(zip(names, parts, strict=True)), **value}
            if encoding == "json" and "data" in value:
                value["data"] = base64.b64encode(value["data"]).decode()
            if topic not in channels:
                schema = "jsonschema", b'{"type": "object"}'
                if encoding == "protobuf":
                    definition, kinds_of[topic] = protobuf_schema(kind, value)
                    schema = "protobuf", definition
                number = writer.register_schema(f"foxglove.{kind}", *schema)
                channels[topic] = writer.register_channel(topic, encoding, number, {"note": topic})
            time = round(seconds * 1e9)
            data = json.dumps(value).encode() if encoding == "json" else kinds_of[topic](**value).SerializeToString()
            writer.add_message(channels[topic], time, data, time + 5, sequence=len(channels))

        for k in range(drive.samples):
            time = drive.time(k)
            for parent, child, pose in (("map", "base_link", drive.vehicle_to_world(k)),
                                        ("base_link", "front", drive.camera_to_vehicle),
                                        ("base_link", "lidar", drive.lidar_to_vehicle)):  # fmt: skip
                value = {"parent_frame_id": parent, "child_frame_id": child, **_posed(pose, "translation", "rotation")}
                add("/tf", "FrameTransform", time, value)
            p = np.insert(K.reshape(3, 3), 3, 0, axis=1).ravel()
            known = {"D": [], "K": K.tolist(), "R": np.eye(3).ravel().tolist(), "P": p.tolist()}
            size = {"width": WIDTH, "height": HEIGHT, "distortion_model": "plumb_bob"}
            add("/front/info", "CameraCalibration", time, {"frame_id": "front", **size, **known})
            content = {"frame_id": "front", "format": "jpeg", "data": drive.jpeg(k)}
            add("/front/image", "CompressedImage", time, content)
            rows = cloud_rows(drive.lidar_points(k))
            kinds = {7: 7, 4: 3}
            fields = [{"name": name, "offset": offset, "type": kinds[kind]} for name, offset, kind in CLOUD_FIELDS]
            points = {"frame_id": "lidar", "pose": _posed(np.eye(4), "position", "orientation"), "point_stride": 32}
            add("/points", "PointCloud", time, {**points, "fields": fields, "data": rows.tobytes()})
        writer.add_metadata("about", {"place": "nowhere"})
        writer.add_attachment(1, 2, "note.txt", "text/plain", b"attached")
        writer.finish()
    return path


def _posed(pose: np.ndarray, place: str, turn: str) -> dict[str, Any]:
    xyz, wxyz = zip("xyz", pose[:3, 3].tolist(), strict=True), zip("wxyz", quaternion(pose), strict=True)
    return {place: dict(xyz), turn: dict(wxyz)}


def protobuf_schema(kind: str, sample: dict[str, Any]) -> tuple[bytes, Any]:
    """FileDescriptorSet of a message like a sample (numbers are doubles, but for counts), and the class of messages."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name=f"{kind}.proto", package="foxglove", syntax="proto3")

    def describe(message: Any, values: dict[str, Any]) -> None:
        for number, (name, value) in enumerate(values.items(), 1):
            repeated = isinstance(value, list)
            one = (value or [0.0])[0] if repeated else value
            field = message.field.add(name=name, number=number, label=3 if repeated else 1)
            if isinstance(one, dict):
                describe(message.nested_type.add(name=f"{name.title()}_"), one)
                field.type, field.type_name = 11, f"{name.title()}_"
            else:
                field.type = {float: 1, int: 5, str: 9, bytes: 12}[type(one)]

    describe(file.message_type.add(name=kind), sample)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    definition = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    return definition, message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{kind}"))
