"""KITTI raw: a drive of the synchronized and rectified recordings, with the calibration of its day beside it.

The vehicle's frame is that of the inertial unit (x forward, y left, z up); the world x east, y north, z up.
"""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from ..capture import Capture, CaptureError
from ..driving_record import DrivingRecord, Scan
from ..files.picture_file import pictures_in
from ..geometry.box_tracks import BoxSample
from ..geometry.rigid_poses import inverse, rigid_from_numbers, transformed
from ..named_problems import some_names
from .calibration import IMU_HEIGHT_M, Calibration, KittiCamera, numbers_of, read_calibration, read_text, read_velodyne
from .oxts import OxtsRecord, oxts_poses, read_oxts
from .tracklets import read_tracklets

_CAMERAS, _GREY_CAMERAS = ("image_02", "image_03"), ("image_00", "image_01")
_CALIBRATIONS = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt")

_Poses = dict[int, Float64[np.ndarray, "4 4"]]


def recognizes_kitti_raw(path: Path) -> bool:
    """Whether a path is a drive (oxts beside image_02), or the folder of a day (calib_cam_to_cam.txt) with drives."""
    return _is_drive(path) or ((path / _CALIBRATIONS[0]).is_file() and bool(_drives(path)))


def read_kitti_raw(path: Path) -> Capture:
    """Read a drive; of a day the first. Raises `CaptureError`, also for recordings that are not rectified."""
    problems: list[str] = []
    if not _is_drive(path):
        drives = _drives(path)
        if not drives:
            raise CaptureError(f"{path}: no drive of KITTI in it (YYYY_MM_DD_drive_NNNN_sync/oxts)")
        if drives[1:]:
            others = [each.name for each in drives[1:]]
            problems.append(f"{drives[0].name} is read; the others here: {some_names(others)}")
        path = drives[0]
    if path.name.endswith("_extract"):
        raise CaptureError(f"{path}: these pictures are not rectified; take the synced and rectified drive (_sync)")
    return _Drive(path, problems).capture()


def _is_drive(path: Path) -> bool:
    return (path / "oxts" / "data").is_dir() and any((path / name).is_dir() for name in (*_CAMERAS, *_GREY_CAMERAS))


def _drives(day: Path) -> list[Path]:
    return sorted(each for each in day.glob("*_drive_*") if _is_drive(each))


class _Drive:
    """What is read of one drive, by picture numbers."""

    def __init__(self, folder: Path, problems: list[str]) -> None:
        self.folder = folder
        self.record = DrivingRecord(folder.name, road_m=-IMU_HEIGHT_M, problems=problems)
        day = folder if (folder / _CALIBRATIONS[0]).is_file() else folder.parent
        cam_to_cam, velo_to_cam, imu_to_velo = (read_calibration(day / name) for name in _CALIBRATIONS)
        self._projections, self._cam_file = cam_to_cam, day / _CALIBRATIONS[0]
        rectify = _rigid(numbers_of(cam_to_cam, "R_rect_00", 9, self._cam_file), np.zeros(3), self._cam_file)
        self.lidar_to_first = rectify @ _given(velo_to_cam, day / _CALIBRATIONS[1])
        self.imu_to_lidar = _given(imu_to_velo, day / _CALIBRATIONS[2])
        self.poses = self._oxts()

    def capture(self) -> Capture:
        times = self._times("oxts")
        self.record.stamps = [(times[k], pose) for k, pose in self.poses.items() if k in times]
        self._pictures()
        lidar_times = self._times("velodyne_points") if (self.folder / "velodyne_points").is_dir() else {}
        if (self.folder / "tracklet_labels.xml").is_file():
            self._boxes(lidar_times or times)
        files = sorted((self.folder / "velodyne_points" / "data").glob("*.bin"))
        self.record.scans, self.record.scan_count = self._scans(files, lidar_times), len(files)
        return self.record.capture()

    def _oxts(self) -> _Poses:
        records: dict[int, OxtsRecord] = {}
        for file in sorted((self.folder / "oxts" / "data").glob("*.txt")):
            try:
                records[_number(file)] = read_oxts(file)
            except (CaptureError, ValueError) as error:
                self.record.problems.append(f"a place of the vehicle left out: {error}")
        return dict(zip(records, oxts_poses(list(records.values())), strict=True))

    def _times(self, sensor: str) -> dict[int, float]:
        file = self.folder / sensor / "timestamps.txt"
        times: dict[int, float] = {}
        for number, line in enumerate(read_text(file).splitlines()):
            try:
                times[number] = _seconds(line)
            except ValueError:
                if line.strip():
                    self.record.problems.append(f"{file}: line {number + 1} is no time stamp")
        return times

    def _pictures(self) -> None:
        present = [name for name in _CAMERAS if (self.folder / name).is_dir()]
        for sensor in present or [name for name in _GREY_CAMERAS if (self.folder / name).is_dir()]:
            try:
                numbers = numbers_of(self._projections, f"P_rect_{sensor[-2:]}", 12, self._cam_file)
                camera, times = KittiCamera(sensor, numbers.reshape(3, 4)), self._times(sensor)
            except (CaptureError, ValueError) as error:
                self.record.problems.append(f"{sensor} left out: {error}")
                continue
            for file in pictures_in(self.folder / sensor / "data"):
                try:
                    number = _number(file)
                    if number not in self.poses or number not in times:
                        raise ValueError("the place or the time of the vehicle is not known")
                    world_to_first = self.lidar_to_first @ self.imu_to_lidar @ inverse(self.poses[number])
                    view = camera.view(file, f"{number:04d}_{sensor}", times[number], world_to_first)
                    self.record.views.append(view)
                except (CaptureError, ValueError) as error:
                    self.record.problems.append(f"{sensor}/{file.name} left out: {error}")
        self.record.views.sort(key=lambda view: view.name)

    def _boxes(self, times: dict[int, float]) -> None:
        try:
            tracklets = read_tracklets(self.folder / "tracklet_labels.xml")
        except CaptureError as error:
            self.record.problems.append(f"boxes left out: {error}")
            return
        known = [number for number in self.poses if number in times]
        self.record.box_times_s = [times[number] for number in known]
        for name, each in enumerate(tracklets):
            for number, to_lidar in enumerate(each.centers_to_lidar, each.first_frame):
                if number not in self.poses or number not in times:
                    continue
                to_world = self.poses[number] @ inverse(self.imu_to_lidar) @ to_lidar
                try:
                    sample = BoxSample(str(name), each.class_name, times[number], each.size_lwh, to_world)
                except ValueError as error:
                    self.record.problems.append(f"tracklet {name} left out: {error}")
                    break
                self.record.boxes.append(sample)

    def _scans(self, files: list[Path], times: dict[int, float]) -> Iterator[Scan]:
        to_vehicle = inverse(self.imu_to_lidar)
        for file in files:
            try:
                number = _number(file)
                if number not in self.poses or number not in times:
                    raise ValueError("the place or the time of the vehicle is not known")
                points, light = read_velodyne(file)
                placed = transformed(to_vehicle, points)
                yield Scan(times[number], self.poses[number], placed, to_vehicle[:3, 3], light)
            except (CaptureError, ValueError) as error:
                self.record.problems.append(f"velodyne_points/{file.name} left out: {error}")


def _given(values: Calibration, file: Path) -> Float64[np.ndarray, "4 4"]:
    """Pose of the lines R and T."""
    return _rigid(numbers_of(values, "R", 9, file), numbers_of(values, "T", 3, file), file)


def _rigid(turn: Float64[np.ndarray, "9"], place: Float64[np.ndarray, "3"], file: Path) -> Float64[np.ndarray, "4 4"]:
    try:
        return rigid_from_numbers(np.column_stack([turn.reshape(3, 3), place]))
    except ValueError as error:
        raise CaptureError(f"{file}: {error}") from None


def _number(file: Path) -> int:
    if not file.stem.isdecimal():
        raise ValueError(f"{file.name}: not the number of a picture")
    return int(file.stem)


def _seconds(line: str) -> float:
    """Time stamp with nanoseconds, which datetime does not take; ValueError where it is none."""
    whole, _, fraction = line.strip().partition(".")
    moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
    return (moment - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds() + float(f"0.{fraction or 0}")
