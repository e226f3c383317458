"""Roll-outs as bags of ROS 2 (MCAP): transforms, odometry, camera images, lidar, and road users as labels.

Facts: the .msg files of github.com/ros2/common_interfaces, ros2/geometry2 and ros-perception/vision_msgs; REP 103, 105.
"""

import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32, Float64
from scipy.spatial.transform import Rotation

from gsrain_engine.datasets.bags.messages import ros_types
from gsrain_engine.optional_packages import require_package
from gsrain_engine.safe_io.files import whole_folder
from gsrain_engine.simulation.drive_exports import DriveExport, FinishedDrive
from gsrain_engine.simulation.lidar_turns import LidarTurnInRain, ego_pose, upright_pose
from gsrain_engine.simulation.rollout import CameraImage, Rollout, RolloutStep, UserModel, UserRecord

MAP, VEHICLE, LIDAR = "map", "base_link", "lidar"
"""Frames: the scene's world; the ego vehicle on the ground below its rear axle; the lidar's."""

_JPEG_QUALITY = 95


def write_rollout_bag(
    folder: Path, rollout: Rollout, pictures: Iterable[CameraImage] = (), turns: Iterable[LidarTurnInRain] = ()
) -> None:
    """Write a roll-out as a bag of ROS 2 atomically; the same input gives the same bytes.

    Times are those of the simulation, from 0. Topics: /tf, /tf_static, /odom, /labels (vision_msgs/Detection3DArray),
    /labels/markers (for RViz and Foxglove), for each camera /camera/NAME/image/compressed and /camera/NAME/camera_info,
    and /lidar/points. `pictures` and `turns` are in the order of steps (all pictures of a camera, then of the next) and
    are consumed lazily. An earlier bag at `folder` is replaced.

    Raises `MissingPackageError` without rosbags, and ValueError for an image without a step.
    """
    require_package("rosbags", "a bag of ROS 2")
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = ros_types()
    if (folder / "metadata.yaml").is_file():
        shutil.rmtree(folder)
    with whole_folder(folder) as whole:
        with Writer(whole / folder.stem, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            _BagWriter(writer, store, rollout).write(pictures, turns)
        for file in (whole / folder.stem).iterdir():
            file.rename(whole / file.name)
        (whole / folder.stem).rmdir()


Message = Any


class _BagWriter:
    def __init__(self, writer: Any, store: Any, rollout: Rollout) -> None:
        self._writer, self._store, self._rollout = writer, store, rollout
        self._steps = {step.step: step for step in rollout.steps}
        self._vehicle = rollout.vehicle
        self._connections: dict[str, Any] = {}

    def write(self, pictures: Iterable[CameraImage], turns: Iterable[LidarTurnInRain]) -> None:
        for step in self._rollout.steps:
            self._step(step)
        mounted: set[str] = set()
        for picture in pictures:
            step = self._of(picture.step, "picture")
            if picture.name not in mounted:
                mounted.add(picture.name)
                self._static(step, picture.name, picture.camera.camera_to_world)
            self._image(step, picture)
        for number, turn in enumerate(turns):
            step = self._of(turn.step, "lidar turn")
            if number == 0:
                self._static(step, LIDAR, turn.sensor_to_world)
            self._add(step, "/lidar/points", "sensor_msgs/msg/PointCloud2", self._cloud(step, turn))

    def _of(self, number: int, what: str) -> RolloutStep:
        if number not in self._steps:
            raise ValueError(f"{what} of step {number}: expected one of {min(self._steps)}..{max(self._steps)}")
        return self._steps[number]

    def _step(self, step: RolloutStep) -> None:
        pose, ego = ego_pose(step), step.ego
        transforms = self._new("tf2_msgs/msg/TFMessage", transforms=[self._transform(step, MAP, VEHICLE, pose)])
        self._add(step, "/tf", "tf2_msgs/msg/TFMessage", transforms)
        twist = self._new("geometry_msgs/msg/Twist", linear=self._vector(ego.speed_m_s, 0.0, 0.0),
                          angular=self._vector(0.0, 0.0, ego.yaw_rate_rad_s))  # fmt: skip
        odometry = self._new(
            "nav_msgs/msg/Odometry",
            header=self._header(step, MAP),
            child_frame_id=VEHICLE,
            pose=self._exact_pose(pose),
            twist=self._new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )
        self._add(step, "/odom", "nav_msgs/msg/Odometry", odometry)
        users = [(user, self._rollout.users[user.id]) for user in step.road_users]
        detections = [self._detection(step, *each) for each in users]
        labels = self._new("vision_msgs/msg/Detection3DArray", header=self._header(step, MAP), detections=detections)
        self._add(step, "/labels", "vision_msgs/msg/Detection3DArray", labels)
        markers = [self._marker(step, number, *each) for number, each in enumerate(users)]
        cleared = self._cleared(step)
        array = self._new("visualization_msgs/msg/MarkerArray", markers=[cleared, *markers])
        self._add(step, "/labels/markers", "visualization_msgs/msg/MarkerArray", array)

    def _static(self, step: RolloutStep, frame: str, to_world: Float64[np.ndarray, "4 4"]) -> None:
        mounted = np.linalg.inv(ego_pose(step)) @ to_world
        transforms = [self._transform(step, VEHICLE, frame, mounted)]
        kind = "tf2_msgs/msg/TFMessage"
        self._add(step, "/tf_static", kind, self._new(kind, transforms=transforms), latched=True)

    def _image(self, step: RolloutStep, picture: CameraImage) -> None:
        name, camera, header = picture.name, picture.camera, self._header(step, picture.name)
        k = np.array([camera.fx, 0, camera.cx - 0.5, 0, camera.fy, camera.cy - 0.5, 0, 0, 1.0])
        info = self._new(
            "sensor_msgs/msg/CameraInfo", header=header, height=camera.height, width=camera.width,
            distortion_model="plumb_bob", d=np.zeros(5), k=k, r=np.eye(3).ravel(),
            p=np.insert(k.reshape(3, 3), 3, 0, axis=1).ravel(), binning_x=0, binning_y=0,
            roi=self._new("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0,
                          do_rectify=False),
        )  # fmt: skip
        self._add(step, f"/camera/{name}/camera_info", "sensor_msgs/msg/CameraInfo", info)
        bgr = np.ascontiguousarray(picture.image[..., ::-1])
        _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        data = np.asarray(encoded, np.uint8).ravel()
        image = self._new("sensor_msgs/msg/CompressedImage", header=header, format="jpeg", data=data)
        self._add(step, f"/camera/{name}/image/compressed", "sensor_msgs/msg/CompressedImage", image)

    def _cloud(self, step: RolloutStep, turn: LidarTurnInRain) -> Message:
        sweep = turn.scan.sweep
        back = np.linalg.inv(turn.sensor_to_world)
        points = sweep.points_m.astype(np.float64) @ back[:3, :3].T + back[:3, 3]
        rows: Float32[np.ndarray, "p 4"] = np.zeros((len(points), 4), np.float32)
        rows[:, :3] = points
        if sweep.intensities is not None:
            rows[:, 3] = np.clip(sweep.intensities, 0.0, 1.0)  # beyond 1 another scale would be guessed
        fields = [
            self._new("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=7, count=1)
            for k, name in enumerate(("x", "y", "z", "intensity"))
        ]
        return self._new(
            "sensor_msgs/msg/PointCloud2", header=self._header(step, LIDAR), height=1, width=len(rows), fields=fields,
            is_bigendian=False, point_step=16, row_step=16 * len(rows), is_dense=True,
            data=np.frombuffer(rows.astype("<f4").tobytes(), np.uint8),
        )  # fmt: skip

    # Labels

    def _detection(self, step: RolloutStep, user: UserRecord, model: UserModel) -> Message:
        pose = user_pose(user, model)
        hypothesis = self._new("vision_msgs/msg/ObjectHypothesis", class_id=model.class_name, score=1.0)
        result = self._new(
            "vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=hypothesis, pose=self._exact_pose(pose)
        )
        box = self._new("vision_msgs/msg/BoundingBox3D", center=self._pose(pose), size=self._vector(*model.size_lwh_m))
        header = self._header(step, MAP)
        return self._new("vision_msgs/msg/Detection3D", header=header, results=[result], bbox=box, id=user.id)

    def _marker(self, step: RolloutStep, number: int, user: UserRecord, model: UserModel) -> Message:
        return self._marker_of(step, number, model.class_name, user_pose(user, model), model.size_lwh_m, 0, user.id)

    def _cleared(self, step: RolloutStep) -> Message:
        """Marker that deletes those of the step before (DELETEALL)."""
        return self._marker_of(step, 0, "", np.eye(4), (0.0, 0.0, 0.0), 3, "")

    def _marker_of(
        self,
        step: RolloutStep,
        number: int,
        group: str,
        pose: Float64[np.ndarray, "4 4"],
        size_m: Sequence[float],
        action: int,
        text: str,
    ) -> Message:
        color = self._new("std_msgs/msg/ColorRGBA", r=0.85, g=0.55, b=0.2, a=0.6)
        uv = self._new("sensor_msgs/msg/CompressedImage", header=self._header(step, ""), format="",
                       data=np.zeros(0, np.uint8))  # fmt: skip
        mesh = self._new("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8))
        lifetime = self._new("builtin_interfaces/msg/Duration", sec=0, nanosec=0)
        return self._new(
            "visualization_msgs/msg/Marker", header=self._header(step, MAP), ns=group, id=number, type=1, action=action,
            pose=self._pose(pose), scale=self._vector(*size_m), color=color, lifetime=lifetime, frame_locked=False,
            points=[], colors=[], texture_resource="", texture=uv, uv_coordinates=[], text=text, mesh_resource="",
            mesh_file=mesh, mesh_use_embedded_materials=False,
        )  # fmt: skip

    # Parts of messages

    def _add(self, step: RolloutStep, topic: str, kind: str, message: Message, *, latched: bool = False) -> None:
        if topic not in self._connections:
            more = {"offered_qos_profiles": [_latched_qos()]} if latched else {}
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store, **more)
        data = self._store.serialize_cdr(message, kind)
        self._writer.write(self._connections[topic], round(step.time_s * 1e9), data)

    def _new(self, kind: str, /, **fields: Any) -> Message:
        return self._store.types[kind](**fields)

    def _header(self, step: RolloutStep, frame: str) -> Message:
        seconds, nanoseconds = divmod(round(step.time_s * 1e9), 1_000_000_000)
        stamp = self._new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        return self._new("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _vector(self, x: float, y: float, z: float) -> Message:
        return self._new("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def _turn(self, pose: Float64[np.ndarray, "4 4"]) -> Message:
        x, y, z, w = (float(each) for each in Rotation.from_matrix(pose[:3, :3]).as_quat())
        return self._new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def _pose(self, pose: Float64[np.ndarray, "4 4"]) -> Message:
        x, y, z = (float(each) for each in pose[:3, 3])
        place = self._new("geometry_msgs/msg/Point", x=x, y=y, z=z)
        return self._new("geometry_msgs/msg/Pose", position=place, orientation=self._turn(pose))

    def _exact_pose(self, pose: Float64[np.ndarray, "4 4"]) -> Message:
        return self._new("geometry_msgs/msg/PoseWithCovariance", pose=self._pose(pose), covariance=np.zeros(36))

    def _transform(self, step: RolloutStep, parent: str, child: str, pose: Float64[np.ndarray, "4 4"]) -> Message:
        translation = self._vector(*(float(each) for each in pose[:3, 3]))
        transform = self._new("geometry_msgs/msg/Transform", translation=translation, rotation=self._turn(pose))
        return self._new(
            "geometry_msgs/msg/TransformStamped", header=self._header(step, parent), child_frame_id=child,
            transform=transform,
        )  # fmt: skip


def user_pose(user: UserRecord, model: UserModel) -> Float64[np.ndarray, "4 4"]:
    """Pose of the center of a road user's box in the world."""
    return upright_pose(user.x_m, user.y_m, user.z_m + model.size_lwh_m[2] / 2, user.yaw_rad)


def _latched_qos() -> Any:
    """Quality of service of /tf_static: kept for those who subscribe later."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )  # fmt: skip

    forever = QosTime(2147483647, 4294967295)
    return Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, forever, forever,
        QosLiveliness.AUTOMATIC, forever, False,
    )  # fmt: skip


def _export(drive: FinishedDrive, path: Path) -> None:
    write_rollout_bag(path, drive.rollout, drive.camera_images(), drive.lidar_turns())


EXPORT = DriveExport((".ros2",), _export, packages=("rosbags",), is_folder=True, cameras="all", lidar=True)
