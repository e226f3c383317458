"""Waymo Perception, both releases: TFRecord files of frames (v1), and folders of Parquet files (v2)."""

import zlib
from collections import defaultdict
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from ..kernels import kernel
from ..optional_packages import MissingPackageError, require_package
from ..scene.camera import DEFAULT_EXPOSURE_S, Camera
from ..scene.lens import Lens
from .capture import Capture, CaptureError, CaptureFrame, abbreviated_names
from .driving_log import DrivingLog, LidarScan
from .geometry import OPENCV_FROM_VEHICLE_AXES, BoxSample, Pose, heading_pose, invert_pose, rigid_from_numbers
from .io.arrays import WRONG_VALUES, what_is_wrong
from .io.images import opened_image
from .io.records import ParquetFile, TFRecord, records_in

WAYMO_CAMERAS = {
    1: "FRONT",
    2: "FRONT_LEFT",
    3: "FRONT_RIGHT",
    4: "SIDE_LEFT",
    5: "SIDE_RIGHT",
    6: "REAR_LEFT",
    7: "REAR",
    8: "REAR_RIGHT",
}
_LASERS = {1: "TOP", 2: "FRONT", 3: "SIDE_LEFT", 4: "SIDE_RIGHT", 5: "REAR"}
_CLASSES = {1: "vehicle", 2: "pedestrian", 3: "sign", 4: "cyclist"}
_US = 1e-6
_LONGEST_EXPOSURE_S = 1.0
_Cloud = tuple[Float64[np.ndarray, "p 3"], Float32[np.ndarray, " p"]]
"""Points in the vehicle's frame (m), and intensities."""

# First release: one TFRecord file of frames for each segment of a drive

_SUFFIXES = (".tfrecord", ".tfrecords")
_OTHERS = "of another data set, such as Waymo Motion"


def recognizes_waymo_records(path: Path) -> bool:
    return path.suffix in _SUFFIXES if path.is_file() else bool(_record_files(path))


def read_waymo_records(path: Path) -> Capture:
    """Read one segment, or the first file of a folder. Raises `CaptureError` if no frame is readable."""
    files = waymo_record_files(path)
    if not files:
        raise CaptureError(f"{path}: no .tfrecord in it")
    segment = _RecordSegment(DrivingLog(files[0].stem, road_m=0.0))
    if files[1:]:
        segment.log.problems.append(f"{files[0].name} is read; open one of the other {len(files) - 1} by its name")
    return segment.capture(files[0])


def waymo_record_files(path: Path) -> list[Path]:
    """Files of records in a folder, of which the first is read; or the file itself."""
    return [path] if path.is_file() else _record_files(path)


def _record_files(folder: Path) -> list[Path]:
    found = sorted(folder.iterdir()) if folder.is_dir() else []
    return [file for file in found if file.suffix in _SUFFIXES]


class _RecordSegment:
    def __init__(self, log: DrivingLog) -> None:
        self.log, self.name, self.frames_with_lidar = log, "", 0
        self.frames: list[tuple[TFRecord, float, Pose]] = []
        self.lasers: dict[int, WaymoLaser] = {}

    def capture(self, file: Path) -> Capture:
        try:
            for number, (record, content) in enumerate(records_in(file)):
                self._read_frame(record, parsed("Frame", content), number)
        except CaptureError as error:
            if not self.log.views:
                raise CaptureError(str(error) if file.name in str(error) else f"{file}: {error}") from None
            self.log.problems.append(f"{error}; the {len(self.frames)} frames before are used")
        if not self.frames:
            raise CaptureError(f"{file}: no frame of Waymo Perception in it: it may be {_OTHERS}")
        self.log.name = self.name or file.stem
        self.log.stamps = self.log.stamps or [(time, pose) for _, time, pose in self.frames]
        self.log.scans, self.log.scan_count = self._scans(), self.frames_with_lidar
        return self.log.capture()

    def _read_frame(self, record: TFRecord, frame: Any, number: int) -> None:
        name = _text(frame.context.name)
        if self.name and name != self.name:
            self.log.problems.append(f"frame {number} left out: it is of another segment ({name})")
            return
        self.name = name
        with self.log.omitting(f"frame {number}"):
            pose = rigid_from_numbers(frame.pose.transform)
            time = frame.timestamp_micros * _US
            self.frames.append((record, time, pose))
            self.log.box_times_s.append(time)
            self._add_views(record, frame, number)
            self._add_boxes(frame, time, pose, number)
            if any(laser.ri_return1.range_image_compressed for laser in frame.lasers):
                self.frames_with_lidar += 1
                for each in frame.context.laser_calibrations:
                    if each.name not in self.lasers:
                        named = _LASERS.get(each.name, str(each.name))
                        with self.log.omitting(f"the calibration of lidar {named} in frame {number}"):
                            self.lasers[each.name] = WaymoLaser.of_record(each)

    def _add_views(self, record: TFRecord, frame: Any, number: int) -> None:
        calibrations = {each.name: each for each in frame.context.camera_calibrations}
        for image in sorted(frame.images, key=lambda image: image.name):
            sensor = WAYMO_CAMERAS.get(image.name, f"CAMERA_{image.name}")
            with self.log.omitting(f"{sensor} of frame {number}"):
                if image.name not in calibrations:
                    raise ValueError("its calibration is missing")
                known = calibrations[image.name]
                to_vehicle = rigid_from_numbers(known.extrinsic.transform)
                camera = WaymoCamera(sensor, tuple(known.intrinsic), to_vehicle, known.width, known.height)
                _check_jpeg(image.image, (camera.width, camera.height))
                pose, time = rigid_from_numbers(image.pose.transform), image.pose_timestamp
                jpeg = partial(_record_jpeg, record, image.name)
                self.log.views.append(camera.view(f"{number:04d}_{sensor}", pose, time, image.shutter, jpeg))
                self.log.stamps.append((time, pose))

    def _add_boxes(self, frame: Any, time_s: float, pose: Pose, number: int) -> None:
        for label in frame.laser_labels:
            with self.log.omitting(f"a box of frame {number}"):
                box, name = label.box, _CLASSES.get(label.type, "unknown")
                to_world = pose @ heading_pose((box.center_x, box.center_y, box.center_z), box.heading)
                size = (box.length, box.width, box.height)
                self.log.boxes.append(BoxSample(_text(label.id), name, time_s, size, to_world))

    def _scans(self) -> Iterator[LidarScan]:
        for number, (record, time, pose) in enumerate(self.frames if self.frames_with_lidar else ()):
            clouds: list[_Cloud] = []
            for laser in parsed("Frame", record.read()).lasers:
                named = _LASERS.get(laser.name, str(laser.name))
                with self.log.omitting(f"lidar {named} of frame {number}", (ValueError, zlib.error)):
                    poses = None
                    for image in (laser.ri_return1, laser.ri_return2):
                        if not image.range_image_compressed:
                            continue
                        if laser.name not in self.lasers:
                            raise ValueError("its calibration is missing")
                        if image.range_image_pose_compressed:
                            poses = unpacked_ranges(image.range_image_pose_compressed)
                        ranges = unpacked_ranges(image.range_image_compressed)
                        clouds.append(self.lasers[laser.name].points(ranges, poses, pose))
            if clouds:
                yield _scan(time, pose, clouds, self.lasers, record.start)


def _text(words: str | bytes) -> str:
    """Text of a message; protobuf returns invalid UTF-8 as bytes."""
    return words if isinstance(words, str) else words.decode(errors="replace")


def _record_jpeg(record: TFRecord, camera: int) -> bytes:
    images = parsed("FramePictures", record.read()).images
    found = next((image.image for image in images if image.name == camera), None)
    if found is None:
        raise CaptureError(f"{record.file}: the picture of {WAYMO_CAMERAS.get(camera, camera)} is gone")
    return found


# Second release: a folder of Parquet files for each component, a file for each segment of a drive
# Facts: the column names of waymo_open_dataset/v2/perception. Their fields are those of the first release.

WAYMO_TIME, WAYMO_CAMERA, WAYMO_LASER = "key.frame_timestamp_micros", "key.camera_name", "key.laser_name"
RETURNS = ("[LiDARComponent].range_image_return1", "[LiDARComponent].range_image_return2")
_PIXEL_POSE = "[LiDARPoseComponent].range_image_return1"


def recognizes_waymo_tables(path: Path) -> bool:
    """Return whether a path holds the folder camera_image (itself or one level below), or is a file in one.

    WAYMO/SEGMENT, without a folder of that name, denotes one segment.
    """
    if path.is_file():
        return path.suffix == ".parquet" and (path.parent.parent / "camera_image").is_dir()
    return bool(_roots(path)) or any(_has_segment(root, path.name) for root in _roots(path.parent))


def read_waymo_tables(path: Path) -> Capture:
    """Read one segment: that of a file, the named one (WAYMO/SEGMENT), or the first. Raises `CaptureError`."""
    return open_waymo_tables(path).capture()


def open_waymo_tables(path: Path) -> "WaymoTables":
    """Open the segment that `read_waymo_tables` reads. Raises `CaptureError`."""
    if path.is_file():
        return WaymoTables(path.parent.parent, path.stem, [])
    if _roots(path):
        root = _roots(path)[0]
        segments = [file.stem for file in sorted((root / "camera_image").glob("*.parquet"))]
        if not segments:
            raise CaptureError(f"{root / 'camera_image'}: no .parquet in it")
        problems: list[str] = []
        if segments[1:]:
            problems.append(f"{segments[0]} is read; open one of the other {len(segments) - 1} as {path / segments[1]}")
        return WaymoTables(root, segments[0], problems)
    for root in _roots(path.parent):
        if _has_segment(root, path.name):
            return WaymoTables(root, path.name, [])
    raise CaptureError(f"{path}: no Parquet files of Waymo Perception in it")


def _roots(folder: Path) -> list[Path]:
    if (folder / "camera_image").is_dir():
        return [folder]
    return sorted(each.parent for each in folder.glob("*/camera_image") if each.is_dir()) if folder.is_dir() else []


def _has_segment(root: Path, segment: str) -> bool:
    return (root / "camera_image" / f"{segment}.parquet").is_file()


class WaymoTables:
    """Tables of one segment; `capture` may be called once."""

    def __init__(self, root: Path, segment: str, problems: list[str]) -> None:
        self.root, self.segment = root, segment
        self.log = DrivingLog(segment, road_m=0.0, problems=problems)
        self._omitted: dict[str, list[str]] = defaultdict(list)
        self.poses = vehicle_poses(self.table("vehicle_pose"), self.log)

    def capture(self) -> Capture:
        self._add_views()
        self.log.box_times_s = sorted(time * _US for time in self.poses)
        with self.log.omitting("boxes", CaptureError):
            self._add_boxes()
        self.log.stamps = self.log.stamps or [(time * _US, pose) for time, pose in self.poses.items()]
        lasers: dict[int, WaymoLaser] = {}
        if self.table("lidar").path.is_file():
            with self.log.omitting("lidar", CaptureError):
                lasers = self.lasers()
        if lasers:
            self.log.scans, self.log.scan_count = self._scans(lasers), len(self.poses)
        return self.log.capture()

    def table(self, component: str) -> ParquetFile:
        """Table of a component, such as camera_image."""
        return ParquetFile(self.root / component / f"{self.segment}.parquet")

    @contextmanager
    def _omitting(self, name: str) -> Generator[None]:
        """Omit an item if the block fails; `_report` follows when all items are read."""
        try:
            yield
        except WRONG_VALUES as error:
            self._omitted[what_is_wrong(error)].append(name)

    def _report(self) -> None:
        """Report each reason of an omission once, with the affected items."""
        self.log.problems.extend(f"{abbreviated_names(names)} left out: {why}" for why, names in self._omitted.items())
        self._omitted.clear()

    def _add_views(self) -> None:
        cameras = self._cameras()
        table, column = self.table("camera_image"), "[CameraImageComponent]."
        cells = {
            (row[WAYMO_TIME], row[WAYMO_CAMERA]): (group, k)
            for group, k, row in table.row_groups([WAYMO_TIME, WAYMO_CAMERA])
        }
        image, pose_column, time_column = (f"{column}{name}" for name in ("image", "pose.transform", "pose_timestamp"))
        shutter = f"{column}rolling_shutter_params.shutter"
        numbers = {time: number for number, time in enumerate(sorted({time for time, _ in cells}))}
        for row in table.rows([WAYMO_TIME, WAYMO_CAMERA, image, pose_column, time_column], [shutter]):
            key = (row[WAYMO_TIME], row[WAYMO_CAMERA])
            name = f"{numbers[key[0]]:04d}_{WAYMO_CAMERAS.get(key[1], f'CAMERA_{key[1]}')}"
            with self._omitting(name):
                if key[1] not in cameras:
                    raise ValueError("its calibration is missing")
                camera = cameras[key[1]]
                _check_jpeg(row[image], (camera.width, camera.height))
                pose, time = rigid_from_numbers(row[pose_column]), float(row[time_column])
                jpeg = partial(table.cell, image, *cells[key])
                self.log.views.append(camera.view(name, pose, time, float(row[shutter] or 0.0), jpeg))
                self.log.stamps.append((time, pose))
        self.log.views.sort(key=lambda view: view.name)
        self._report()

    def _cameras(self) -> dict[int, "WaymoCamera"]:
        column = "[CameraCalibrationComponent]."
        lens = [f"{column}intrinsic.{name}" for name in ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")]
        rest = [f"{column}{name}" for name in ("extrinsic.transform", "width", "height")]
        cameras: dict[int, WaymoCamera] = {}
        for row in self.table("camera_calibration").rows([WAYMO_CAMERA, *lens, *rest]):
            number = int(row[WAYMO_CAMERA])
            name = WAYMO_CAMERAS.get(number, f"CAMERA_{number}")
            with self._omitting(name):
                numbers = tuple(float(row[each]) for each in lens)
                to_vehicle = rigid_from_numbers(row[rest[0]])
                cameras[number] = WaymoCamera(name, numbers, to_vehicle, int(row[rest[1]]), int(row[rest[2]]))
        self._report()
        return cameras

    def _add_boxes(self) -> None:
        column, key = "[LiDARBoxComponent].", "key.laser_object_id"
        center, size = ([f"{column}box.{part}.{axis}" for axis in "xyz"] for part in ("center", "size"))
        heading, kind = f"{column}box.heading", f"{column}type"
        for row in self.table("lidar_box").rows([WAYMO_TIME, key, *center, *size, heading, kind]):
            with self._omitting(f"box {row[key]}"):
                if row[WAYMO_TIME] not in self.poses:
                    raise ValueError("the vehicle's pose of its frame is missing")
                pose = heading_pose([float(row[axis]) for axis in center], float(row[heading]))
                to_world, (length, width, height) = (
                    self.poses[row[WAYMO_TIME]] @ pose,
                    (float(row[axis]) for axis in size),
                )
                name, time = _CLASSES.get(row[kind], "unknown"), row[WAYMO_TIME] * _US
                self.log.boxes.append(BoxSample(str(row[key]), name, time, (length, width, height), to_world))
        self._report()

    def lasers(self) -> dict[int, "WaymoLaser"]:
        """Calibrations by lidar number. Raises `CaptureError`."""
        column = "[LiDARCalibrationComponent]."
        names = [f"{column}{name}" for name in ("extrinsic.transform", "beam_inclination.min", "beam_inclination.max")]
        values = f"{column}beam_inclination.values"
        lasers: dict[int, WaymoLaser] = {}
        for row in self.table("lidar_calibration").rows([WAYMO_LASER, *names], [values]):
            with self.log.omitting(f"lidar {_LASERS.get(row[WAYMO_LASER])}", WRONG_VALUES):
                beams = np.array(() if row[values] is None else row[values], np.float64)
                to_vehicle, low, high = (row[name] for name in names)
                lasers[int(row[WAYMO_LASER])] = WaymoLaser(
                    rigid_from_numbers(to_vehicle), beams, (float(low), float(high))
                )
        return lasers

    def _scans(self, lasers: dict[int, "WaymoLaser"]) -> Iterator[LidarScan]:
        """One scan of all lidars for each frame, in file order."""
        pixel_poses = PixelPoses(self.table("lidar_pose"))
        first, second = RETURNS
        rows = self.table("lidar").rows(
            [WAYMO_TIME, WAYMO_LASER, f"{first}.values", f"{first}.shape"], [f"{second}.values", f"{second}.shape"]
        )
        with self.log.omitting("the rest of the lidar", CaptureError):
            for time, of_frame in groupby(rows, lambda row: row[WAYMO_TIME]):
                clouds: list[_Cloud] = []
                for row in of_frame:
                    with self._omitting(f"lidar {_LASERS.get(row[WAYMO_LASER])} at {time}"):
                        if time not in self.poses or row[WAYMO_LASER] not in lasers:
                            raise ValueError("the vehicle's pose of its frame or its calibration is missing")
                        poses = pixel_poses.of(time, row[WAYMO_LASER])
                        for name in (first, second):
                            image = ranges_of_row(row, name)
                            if image is not None:
                                clouds.append(lasers[row[WAYMO_LASER]].points(image, poses, self.poses[time]))
                if clouds:
                    yield _scan(time * _US, self.poses[time], clouds, lasers, time)
        self._report()


def vehicle_poses(table: ParquetFile, log: DrivingLog) -> dict[int, Pose]:
    """Vehicle to world of each frame by its time stamp (microseconds), from a vehicle_pose file."""
    column = "[VehiclePoseComponent].world_from_vehicle.transform"
    poses: dict[int, Pose] = {}
    for row in table.rows([WAYMO_TIME, column]):
        with log.omitting(f"the pose of frame {row[WAYMO_TIME]}", WRONG_VALUES):
            poses[int(row[WAYMO_TIME])] = rigid_from_numbers(row[column])
    return poses


class PixelPoses:
    """Rows of lidar_pose, read in parallel with those of lidar."""

    def __init__(self, table: ParquetFile) -> None:
        columns = [WAYMO_TIME, WAYMO_LASER, f"{_PIXEL_POSE}.values", f"{_PIXEL_POSE}.shape"]
        self._rows = table.rows(columns) if table.path.is_file() else iter(())
        self._waiting: dict[tuple[int, int], Float32[np.ndarray, "h w c"] | None] = {}
        self._lasers: set[int] = set()

    def of(self, time: int, laser: int) -> Float32[np.ndarray, "h w c"] | None:
        """Poses of a lidar's pixels; None for lidars without any, which are all but the one on the roof."""
        if (time, laser) not in self._waiting and (laser == 1 or laser in self._lasers):
            for row in self._rows:
                key = (row[WAYMO_TIME], row[WAYMO_LASER])
                self._lasers.add(key[1])
                self._waiting[key] = ranges_of_row(row, _PIXEL_POSE)
                if key == (time, laser):
                    break
        return self._waiting.pop((time, laser), None)


def ranges_of_row(row: dict[str, Any], name: str) -> Float32[np.ndarray, "h w c"] | None:
    """Range image in the columns NAME.values and NAME.shape of a row; None without one."""
    values, shape = row[f"{name}.values"], row[f"{name}.shape"]
    if values is None or not len(values):
        return None
    return _range_image(values, tuple(int(side) for side in shape))


# Cameras


@dataclass(frozen=True, slots=True, eq=False)
class WaymoCamera:
    """Calibration of one camera. Its own axes are x forward, y left, z up; converted here to OpenCV's."""

    name: str
    intrinsics: tuple[float, ...]
    """f_u f_v c_u c_v k1 k2 p1 p2 k3; the first pixel's center is (0.5, 0.5)."""
    to_vehicle: Pose
    width: int
    height: int

    def __post_init__(self) -> None:
        if len(self.intrinsics) != 9 or not np.isfinite(self.intrinsics).all() or min(self.intrinsics[:2]) <= 0:
            raise ValueError(f"camera {self.name} has the intrinsics {self.intrinsics}, expected 9 numbers")
        if self.width < 1 or self.height < 1:
            raise ValueError(f"camera {self.name} has pictures of {self.width}x{self.height} px")

    def view(
        self, name: str, vehicle_to_world: Pose, time_s: float, shutter_s: float, jpeg: Callable[[], bytes]
    ) -> CaptureFrame:
        """View of one image at the vehicle's pose. An impossible shutter time is replaced by the default."""
        to_world = vehicle_to_world @ self.to_vehicle @ invert_pose(OPENCV_FROM_VEHICLE_AXES)
        fx, fy, cx, cy = self.intrinsics[:4]
        exposure = shutter_s if 0 < shutter_s <= _LONGEST_EXPOSURE_S else DEFAULT_EXPOSURE_S
        camera = Camera(self.width, self.height, fx, fy, cx, cy, invert_pose(to_world), exposure)
        lens = Lens("opencv", self.intrinsics[4:]) if any(self.intrinsics[4:]) else None
        return CaptureFrame(name, camera, lambda: _decoded(jpeg(), name), time_s, self.name, lens)


def _check_jpeg(content: bytes, size: tuple[int, int]) -> None:
    """Raise ValueError unless bytes are a complete JPEG of a width and height."""
    with opened_image(content, "its picture") as picture:
        found = picture.size
    if found != size:
        raise ValueError(f"a picture of {found[0]}x{found[1]} px, its calibration says {size[0]}x{size[1]}")
    if b"\xff\xd9" not in content[-1024:]:
        raise ValueError("the picture is cut off; its end is missing")


def _decoded(content: bytes, name: str) -> UInt8[np.ndarray, "h w 3"]:
    with opened_image(content, name) as picture:
        return np.array(picture.convert("RGB"), np.uint8)


# Range images
# Facts: RangeImage in dataset.proto and v2/perception/lidar.py of github.com/waymo-research/waymo-open-dataset.

_MAX_NUMBERS = 64 * 4000 * 6


@dataclass(frozen=True, slots=True, eq=False)
class WaymoLaser:
    """Pose and beams of a lidar: row 0 of a range image is the highest beam."""

    to_vehicle: Pose
    beams_rad: Float64[np.ndarray, " k"]
    """Inclination of each row from the lowest up; none if rows are evenly spaced."""
    ends_rad: tuple[float, float] = (0.0, 0.0)
    """Lowest and highest edge of evenly spaced rows."""

    @classmethod
    def of_record(cls, calibration: Any) -> "WaymoLaser":
        """Lidar of a LaserCalibration; raises ValueError for a pose that is none."""
        ends = (calibration.beam_inclination_min, calibration.beam_inclination_max)
        beams = np.array(calibration.beam_inclinations, np.float64)
        return cls(rigid_from_numbers(calibration.extrinsic.transform), beams, ends)

    def points(
        self,
        ranges: Float32[np.ndarray, "h w c"],
        pixel_poses: Float32[np.ndarray, "u v d"] | None,
        vehicle_to_world: Pose,
    ) -> _Cloud:
        """Points (m) in the vehicle's frame at the frame's pose, and intensities; ValueError if shapes disagree.

        Column 0 is the backward direction, and columns rotate clockwise seen from above, in the vehicle's frame.
        `pixel_poses` (height, width; roll pitch yaw x y z) are the vehicle's poses at each pixel's own time, if known.
        """
        height, width = ranges.shape[:2]
        if pixel_poses is not None and pixel_poses.shape != (height, width, 6):
            raise ValueError(f"poses of the shape {pixel_poses.shape} belong to a range image of {height}x{width}")
        turned = np.arctan2(self.to_vehicle[1, 0], self.to_vehicle[0, 0])
        yaw = np.pi - 2 * np.pi * (np.arange(width) + 0.5) / width - turned
        low, high = self.ends_rad
        beams = self.beams_rad if len(self.beams_rad) else low + (high - low) * (np.arange(height) + 0.5) / height
        if len(beams) != height:
            raise ValueError(f"a lidar of {len(beams)} beams has a range image of {height} rows")
        poses = np.zeros((0, 0, 6), np.float32) if pixel_poses is None else np.ascontiguousarray(pixel_poses)
        back = invert_pose(vehicle_to_world)
        points = _points(np.ascontiguousarray(ranges), beams[::-1], yaw, self.to_vehicle, poses, back)
        seen = ranges[..., 0] > 0
        light = ranges[..., 1][seen] if ranges.shape[2] > 1 else np.zeros(len(points), np.float32)
        return points, np.ascontiguousarray(light, np.float32)


def _scan(time_s: float, pose: Pose, clouds: list[_Cloud], lasers: Mapping[int, WaymoLaser], key: int) -> LidarScan:
    top = lasers.get(1) or next(iter(lasers.values()))
    points, intensities = (np.concatenate(each) for each in zip(*clouds, strict=True))
    return LidarScan(time_s, pose, points, top.to_vehicle[:3, 3], intensities, key)


def unpacked_matrix(compressed: bytes) -> Any:
    """Parse a MatrixFloat, serialized and compressed by zlib; ValueError if it is larger than any range image."""
    unpacker = zlib.decompressobj()
    content = unpacker.decompress(compressed, _MAX_NUMBERS * 4 + 64)
    if not unpacker.eof:
        raise ValueError("a range image larger than any lidar's")
    return parsed("MatrixFloat", content)


def unpacked_ranges(compressed: bytes) -> Float32[np.ndarray, "h w c"]:
    """Parse the range image in a compressed MatrixFloat; ValueError if sizes disagree."""
    matrix = unpacked_matrix(compressed)
    return _range_image(np.frombuffer(matrix.data, "<f4"), tuple(matrix.shape.dims))


def _range_image(values: Any, shape: tuple[int, ...]) -> Float32[np.ndarray, "h w c"]:
    if len(shape) != 3 or min(shape) < 1 or int(np.prod(shape)) != len(values):
        raise ValueError(f"a range image of {len(values)} numbers says that its shape is {shape}")
    return np.asarray(values, np.float32).reshape(shape)


@kernel()
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


@kernel()
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

_FIELDS = {
    "Transform": "1 transform double*",
    "CameraCalibration": "1 name int32, 2 intrinsic double*, 3 extrinsic Transform, 4 width int32, 5 height int32",
    "LaserCalibration": (
        "1 name int32, 2 beam_inclinations double*, 3 beam_inclination_min double, 4 beam_inclination_max double, "
        "5 extrinsic Transform"
    ),
    "Context": "1 name string, 2 camera_calibrations CameraCalibration*, 3 laser_calibrations LaserCalibration*",
    "CameraImage": "1 name int32, 2 image bytes, 3 pose Transform, 5 pose_timestamp double, 6 shutter double",
    "MatrixShape": "1 dims int32*",
    "MatrixFloat": "1 data bytes, 2 shape MatrixShape",
    "RangeImage": "2 range_image_compressed bytes, 4 range_image_pose_compressed bytes",
    "Laser": "1 name int32, 2 ri_return1 RangeImage, 3 ri_return2 RangeImage",
    "Box": (
        "1 center_x double, 2 center_y double, 3 center_z double, 4 width double, 5 length double, 6 height double, "
        "7 heading double"
    ),
    "Label": "1 box Box, 3 type int32, 4 id string",
    "Frame": (
        "1 context Context, 2 timestamp_micros int64, 3 pose Transform, 4 images CameraImage*, 5 lasers Laser*, "
        "6 laser_labels Label*"
    ),
    "FramePictures": "4 images CameraImage*",
}
"""Number, name and type of each message's fields; a star means repeated. FramePictures is a Frame with only its images.

The numbers of a MatrixFloat are packed: read as bytes they become an array directly.
"""

_PACKAGE = "gsrain.waymo"


def parsed(message: str, content: bytes) -> Any:
    """Parse a message by its name. Raises `CaptureError` if it is damaged or protobuf is not installed."""
    kind = message_kinds()[message]
    found = kind()
    try:
        found.ParseFromString(content)
    except Exception:  # DecodeError, whose module is not imported here
        raise CaptureError(f"not a record of Waymo Perception: it is damaged, or {_OTHERS}") from None
    return found


@cache
def message_kinds() -> dict[str, Any]:
    try:
        require_package("google.protobuf", "a TFRecord file of Waymo")
    except MissingPackageError as error:
        raise CaptureError(str(error)) from None
    descriptor = import_module("google.protobuf.descriptor_pb2")
    pool = import_module("google.protobuf.descriptor_pool").DescriptorPool()
    factory = import_module("google.protobuf.message_factory")
    file = descriptor.FileDescriptorProto(name="gsrain_waymo.proto", package=_PACKAGE, syntax="proto2")
    for message, fields in _FIELDS.items():
        described = file.message_type.add(name=message)
        for number, name, kind in (field.split() for field in fields.split(", ")):
            plain = kind.rstrip("*")
            field = described.field.add(name=name, number=int(number), label=3 if kind.endswith("*") else 1)
            if plain in _SCALARS:
                field.type = _SCALARS[plain]
            else:
                field.type, field.type_name = 11, f".{_PACKAGE}.{plain}"
    pool.Add(file)
    return {name: factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}")) for name in _FIELDS}
