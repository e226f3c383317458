"""Waymo Perception, second release: a folder of Parquet files for each component, a file for each segment of a drive.

Facts: the column names of waymo_open_dataset/v2/perception. Their fields are those of the first release.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float32, Float64

from .capture import Capture, CaptureError, abbreviated_names
from .driving_log import DrivingLog, LidarScan
from .geometry import BoxSample, rigid_from_numbers
from .io.arrays import WRONG_VALUES, what_is_wrong
from .io.records import ParquetFile
from .waymo import CAMERAS, CLASSES, LASERS, WaymoCamera, WaymoLaser, check_jpeg, heading_pose

_US = 1e-6
_TIME, _CAMERA = "key.frame_timestamp_micros", "key.camera_name"
Value = TypeVar("Value")


def recognizes_waymo_tables(path: Path) -> bool:
    """Return whether a path holds the folder camera_image (itself or one level below), or is a file in one.

    WAYMO/SEGMENT, without a folder of that name, denotes one segment.
    """
    if path.is_file():
        return path.suffix == ".parquet" and (path.parent.parent / "camera_image").is_dir()
    return bool(_roots(path)) or any(_files(root, path.name) for root in _roots(path.parent))


def read_waymo_tables(path: Path) -> Capture:
    """Read one segment: that of a file, the named one (WAYMO/SEGMENT), or the first. Raises `CaptureError`."""
    problems: list[str] = []
    if path.is_file():
        return _TableSegment.opened(path.parent.parent, path.stem, problems).capture()
    if _roots(path):
        root = _roots(path)[0]
        segments = [file.stem for file in sorted((root / "camera_image").glob("*.parquet"))]
        if not segments:
            raise CaptureError(f"{root / 'camera_image'}: no .parquet in it")
        if segments[1:]:
            problems.append(f"{segments[0]} is read; open one of the other {len(segments) - 1} as {path / segments[1]}")
        return _TableSegment.opened(root, segments[0], problems).capture()
    for root in _roots(path.parent):
        if _files(root, path.name):
            return _TableSegment.opened(root, path.name, problems).capture()
    raise CaptureError(f"{path}: no Parquet files of Waymo Perception in it")


def _roots(folder: Path) -> list[Path]:
    if (folder / "camera_image").is_dir():
        return [folder]
    return sorted(each.parent for each in folder.glob("*/camera_image") if each.is_dir()) if folder.is_dir() else []


def _files(root: Path, segment: str) -> bool:
    return (root / "camera_image" / f"{segment}.parquet").is_file()


@dataclass(frozen=True, slots=True)
class _TableSegment:
    root: Path
    segment: str
    record: DrivingLog
    poses: dict[int, Float64[np.ndarray, "4 4"]]
    """Vehicle to world of each frame, by its time stamp."""

    @classmethod
    def opened(cls, root: Path, segment: str, problems: list[str]) -> "_TableSegment":
        poses, wrong = vehicle_poses(root / "vehicle_pose" / f"{segment}.parquet")
        problems += wrong
        return cls(root, segment, DrivingLog(segment, road_m=0.0, problems=problems), poses)

    def capture(self) -> Capture:
        self._pictures()
        self.record.box_times_s = sorted(time * _US for time in self.poses)
        self._optional("boxes", self._boxes)
        if not self.record.stamps:
            self.record.stamps = [(time * _US, pose) for time, pose in self.poses.items()]
        lidar = WaymoTableLidar(self.root, self.segment, self.poses, self.record.problems)
        lasers = (lidar.is_there and self._optional("lidar", lidar.lasers)) or {}
        if lasers:
            self.record.scans, self.record.scan_count = lidar.scans(lasers), len(self.poses)
        return self.record.capture()

    def _file(self, component: str) -> ParquetFile:
        return ParquetFile(self.root / component / f"{self.segment}.parquet")

    def _optional(self, what: str, read: Callable[[], Value]) -> Value | None:
        try:
            return read()
        except CaptureError as error:
            self.record.problems.append(f"{what} left out: {error}")
            return None

    def _left_out(self, what: dict[str, list[str]]) -> None:
        """Report each reason once, with the affected items."""
        self.record.problems.extend(f"{abbreviated_names(names)} left out: {why}" for why, names in what.items())

    def _pictures(self) -> None:
        cameras = self._cameras()
        file, column = self._file("camera_image"), "[CameraImageComponent]."
        keys = {(row[_TIME], row[_CAMERA]): (group, place) for group, place, row in file.row_groups([_TIME, _CAMERA])}
        names = [f"{column}{name}" for name in ("image", "pose.transform", "pose_timestamp")]
        rows = file.rows([_TIME, _CAMERA, *names], [f"{column}rolling_shutter_params.shutter"])
        numbers = {time: number for number, time in enumerate(sorted({time for time, _ in keys}))}
        wrong: dict[str, list[str]] = defaultdict(list)
        for row in rows:
            key = (row[_TIME], row[_CAMERA])
            sensor = CAMERAS.get(key[1], f"CAMERA_{key[1]}")
            name = f"{numbers[key[0]]:04d}_{sensor}"
            try:
                if key[1] not in cameras:
                    raise ValueError("its calibration is missing")
                camera = cameras[key[1]]
                check_jpeg(row[names[0]], (camera.width, camera.height))
                pose, time = rigid_from_numbers(row[names[1]]), float(row[names[2]])
                shutter = float(row[f"{column}rolling_shutter_params.shutter"] or 0.0)
                source = partial(file.cell, names[0], *keys[key])
                self.record.views.append(camera.view(name, pose, time, shutter, source))
                self.record.stamps.append((time, pose))
            except WRONG_VALUES as error:
                wrong[what_is_wrong(error)].append(name)
        self.record.views.sort(key=lambda view: view.name)
        self._left_out(wrong)

    def _cameras(self) -> dict[int, WaymoCamera]:
        column = "[CameraCalibrationComponent]."
        lens = [f"{column}intrinsic.{name}" for name in ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")]
        rest = [f"{column}{name}" for name in ("extrinsic.transform", "width", "height")]
        cameras: dict[int, WaymoCamera] = {}
        wrong: dict[str, list[str]] = defaultdict(list)
        for row in self._file("camera_calibration").rows([_CAMERA, *lens, *rest]):
            number = int(row[_CAMERA])
            name = CAMERAS.get(number, f"CAMERA_{number}")
            try:
                numbers = tuple(float(row[each]) for each in lens)
                to_vehicle = rigid_from_numbers(row[rest[0]])
                cameras[number] = WaymoCamera(name, numbers, to_vehicle, int(row[rest[1]]), int(row[rest[2]]))
            except WRONG_VALUES as error:
                wrong[what_is_wrong(error)].append(name)
        self._left_out(wrong)
        return cameras

    def _boxes(self) -> None:
        column, key = "[LiDARBoxComponent].", "key.laser_object_id"
        center, size = ([f"{column}box.{part}.{axis}" for axis in "xyz"] for part in ("center", "size"))
        heading, kind = f"{column}box.heading", f"{column}type"
        wrong: dict[str, list[str]] = defaultdict(list)
        for row in self._file("lidar_box").rows([_TIME, key, *center, *size, heading, kind]):
            try:
                if row[_TIME] not in self.poses:
                    raise ValueError("the vehicle's pose of its frame is missing")
                pose = heading_pose([float(row[axis]) for axis in center], float(row[heading]))
                to_world, sides = self.poses[row[_TIME]] @ pose, [float(row[axis]) for axis in size]
                name, time = CLASSES.get(row[kind], "unknown"), row[_TIME] * _US
                self.record.boxes.append(BoxSample(str(row[key]), name, time, (sides[0], sides[1], sides[2]), to_world))
            except WRONG_VALUES as error:
                wrong[what_is_wrong(error)].append(f"box {row[key]}")
        self._left_out(wrong)


def vehicle_poses(file: Path) -> tuple[dict[int, Float64[np.ndarray, "4 4"]], list[str]]:
    """Vehicle to world of each frame by its time stamp (microseconds), and problems, from a vehicle_pose file."""
    column = "[VehiclePoseComponent].world_from_vehicle.transform"
    poses: dict[int, Float64[np.ndarray, "4 4"]] = {}
    problems: list[str] = []
    for row in ParquetFile(file).rows([_TIME, column]):
        try:
            poses[int(row[_TIME])] = rigid_from_numbers(row[column])
        except WRONG_VALUES as error:
            problems.append(f"the pose of frame {row[_TIME]} left out: {what_is_wrong(error)}")
    return poses, problems


# Lidar

_LIDAR_TIME, _LASER = "key.frame_timestamp_micros", "key.laser_name"
_RETURNS = ("[LiDARComponent].range_image_return1", "[LiDARComponent].range_image_return2")
_PIXEL_POSE = "[LiDARPoseComponent].range_image_return1"


@dataclass(frozen=True, slots=True, eq=False)
class WaymoTableLidar:
    """The lidars of one segment; problems with their rows are added to `problems`."""

    root: Path
    segment: str
    poses: dict[int, Float64[np.ndarray, "4 4"]]
    """Vehicle to world of each frame, by its time stamp in microseconds."""
    problems: list[str]

    @property
    def is_there(self) -> bool:
        """True if the segment's range images were downloaded."""
        return self._file("lidar").path.is_file()

    def lasers(self) -> dict[int, WaymoLaser]:
        """Calibrations by lidar number. Raises `CaptureError`."""
        column = "[LiDARCalibrationComponent]."
        names = [f"{column}{name}" for name in ("extrinsic.transform", "beam_inclination.min", "beam_inclination.max")]
        values = f"{column}beam_inclination.values"
        lasers: dict[int, WaymoLaser] = {}
        for row in self._file("lidar_calibration").rows([_LASER, *names], [values]):
            try:
                beams = np.asarray(row[values] if row[values] is not None else (), np.float64)
                ends = np.array([row[names[1]], row[names[2]]], np.float64)
                place = rigid_from_numbers(row[names[0]])
                lasers[int(row[_LASER])] = WaymoLaser(place, beams if len(beams) else ends, not len(beams))
            except WRONG_VALUES as error:
                self.problems.append(f"lidar {LASERS.get(row[_LASER])} left out: {what_is_wrong(error)}")
        return lasers

    def scans(self, lasers: dict[int, WaymoLaser]) -> Iterator[LidarScan]:
        """One scan of all lidars for each frame, in file order."""
        pixel_poses = _PixelPoses(self._file("lidar_pose"))
        top = lasers.get(1) or next(iter(lasers.values()))
        columns = [f"{name}.{part}" for name in _RETURNS for part in ("values", "shape")]
        wrong: dict[str, list[str]] = defaultdict(list)
        rows = self._file("lidar").rows([_LIDAR_TIME, _LASER, *columns[:2]], columns[2:])
        try:
            for time, of_frame in groupby(rows, lambda row: row[_LIDAR_TIME]):
                clouds: list[Float64[np.ndarray, "p 3"]] = []
                lights: list[Float32[np.ndarray, " p"]] = []
                for row in of_frame:
                    try:
                        if time not in self.poses or row[_LASER] not in lasers:
                            raise ValueError("the vehicle's pose of its frame or its calibration is missing")
                        pose, laser = self.poses[time], lasers[row[_LASER]]
                        poses = pixel_poses.of(time, row[_LASER])
                        for name in _RETURNS:
                            image = _image(row, name)
                            if image is not None:
                                points, light = laser.points(image, poses, pose)
                                clouds.append(points)
                                lights.append(light)
                    except WRONG_VALUES as error:
                        wrong[what_is_wrong(error)].append(f"lidar {LASERS.get(row[_LASER])} at {time}")
                if clouds:
                    points, light = np.concatenate(clouds), np.concatenate(lights)
                    yield LidarScan(time * _US, self.poses[time], points, top.to_vehicle[:3, 3], light)
        except CaptureError as error:
            self.problems.append(f"the rest of the lidar left out: {error}")
        self.problems.extend(f"{abbreviated_names(names)} left out: {why}" for why, names in wrong.items())

    def _file(self, component: str) -> ParquetFile:
        return ParquetFile(self.root / component / f"{self.segment}.parquet")


class _PixelPoses:
    """Rows of lidar_pose, read in parallel with those of lidar."""

    def __init__(self, file: ParquetFile) -> None:
        columns = [_LIDAR_TIME, _LASER, f"{_PIXEL_POSE}.values", f"{_PIXEL_POSE}.shape"]
        self._rows = file.rows(columns) if file.path.is_file() else iter(())
        self._waiting: dict[tuple[int, int], Float32[np.ndarray, "h w c"] | None] = {}
        self._lasers: set[int] = set()

    def of(self, time: int, laser: int) -> Float32[np.ndarray, "h w c"] | None:
        """Poses of a lidar's pixels; None for lidars without any, which are all but the one on the roof."""
        if (time, laser) not in self._waiting and (laser == 1 or laser in self._lasers):
            for row in self._rows:
                key = (row[_LIDAR_TIME], row[_LASER])
                self._lasers.add(key[1])
                self._waiting[key] = _image(row, _PIXEL_POSE)
                if key == (time, laser):
                    break
        return self._waiting.pop((time, laser), None)


def _image(row: dict[str, Any], name: str) -> Float32[np.ndarray, "h w c"] | None:
    """A range image of a row; ValueError if its numbers and its shape disagree."""
    values, shape = row[f"{name}.values"], row[f"{name}.shape"]
    if values is None or not len(values):
        return None
    sides = tuple(int(side) for side in shape)
    if len(sides) != 3 or min(sides) < 1 or int(np.prod(sides)) != len(values):
        raise ValueError(f"a range image of {len(values)} numbers says that its shape is {sides}")
    return np.asarray(values, np.float32).reshape(sides)
