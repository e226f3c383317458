"""Waymo Perception, second release: a folder of Parquet files for each component, a file for each segment of a drive.

Facts: the column names of waymo_open_dataset/v2/perception. Their fields are those of the first release.
"""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float64

from ..capture import Capture, CaptureError
from ..driving_record import DrivingRecord
from ..files.parquet_file import ParquetFile
from ..files.reading_errors import WRONG_VALUES, what_is_wrong
from ..geometry.box_tracks import BoxSample
from ..geometry.rigid_poses import rigid_from_numbers
from ..named_problems import some_names
from .rig import CAMERAS, CLASSES, WaymoCamera, check_jpeg, heading_pose
from .table_lidar import WaymoTableLidar

_US = 1e-6
_TIME, _CAMERA = "key.frame_timestamp_micros", "key.camera_name"

Value = TypeVar("Value")


def recognizes_waymo_tables(path: Path) -> bool:
    """Whether a path holds the folder camera_image (itself or one below, such as training), or is a file of one.

    WAYMO/SEGMENT, where no folder of that name is, means one segment.
    """
    if path.is_file():
        return path.suffix == ".parquet" and (path.parent.parent / "camera_image").is_dir()
    return bool(_roots(path)) or any(_files(root, path.name) for root in _roots(path.parent))


def read_waymo_tables(path: Path) -> Capture:
    """Read one segment: that of a file, the named one (WAYMO/SEGMENT), or the first. Raises `CaptureError`."""
    problems: list[str] = []
    if path.is_file():
        return _Segment.opened(path.parent.parent, path.stem, problems).capture()
    if _roots(path):
        root = _roots(path)[0]
        segments = [file.stem for file in sorted((root / "camera_image").glob("*.parquet"))]
        if not segments:
            raise CaptureError(f"{root / 'camera_image'}: no .parquet in it")
        if segments[1:]:
            problems.append(f"{segments[0]} is read; open one of the other {len(segments) - 1} as {path / segments[1]}")
        return _Segment.opened(root, segments[0], problems).capture()
    for root in _roots(path.parent):
        if _files(root, path.name):
            return _Segment.opened(root, path.name, problems).capture()
    raise CaptureError(f"{path}: no Parquet files of Waymo Perception in it")


def _roots(folder: Path) -> list[Path]:
    if (folder / "camera_image").is_dir():
        return [folder]
    return sorted(each.parent for each in folder.glob("*/camera_image") if each.is_dir()) if folder.is_dir() else []


def _files(root: Path, segment: str) -> bool:
    return (root / "camera_image" / f"{segment}.parquet").is_file()


@dataclass(frozen=True, slots=True)
class _Segment:
    root: Path
    segment: str
    record: DrivingRecord
    poses: dict[int, Float64[np.ndarray, "4 4"]]
    """Vehicle to world of each frame, by its time stamp."""

    @classmethod
    def opened(cls, root: Path, segment: str, problems: list[str]) -> "_Segment":
        poses, wrong = vehicle_poses(root / "vehicle_pose" / f"{segment}.parquet")
        problems += wrong
        return cls(root, segment, DrivingRecord(segment, road_m=0.0, problems=problems), poses)

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
        """Say each reason once, with the things that it hit."""
        self.record.problems.extend(f"{some_names(names)} left out: {why}" for why, names in what.items())

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
    """Vehicle to world of each frame by its time stamp (microseconds), and what was wrong; of a vehicle_pose file."""
    column = "[VehiclePoseComponent].world_from_vehicle.transform"
    poses: dict[int, Float64[np.ndarray, "4 4"]] = {}
    problems: list[str] = []
    for row in ParquetFile(file).rows([_TIME, column]):
        try:
            poses[int(row[_TIME])] = rigid_from_numbers(row[column])
        except WRONG_VALUES as error:
            problems.append(f"the pose of frame {row[_TIME]} left out: {what_is_wrong(error)}")
    return poses, problems
