"""KITTI: odometry sequences and raw drives, with their calibrations, poses, lidar and boxes.

Facts: Geiger et al., "Vision meets Robotics: The KITTI Dataset" (2013), and the readme of its development kit.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64

from ..safe_io.limits import read_file
from .capture import Capture, CaptureError, CaptureFrame, abbreviated_names
from .driving_log import DrivingLog, LidarScan
from .geometry import (
    OPENCV_FROM_VEHICLE_AXES,
    BoxSample,
    invert_pose,
    opencv_camera_of_matrix,
    rigid_from_numbers,
    rigid_pose,
    transform_points,
    translation_pose,
)
from .io.images import image_size, images_in, read_color

Calibration = dict[str, Float64[np.ndarray, " _"]]
"""Numbers of each line of a file, by its name."""

_MAX_TEXT_BYTES = 1 << 28
_LARGEST = 1e12  # larger numbers indicate a damaged file
IMU_HEIGHT_M, CAMERA_HEIGHT_M = 0.93, 1.65
"""Height of the recording car's sensors above the road (figure 3 of the paper)."""


def read_calibration(file: Path) -> Calibration:
    """Read lines of `name: numbers`, skipping others. Raises `CaptureError`."""
    values: Calibration = {}
    for line in read_text(file).splitlines():
        name, _, rest = line.partition(":")
        try:
            values[name.strip()] = np.array([float(word) for word in rest.split()], np.float64)
        except ValueError:
            continue  # a date, or the time of day of the calibration
    return values


def numbers_of(values: Calibration, name: str, count: int, file: Path) -> Float64[np.ndarray, " n"]:
    """Numbers of one name; `CaptureError` if missing or not `count` finite ones."""
    found = values.get(name)
    if found is None or len(found) != count or not np.abs(found).max(initial=0) < _LARGEST:
        has = "no such line" if found is None else f"{len(found)} numbers"
        raise CaptureError(f"{file}: expected {count} finite numbers at {name}, it has {has}")
    return found


def read_text(file: Path) -> str:
    try:
        return read_file(file, _MAX_TEXT_BYTES).decode("utf-8")
    except FileNotFoundError:
        raise CaptureError(f"{file}: no such file") from None
    except OSError as error:
        raise CaptureError(f"{file}: can't be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise CaptureError(f"{file}: can't be read ({error})") from None


@dataclass(frozen=True, slots=True, eq=False)
class KittiCamera:
    """A rectified camera: its 3x4 projection of points in the frame of the first rectified camera."""

    name: str
    projection: Float64[np.ndarray, "3 4"]

    def __post_init__(self) -> None:
        if not np.isfinite(self.projection).all() or abs(np.linalg.det(self.projection[:, :3])) < 1e-9:
            raise ValueError("its projection matrix is not one of a camera")

    @property
    def from_first(self) -> Float64[np.ndarray, "4 4"]:
        """First camera to this one: a shift along the baseline."""
        return translation_pose(np.linalg.solve(self.projection[:, :3], self.projection[:, 3]))

    def view(self, file: Path, name: str, time_s: float, world_to_first: Float64[np.ndarray, "4 4"]) -> CaptureFrame:
        """View of one rectified image, so without lens distortion; raises `CaptureError` or ValueError."""
        pose = self.from_first @ world_to_first
        camera = opencv_camera_of_matrix(self.projection, image_size(file), pose)
        return CaptureFrame(name, camera, partial(read_color, file), time_s, self.name)


def read_velodyne(file: Path) -> tuple[Float32[np.ndarray, "p 3"], Float32[np.ndarray, " p"]]:
    """Points (m, x forward, y left, z up) and reflectances (0..1) of a .bin; raises `CaptureError`."""
    try:
        data = read_file(file)
    except OSError as error:
        raise CaptureError(f"{file}: can't be read ({error.strerror})") from None
    if len(data) % 16 or not data:
        raise CaptureError(f"{file}: {len(data)} bytes are not rows of 4 numbers")
    rows = np.frombuffer(data, np.float32).reshape(-1, 4)
    return np.ascontiguousarray(rows[:, :3]), np.ascontiguousarray(rows[:, 3])


# KITTI odometry
# The world has the first pose's axes, rotated to x forward, y left and z up, like the vehicle's frame, which is the
# first camera's. The world is as level as that camera was on the road.

_COLOR, _GRAY = ("image_2", "image_3"), ("image_0", "image_1")
_TO_VEHICLE = invert_pose(OPENCV_FROM_VEHICLE_AXES)


def recognizes_kitti_odometry(path: Path) -> bool:
    """Return whether a path is a sequence (calib.txt, times.txt), or a folder with sequences/NN."""
    return _is_sequence(path) or any(_is_sequence(each) for each in _sequences(path))


def read_kitti_odometry(path: Path) -> Capture:
    """Read a sequence; for the dataset the first one with poses. Raises `CaptureError`."""
    if _is_sequence(path):
        return _read(path, DrivingLog(path.name, road_m=-CAMERA_HEIGHT_M))
    found = [each for each in _sequences(path) if _is_sequence(each)]
    posed = [each for each in found if _pose_file(each).is_file()]
    if not posed:
        raise CaptureError(f"{path}: no sequence of KITTI odometry with poses in it (sequences/00, poses/00.txt)")
    record = DrivingLog(posed[0].name, road_m=-CAMERA_HEIGHT_M)
    others = [str(each) for each in found if each != posed[0]]
    if others:
        record.problems.append(f"sequence {posed[0].name} is read; the others here: {abbreviated_names(others)}")
    return _read(posed[0], record)


def _is_sequence(path: Path) -> bool:
    return (path / "calib.txt").is_file() and (path / "times.txt").is_file()


def _sequences(path: Path) -> list[Path]:
    return sorted(path.glob("sequences/*")) or sorted(path.glob("dataset/sequences/*"))


def _pose_file(sequence: Path) -> Path:
    beside = sequence / "poses.txt"
    return beside if beside.is_file() else sequence.parent.parent / "poses" / f"{sequence.name}.txt"


def _read(folder: Path, record: DrivingLog) -> Capture:
    times = _times(folder / "times.txt")
    poses = _poses(_pose_file(folder), record.problems)
    known = [number for number in range(len(times)) if number in poses]
    in_world = {number: _TO_VEHICLE @ poses[number] for number in known}
    record.stamps = [(times[number], in_world[number] @ OPENCV_FROM_VEHICLE_AXES) for number in known]
    calibration = read_calibration(folder / "calib.txt")
    _images(folder, record, calibration, times, in_world)
    files = sorted((folder / "velodyne").glob("*.bin"))
    if files:
        try:
            to_first = rigid_from_numbers(numbers_of(calibration, "Tr", 12, folder / "calib.txt"))
        except (CaptureError, ValueError) as error:
            record.problems.append(f"lidar left out: {error}")
        else:
            to_vehicle = _TO_VEHICLE @ to_first
            record.scans, record.scan_count = _scans(files, record, dict(enumerate(times)), to_vehicle), len(files)
    return record.capture()


def _times(file: Path) -> list[float]:
    try:
        return [float(line) for line in read_text(file).split()]
    except ValueError as error:
        raise CaptureError(f"{file}: {error}") from None


def _poses(file: Path, problems: list[str]) -> dict[int, Float64[np.ndarray, "4 4"]]:
    """First camera to world, by image number."""
    if not file.is_file():
        raise CaptureError(f"{file}: no poses of this sequence (KITTI keeps those of 11 to 21); COLMAP can find them")
    poses: dict[int, Float64[np.ndarray, "4 4"]] = {}
    for number, line in enumerate(read_text(file).splitlines()):
        try:
            poses[number] = rigid_from_numbers([float(word) for word in line.split()])
        except ValueError as error:
            problems.append(f"{file}: line {number + 1}: {error}")
    return poses


def _images(
    folder: Path,
    record: DrivingLog,
    calibration: Calibration,
    times: list[float],
    in_world: dict[int, Float64[np.ndarray, "4 4"]],
) -> None:
    present = [name for name in _COLOR if (folder / name).is_dir()]
    for sensor in present or [name for name in _GRAY if (folder / name).is_dir()]:
        try:
            numbers = numbers_of(calibration, f"P{sensor[-1]}", 12, folder / "calib.txt")
            camera = KittiCamera(sensor, numbers.reshape(3, 4))
        except (CaptureError, ValueError) as error:
            record.problems.append(f"{sensor} left out: {error}")
            continue
        for file in images_in(folder / sensor):
            number = int(file.stem) if file.stem.isdecimal() else -1
            try:
                if number not in in_world:
                    raise ValueError("its pose or its time is not known")
                name = f"{number:04d}_{sensor}"
                record.views.append(camera.view(file, name, times[number], invert_pose(in_world[number])))
            except (CaptureError, ValueError) as error:
                record.problems.append(f"{sensor}/{file.name} left out: {error}")
    record.views.sort(key=lambda view: view.name)


def _scans(
    files: list[Path], record: DrivingLog, times: dict[int, float], to_vehicle: Float64[np.ndarray, "4 4"]
) -> Iterator[LidarScan]:
    places = dict(record.stamps)
    for file in files:
        try:
            time = times.get(int(file.stem)) if file.stem.isdecimal() else None
            if time is None or time not in places:
                raise ValueError("its pose or its time is not known")
            points, light = read_velodyne(file)
            yield LidarScan(time, places[time], transform_points(to_vehicle, points), to_vehicle[:3, 3], light)
        except (CaptureError, ValueError) as error:
            record.problems.append(f"velodyne/{file.name} left out: {error}")


# OXTS poses
# A Mercator projection as in devkit/matlab/convertOxtsToPose.m: scale of the first record's latitude, yaw 0 to the
# east. The world is x east, y north, z up; the frame is the inertial unit's: x forward, y left, z up.

OxtsRecord = Float64[np.ndarray, "6"]
"""Latitude, longitude (degrees), altitude (m), roll, pitch, yaw (rad)."""

_LARGEST_OXTS = 1e6  # maximum of angles and of meters above sea level; larger values indicate a damaged record
_EARTH_RADIUS_M = 6378137.0


def read_oxts(file: Path) -> OxtsRecord:
    """Read one record. Raises `CaptureError`."""
    words = read_text(file).split()
    try:
        values = np.array([float(word) for word in words[:6]], np.float64)
    except ValueError as error:
        raise CaptureError(f"{file}: {error}") from None
    if len(values) != 6 or not np.abs(values).max() < _LARGEST_OXTS or abs(values[0]) >= 90:
        raise CaptureError(f"{file}: expected latitude, longitude, altitude, roll, pitch and yaw first")
    return values


def oxts_poses(records: Sequence[OxtsRecord]) -> list[Float64[np.ndarray, "4 4"]]:
    """Poses (inertial unit to world, the first at the origin) of records."""
    if not records:
        return []
    scale = np.cos(np.radians(records[0][0])) * _EARTH_RADIUS_M
    places = [_mercator(record, scale) for record in records]
    return [rigid_pose(_turn(record[3:]), place - places[0]) for record, place in zip(records, places, strict=True)]


def _mercator(record: OxtsRecord, scale_m: float) -> Float64[np.ndarray, "3"]:
    latitude, longitude = np.radians(record[:2])
    return np.array([scale_m * longitude, scale_m * np.log(np.tan(np.pi / 4 + latitude / 2)), record[2]])


def _turn(roll_pitch_yaw: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    (cr, cp, cy), (sr, sp, sy) = np.cos(roll_pitch_yaw), np.sin(roll_pitch_yaw)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


# Tracklets (tracklet_labels.xml)


@dataclass(frozen=True, slots=True, eq=False)
class Tracklet:
    """One object over consecutive images."""

    class_name: str
    size_lwh: tuple[float, float, float]
    first_frame: int
    centers_to_lidar: tuple[Float64[np.ndarray, "4 4"], ...]
    """Box (x forward, y left, z up, origin at its center) to lidar, for each image from the first."""


def read_tracklets(file: Path) -> list[Tracklet]:
    """Read all; `CaptureError` if the file is damaged, or defines XML entities, which can expand without bound."""
    text = read_text(file)
    if "<!ENTITY" in text:
        raise CaptureError(f"{file}: refused, for it defines entities, which no file of KITTI does")
    try:
        items = list(ElementTree.fromstring(text).iterfind("tracklets/item"))
        return list(_tracklets(items))
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise CaptureError(f"{file}: not a readable list of tracklets ({error})") from None


def _tracklets(items: list[ElementTree.Element]) -> Iterator[Tracklet]:
    for item in items:
        height, width, length = (_number(item, name) for name in ("h", "w", "l"))
        poses = tuple(_pose(pose, height) for pose in item.iterfind("poses/item"))
        if poses:
            name, first = item.findtext("objectType", "unknown").strip(), int(_number(item, "first_frame"))
            yield Tracklet(name, (length, width, height), first, poses)


def _pose(item: ElementTree.Element, height: float) -> Float64[np.ndarray, "4 4"]:
    """Pose of a box center; the file has the position of the bottom center, and uses only the angle rz."""
    x, y, z, turn = (_number(item, name) for name in ("tx", "ty", "tz", "rz"))
    cosine, sine = np.cos(turn), np.sin(turn)
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return rigid_pose(rotation, np.array([x, y, z + height / 2]))


def _number(item: ElementTree.Element, name: str) -> float:
    text = item.findtext(name)
    if text is None:
        raise ValueError(f"an item without {name}")
    return float(text)


# KITTI raw
# The vehicle's frame is that of the inertial unit (x forward, y left, z up); the world is x east, y north, z up.

_CAMERAS, _GRAY_CAMERAS = ("image_02", "image_03"), ("image_00", "image_01")
_CALIBRATIONS = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt")
_Poses = dict[int, Float64[np.ndarray, "4 4"]]


def recognizes_kitti_raw(path: Path) -> bool:
    """Return whether a path is a drive (oxts and image_02), or the folder of a day (calib_cam_to_cam.txt)."""
    return _is_drive(path) or ((path / _CALIBRATIONS[0]).is_file() and bool(_drives(path)))


def read_kitti_raw(path: Path) -> Capture:
    """Read a drive, or the first of a day. Raises `CaptureError`, also for recordings that are not rectified."""
    problems: list[str] = []
    if not _is_drive(path):
        drives = _drives(path)
        if not drives:
            raise CaptureError(f"{path}: no drive of KITTI in it (YYYY_MM_DD_drive_NNNN_sync/oxts)")
        if drives[1:]:
            others = [each.name for each in drives[1:]]
            problems.append(f"{drives[0].name} is read; the others here: {abbreviated_names(others)}")
        path = drives[0]
    if path.name.endswith("_extract"):
        raise CaptureError(f"{path}: these pictures are not rectified; take the synced and rectified drive (_sync)")
    return _KittiDrive(path, problems).capture()


def _is_drive(path: Path) -> bool:
    return (path / "oxts" / "data").is_dir() and any((path / name).is_dir() for name in (*_CAMERAS, *_GRAY_CAMERAS))


def _drives(day: Path) -> list[Path]:
    return sorted(each for each in day.glob("*_drive_*") if _is_drive(each))


class _KittiDrive:
    """Reader of one drive, by image number."""

    def __init__(self, folder: Path, problems: list[str]) -> None:
        self.folder = folder
        self.record = DrivingLog(folder.name, road_m=-IMU_HEIGHT_M, problems=problems)
        day = folder if (folder / _CALIBRATIONS[0]).is_file() else folder.parent
        cam_to_cam, velo_to_cam, imu_to_velo = (read_calibration(day / name) for name in _CALIBRATIONS)
        self._projections, self._cam_file = cam_to_cam, day / _CALIBRATIONS[0]
        rectify = _rigid(numbers_of(cam_to_cam, "R_rect_00", 9, self._cam_file), np.zeros(3), self._cam_file)
        self.lidar_to_first = rectify @ _pose_of_lines(velo_to_cam, day / _CALIBRATIONS[1])
        self.imu_to_lidar = _pose_of_lines(imu_to_velo, day / _CALIBRATIONS[2])
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
                records[_frame_number(file)] = read_oxts(file)
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
        for sensor in present or [name for name in _GRAY_CAMERAS if (self.folder / name).is_dir()]:
            try:
                numbers = numbers_of(self._projections, f"P_rect_{sensor[-2:]}", 12, self._cam_file)
                camera, times = KittiCamera(sensor, numbers.reshape(3, 4)), self._times(sensor)
            except (CaptureError, ValueError) as error:
                self.record.problems.append(f"{sensor} left out: {error}")
                continue
            for file in images_in(self.folder / sensor / "data"):
                try:
                    number = _frame_number(file)
                    if number not in self.poses or number not in times:
                        raise ValueError("the place or the time of the vehicle is not known")
                    world_to_first = self.lidar_to_first @ self.imu_to_lidar @ invert_pose(self.poses[number])
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
                to_world = self.poses[number] @ invert_pose(self.imu_to_lidar) @ to_lidar
                try:
                    sample = BoxSample(str(name), each.class_name, times[number], each.size_lwh, to_world)
                except ValueError as error:
                    self.record.problems.append(f"tracklet {name} left out: {error}")
                    break
                self.record.boxes.append(sample)

    def _scans(self, files: list[Path], times: dict[int, float]) -> Iterator[LidarScan]:
        to_vehicle = invert_pose(self.imu_to_lidar)
        for file in files:
            try:
                number = _frame_number(file)
                if number not in self.poses or number not in times:
                    raise ValueError("the place or the time of the vehicle is not known")
                points, light = read_velodyne(file)
                placed = transform_points(to_vehicle, points)
                yield LidarScan(times[number], self.poses[number], placed, to_vehicle[:3, 3], light)
            except (CaptureError, ValueError) as error:
                self.record.problems.append(f"velodyne_points/{file.name} left out: {error}")


def _pose_of_lines(values: Calibration, file: Path) -> Float64[np.ndarray, "4 4"]:
    return _rigid(numbers_of(values, "R", 9, file), numbers_of(values, "T", 3, file), file)


def _rigid(turn: Float64[np.ndarray, "9"], place: Float64[np.ndarray, "3"], file: Path) -> Float64[np.ndarray, "4 4"]:
    try:
        return rigid_from_numbers(np.column_stack([turn.reshape(3, 3), place]))
    except ValueError as error:
        raise CaptureError(f"{file}: {error}") from None


def _frame_number(file: Path) -> int:
    if not file.stem.isdecimal():
        raise ValueError(f"{file.name}: not the number of a picture")
    return int(file.stem)


def _seconds(line: str) -> float:
    """Time stamp with nanoseconds, which datetime does not support; ValueError if invalid."""
    whole, _, fraction = line.strip().partition(".")
    moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
    return (moment - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds() + float(f"0.{fraction or 0}")
