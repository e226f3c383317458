"""Recordings of ROS 2 and Foxglove as captures: cameras by their calibrations and transforms, lidar, poses."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from ...scene.camera import Camera
from ..capture import (
    EGO_HEIGHT_M,
    Capture,
    CaptureError,
    CaptureFrame,
    Lens,
    LidarSource,
    LidarSweep,
    abbreviated_names,
)
from ..driving_log import DrivingLog, LidarScan
from ..geometry import OPENCV_FROM_VEHICLE_AXES, BoxSample, Pose, camera_of_image, invert_pose, opencv_camera_of_matrix
from .containers import BagMessage, Container, Place, Topic, open_bag
from .messages import (
    CalibrationMessage,
    LabelBox,
    Stamp,
    Transform,
    kind_of,
    read_boxes,
    read_calibration,
    read_cloud,
    read_image,
    read_transforms,
)
from .pixels import colors_of, is_picture, size_of
from .transforms import FrameTree

_VEHICLES = ("base_link", "base_footprint", "ego", "base")
_PICTURE_WORDS = ("compressed", "image", "image_raw", "image_color", "image_rect", "image_rect_color",
                  "image_rect_compressed", "image_raw_compressed", "raw", "rect")  # fmt: skip
"""Last parts of topics that do not tell cameras apart."""

_LABELS = "labels"
"""Last part of topics whose detections are labels: those of others are a detector's."""

_FISHEYES = ("equidistant", "fisheye", "kannala_brandt")
_ROAD_M = 0.0  # in the frame base_link, which is on the ground (REP 105 leaves its height open)


class MessageKey(NamedTuple):
    """Position of a message in a bag."""

    container: int
    place: Place


@dataclass(frozen=True, slots=True, eq=False)
class BagRecording:
    """A bag as a capture, and what each of its messages is there."""

    capture: Capture
    containers: tuple[Container, ...]
    images: Mapping[MessageKey, CaptureFrame]
    """Views of all pictures, also of topics that repeat a camera."""
    clouds: Mapping[MessageKey, LidarSweep]
    untouched: Mapping[Topic, str]
    """Topics of cameras and lidars whose messages are not read, with the reasons."""
    others: tuple[Topic, ...]
    """Topics without images and clouds."""


def read_bag(path: Path) -> Capture:
    """Read an MCAP file, or the folder or a file of a ROS 2 bag. Raises `CaptureError`.

    The world is the root of the tree of frames (map, odom), z up. Without any transforms and odometry, cameras look
    level from the origin.
    """
    return read_bag_recording(path).capture


def read_bag_recording(path: Path) -> BagRecording:
    """Read a bag with the places of its images and clouds. Raises `CaptureError`."""
    contents = _Contents(tuple(open_bag(path)))
    contents.collect()
    return _Reader(path, contents).recording()


# First pass: everything but pixels and points


class _Recorded(NamedTuple):
    key: MessageKey
    stamp: Stamp


@dataclass(slots=True, eq=False)
class _Contents:
    containers: tuple[Container, ...]
    tree: FrameTree = field(default_factory=FrameTree)
    calibrations: dict[Topic, CalibrationMessage] = field(default_factory=dict[Topic, CalibrationMessage])
    images: dict[Topic, list[_Recorded]] = field(default_factory=dict[Topic, list[_Recorded]])
    sizes: dict[Topic, tuple[int, int]] = field(default_factory=dict[Topic, tuple[int, int]])
    """Size of a topic's first image."""
    clouds: dict[Topic, list[_Recorded]] = field(default_factory=dict[Topic, list[_Recorded]])
    boxes: list[tuple[Stamp, list[LabelBox]]] = field(default_factory=list[tuple[Stamp, list[LabelBox]]])
    untouched: dict[Topic, str] = field(default_factory=dict[Topic, str])
    others: set[Topic] = field(default_factory=set[Topic])
    faults: dict[Topic, list[str]] = field(default_factory=lambda: defaultdict[Topic, list[str]](list))
    problems: list[str] = field(default_factory=list[str])
    odometry: list[BagMessage] = field(default_factory=list[BagMessage])

    def collect(self) -> None:
        for number, container in enumerate(self.containers):
            try:
                for message in container.messages():
                    kind = kind_of(message.topic)
                    if kind not in ("image", "cloud"):
                        self.others.add(message.topic)
                    if kind is None:
                        self._leave(message.topic)
                        continue
                    try:
                        self._add(kind, message, MessageKey(number, message.place))
                    except ValueError as error:
                        self.faults[message.topic].append(str(error))
            except CaptureError as error:
                if not self.images and not self.clouds:
                    raise
                self.problems.append(f"{error}; what comes before is used")
        self._add_odometry()
        for topic, reasons in self.faults.items():
            count = f"{len(reasons)} messages of {topic.name}" if len(reasons) > 1 else f"a message of {topic.name}"
            self.problems.append(f"{count} left out: {reasons[0]}")
        self.problems += [f"{topic.name} left out: {reason}" for topic, reason in self.untouched.items()]
        for child, parents in self.tree.conflicts.items():
            self.problems.append(f"the frame {child!r} has several parents; {', '.join(sorted(parents))} are ignored")

    def _leave(self, topic: Topic) -> None:
        words = topic.type.lower()
        if any(word in words for word in ("image", "video", "pointcloud", "packet", "scan")):
            self.untouched[topic] = f"messages of {topic.type} ({topic.encoding}) are not read"

    def _add(self, kind: str, message: BagMessage, key: MessageKey) -> None:
        topic = message.topic
        if kind == "transforms":
            self.tree.add(read_transforms(message), is_static=topic.name.endswith("tf_static"))
        elif kind == "pose":
            self.odometry.append(message)
        elif kind == "boxes":
            if topic.name.rpartition("/")[2] == _LABELS:
                stamp, found = read_boxes(message)
                self.boxes.append((_timed(stamp, message), found))
        elif kind == "calibration":
            found = read_calibration(message)
            self.calibrations.setdefault(topic, found)
        elif kind == "cloud":
            recorded = _Recorded(key, _timed(read_cloud(message).stamp, message))
            self.clouds.setdefault(topic, []).append(recorded)
        elif topic not in self.untouched:
            image = read_image(message)
            if not is_picture(image):
                self.untouched[topic] = f"pictures of {image.encoding} are not read"
                return
            if topic not in self.sizes:
                self.sizes[topic] = size_of(image)
            self.images.setdefault(topic, []).append(_Recorded(key, _timed(image.stamp, message)))

    def _add_odometry(self) -> None:
        """Add the odometries above the root of their frame's tree, except where transforms tell the same."""
        above: list[Transform] = []
        for message in self.odometry:
            try:
                for each in read_transforms(message):
                    if not each.child:
                        raise ValueError("an odometry without the name of its child frame")
                    chain = self.tree.chain(each.child)
                    if each.parent not in chain:
                        below = self.tree.pose(each.child, chain[-1], each.time_ns)
                        above.append(each._replace(child=chain[-1], to_parent=each.to_parent @ invert_pose(below)))
            except ValueError as error:
                self.faults[message.topic].append(str(error))
        self.tree.add(above, is_static=False)


def _timed(stamp: Stamp, message: BagMessage) -> Stamp:
    """Return the stamp, with the time of the recording if it has none."""
    return stamp if stamp.time_ns else stamp._replace(time_ns=message.time_ns)


# Cameras


def _calibration_of(
    topic: Topic, frame: str, calibrations: Mapping[Topic, CalibrationMessage]
) -> CalibrationMessage | None:
    """Calibration of an image topic: of its frame, and of the most similar name."""
    same = [each for each, found in calibrations.items() if found.stamp.frame == frame]
    near = same or [each for each in calibrations if each.name.rpartition("/")[0] == topic.name.rpartition("/")[0]]
    if not near:
        return None
    parts = topic.name.split("/")
    return calibrations[max(near, key=lambda each: _common_parts(each.name.split("/"), parts))]


def _common_parts(first: Sequence[str], second: Sequence[str]) -> int:
    """Number of equal parts from the start."""
    return next((k for k, pair in enumerate(zip(first, second, strict=False)) if pair[0] != pair[1]), len(first))


def _is_rectified(topic: Topic) -> bool:
    return "rect" in topic.name.rsplit("/", 2)[-1] or "/image_rect" in topic.name


def _camera(known: CalibrationMessage, rectified: bool, size: tuple[int, int], name: str) -> tuple[Camera, Lens | None]:
    """Camera at the origin and its lens; raises ValueError."""
    has_rectified = rectified and known.rectified[0, 0] > 0
    matrix = known.rectified if has_rectified else known.matrix
    own = (known.width, known.height) if known.width and known.height else size
    camera = camera_of_image(opencv_camera_of_matrix(matrix, own, np.eye(4)), size, name)
    if rectified or not any(known.distortion):
        return camera, None
    if known.model in _FISHEYES:
        return camera, Lens("fisheye", known.distortion[:4])
    if known.model not in ("plumb_bob", "rational_polynomial", "radtan", ""):
        raise ValueError(f"its lens has the unknown model {known.model!r}")
    return camera, Lens("opencv", known.distortion)


def _short_name(topic: Topic) -> str:
    """Name of a camera or lidar by its topic, without what all such topics end on."""
    parts = [part for part in topic.name.split("/") if part]
    while len(parts) > 1 and parts[-1] in _PICTURE_WORDS:
        parts.pop()
    return "_".join(parts) or "camera"


# Second pass


class _Reader:
    def __init__(self, path: Path, contents: _Contents) -> None:
        self.path, self.contents, self.tree = path, contents, contents.tree
        self.untouched = dict(contents.untouched)
        self.log = DrivingLog(path.stem if path.is_file() else path.resolve().name, road_m=_ROAD_M)
        self.log.problems = contents.problems
        self.keys: dict[str, MessageKey] = {}

    def recording(self) -> BagRecording:
        frames = [
            recorded[0].stamp.frame for recorded in (*self.contents.images.values(), *self.contents.clouds.values())
        ]
        chains = [self._chain(frame) for frame in frames]
        roots = [chain[-1] for chain in chains if len(chain) > 1]
        world = max(dict.fromkeys(roots), key=roots.count, default=None)
        vehicle = None if world is None else self._vehicle([chain for chain in chains if chain[-1] == world], world)
        primary = self._add_views(world)
        if not self.log.views:
            raise CaptureError(f"{self.path}: no picture that can be used{self._because()}")
        if world is None or vehicle is None:
            self.log.problems.append(
                "has no transforms (/tf) and no odometry: cameras have no poses, good for rain on pictures and lidar, "
                "not for a reconstruction"
            )
            capture = self._without_poses()
        else:
            self.log.road_m = -EGO_HEIGHT_M if self._is_camera(vehicle) else _ROAD_M
            self._add_stamps(vehicle, world)
            self._add_boxes(world)
            recorded = self._clouds()
            self.log.scans, self.log.scan_count = self._scans(recorded, vehicle, world), len(recorded)
            capture = self.log.capture()
        images = {self.keys[view.name]: view for view in capture}
        clouds = {
            sweep.source.key: sweep
            for sweep in capture.sweeps
            if sweep.source is not None and isinstance(sweep.source.key, MessageKey)
        }
        shown = replace(capture, views=tuple(view for view in capture if view.name in primary))
        others = sorted(self.contents.others - self.untouched.keys(), key=lambda topic: topic.name)
        return BagRecording(shown, self.contents.containers, images, clouds, self.untouched, tuple(others))

    def _because(self) -> str:
        """Reason why a bag has no pictures, for the end of an error: the last problem, or else its topics."""
        if self.log.problems:
            return f" ({self.log.problems[-1]})"
        topics = sorted({f"{topic.name} ({topic.type})" for topic in (*self.contents.others, *self.contents.clouds)})
        return f": its topics are {abbreviated_names(topics)}" if topics else ": it holds no messages"

    def _chain(self, frame: str) -> list[str]:
        try:
            return self.tree.chain(frame)
        except ValueError as error:
            raise CaptureError(f"{self.path}: {error}") from None

    def _vehicle(self, chains: Sequence[Sequence[str]], world: str) -> str:
        """Frame that carries the sensors: of a well-known name, else the nearest that moves, else the root."""
        known = next((name for name in _VEHICLES if name in self.tree and self._chain(name)[-1] == world), None)
        if known is not None:
            return known
        moving = [frame for chain in chains if (frame := self.tree.moving_frame(chain[0])) is not None]
        if moving:
            return max(dict.fromkeys(moving), key=moving.count)
        return world

    def _add_views(self, world: str | None) -> set[str]:
        """Add the views of all pictures; returns the names of one topic's for each camera."""
        by_camera: dict[tuple[str, int], list[Topic]] = defaultdict(list)
        names: dict[Topic, list[str]] = {}
        sensors: dict[str, Topic] = {}
        for topic, recorded in self.contents.images.items():
            with self.log.omitting(topic.name):
                known = _calibration_of(topic, recorded[0].stamp.frame, self.contents.calibrations)
                if known is None:
                    self.untouched[topic] = "no calibration (CameraInfo) of it is recorded"
                    raise ValueError(self.untouched[topic])
                camera, lens = _camera(known, _is_rectified(topic), self.contents.sizes[topic], topic.name)
                sensor = _short_name(topic)
                while sensor in sensors:
                    sensor = f"{sensor}_{topic.name.rpartition('/')[2]}"
                sensors[sensor] = topic
                names[topic] = list(self._views(topic, recorded, camera, lens, sensor, world))
                by_camera[recorded[0].stamp.frame, id(known)].append(topic)
        shown: set[str] = set()
        for topics in by_camera.values():
            first = min(topics, key=lambda topic: (-len(names[topic]), "compressed" in topic.name, topic.name))
            shown |= set(names[first])
            if topics[1:]:
                others = ", ".join(topic.name for topic in topics if topic != first)
                self.log.problems.append(f"{first.name} is read; {others} are of the same camera")
        self.log.views.sort(key=lambda view: (view.time_s, view.sensor))
        return shown

    def _views(
        self,
        topic: Topic,
        recorded: Sequence[_Recorded],
        camera: Camera,
        lens: Lens | None,
        sensor: str,
        world: str | None,
    ) -> Iterator[str]:
        faults: list[str] = []
        for number, each in enumerate(sorted(recorded, key=lambda one: one.stamp.time_ns)):
            try:
                posed = camera.moved(self._sensor_to_world(each.stamp, world, level=True))
            except ValueError as error:
                faults.append(str(error))
                continue
            name = f"{number:04d}_{sensor}"
            source = partial(_read_colors, self.contents.containers[each.key.container], topic, each.key.place)
            self.keys[name] = each.key
            self.log.views.append(CaptureFrame(name, posed, source, each.stamp.time_ns * 1e-9, sensor, lens))
            yield name
        if faults:
            self.log.problems.append(f"{len(faults)} pictures of {topic.name} left out: {faults[0]}")

    def _sensor_to_world(self, stamp: Stamp, world: str | None, *, level: bool = False) -> Pose:
        """Pose of a sensor; without a world level cameras (`level`) look along +x from the origin."""
        if world is None:
            return invert_pose(OPENCV_FROM_VEHICLE_AXES) if level else np.eye(4)
        return self.tree.pose(stamp.frame, world, stamp.time_ns)

    def _add_stamps(self, vehicle: str, world: str) -> None:
        """Add the vehicle's poses at its own times, or that of the first view if it stands."""
        times = [round(view.time_s * 1e9) for view in self.log.views]
        chain = self.tree.chain(vehicle)
        if len(chain) > 1 and self.tree.moving_frame(vehicle) == vehicle:
            own = self.tree.times_ns(vehicle)
            margin = 10**9
            own = own[(own >= min(times) - margin) & (own <= max(times) + margin)]
            times = [*own.tolist(), *times]
        for time_ns in dict.fromkeys(times):
            try:
                self.log.stamps.append((time_ns * 1e-9, self._vehicle_to_world(vehicle, world, time_ns)))
            except ValueError:  # other frames of the chain may begin later
                continue

    def _add_boxes(self, world: str) -> None:
        for stamp, boxes in self.contents.boxes:
            with self.log.omitting("boxes"):
                to_world = self.tree.pose(stamp.frame, world, stamp.time_ns)
                self.log.box_times_s.append(stamp.time_ns * 1e-9)
                for each in boxes:
                    pose = to_world @ each.center_to_frame
                    box = BoxSample(each.id, each.class_name, stamp.time_ns * 1e-9, each.size_lwh, pose)
                    self.log.boxes.append(box)

    def _vehicle_to_world(self, vehicle: str, world: str, time_ns: int) -> Pose:
        """Pose of x forward, y left, z up; a camera that is the vehicle itself has other axes."""
        pose = self.tree.pose(vehicle, world, time_ns)
        return pose @ OPENCV_FROM_VEHICLE_AXES if self._is_camera(vehicle) else pose

    def _is_camera(self, frame: str) -> bool:
        return any(recorded[0].stamp.frame == frame for recorded in self.contents.images.values())

    def _clouds(self) -> list[tuple[Topic, _Recorded]]:
        found = [(topic, each) for topic, recorded in self.contents.clouds.items() for each in recorded]
        return sorted(found, key=lambda pair: pair[1].stamp.time_ns)

    def _scans(self, recorded: Sequence[tuple[Topic, _Recorded]], vehicle: str, world: str) -> Iterator[LidarScan]:
        for topic, each in recorded:
            with self.log.omitting(f"a cloud of {topic.name}"):
                points, light = self._points(topic, each)
                to_world = self._sensor_to_world(each.stamp, world)
                of_vehicle = self._vehicle_to_world(vehicle, world, each.stamp.time_ns)
                yield LidarScan.placed(
                    each.stamp.time_ns * 1e-9, of_vehicle, invert_pose(of_vehicle) @ to_world, points, light, each.key
                )

    def _points(self, topic: Topic, each: _Recorded) -> tuple[np.ndarray, np.ndarray | None]:
        """Finite points in the frame of the stamp, and their intensities."""
        data = self.contents.containers[each.key.container].read(each.key.place)
        cloud = read_cloud(BagMessage(topic, each.key.place, 0, data))
        points = cloud.points_m
        finite = np.isfinite(points).all(axis=1)
        name = cloud.intensity_field
        return points[finite], None if name is None else cloud.rows[name][finite].astype(np.float32)

    def _without_poses(self) -> Capture:
        """Capture of level cameras and lidars, all at the origin."""
        start = min(view.time_s for view in self.log.views)
        sweeps: list[LidarSweep] = []
        for topic, each in self._clouds():
            with self.log.omitting(f"a cloud of {topic.name}"):
                points, light = self._points(topic, each)
                scan = LidarScan(each.stamp.time_ns * 1e-9, np.eye(4), points, np.zeros(3), light)
                time_s = round(scan.time_s - start, 6)
                source = LidarSource(each.key, np.eye(4))
                sweeps.append(LidarSweep(time_s, points.astype(np.float32), np.zeros(3), light, source))
        views = tuple(replace(view, time_s=round(view.time_s - start, 6)) for view in self.log.views)
        problems = tuple(self.log.problems)
        return Capture(self.log.name, views, sweeps=tuple(sweeps), has_poses=False, problems=problems)


def _read_colors(container: Container, topic: Topic, place: Place) -> UInt8[np.ndarray, "h w 3"]:
    try:
        return colors_of(read_image(BagMessage(topic, place, 0, container.read(place))))
    except CaptureError:
        raise
    except ValueError as error:
        raise CaptureError(f"{container.path}: {topic.name}: {error}") from None
