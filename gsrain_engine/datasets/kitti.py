"""KITTI: odometry sequences and raw drives, with their calibrations, poses, lidar and boxes.

Facts: Geiger et al., "Vision meets Robotics: The KITTI Dataset" (2013), and the readme of its development kit.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from .capture import Capture, CaptureError, CaptureFrame, abbreviated_names
from .driving_log import DrivingLog, LidarScan
from .geometry import (
    OPENCV_FROM_VEHICLE_AXES,
    BoxSample,
    Pose,
    heading_pose,
    invert_pose,
    opencv_camera_of_matrix,
    rigid_from_numbers,
    rigid_pose,
    translation_pose,
)
from .io.arrays import read_text
from .io.images import image_size, images_in, read_color
from .io.sweep_files import RowFile

Calibration = dict[str, Float64[np.ndarray, " _"]]
"""Numbers of each line of a file, by its name."""

_Poses = Mapping[int, Pose]
Times = Mapping[int, float]
"""Poses and times by the number of an image."""

MAX_TEXT_BYTES = 1 << 28
_LARGEST = 1e12  # larger numbers indicate a damaged file
IMU_HEIGHT_M, CAMERA_HEIGHT_M = 0.93, 1.65
"""Height of the recording car's sensors above the road (figure 3 of the paper)."""


@dataclass(frozen=True, slots=True, eq=False)
class KittiCamera:
    """A rectified camera: its 3x4 projection of points in the frame of the first rectified camera."""

    name: str
    projection: Float64[np.ndarray, "3 4"]

    def __post_init__(self) -> None:
        if not np.isfinite(self.projection).all() or abs(np.linalg.det(self.projection[:, :3])) < 1e-9:
            raise ValueError("its projection matrix is not one of a camera")

    @property
    def from_first(self) -> Pose:
        """First camera to this one: a shift along the baseline."""
        return translation_pose(np.linalg.solve(self.projection[:, :3], self.projection[:, 3]))

    def view(self, file: Path, name: str, time_s: float, world_to_first: Pose) -> CaptureFrame:
        """View of one rectified image, so without lens distortion; raises `CaptureError` or ValueError."""
        camera = opencv_camera_of_matrix(self.projection, image_size(file), self.from_first @ world_to_first)
        return CaptureFrame(name, camera, partial(read_color, file), time_s, self.name)


def read_kitti_calibration(file: Path) -> Calibration:
    """Read lines of `name: numbers`, skipping others. Raises `CaptureError`."""
    values: Calibration = {}
    for line in read_text(file, MAX_TEXT_BYTES).splitlines():
        name, _, rest = line.partition(":")
        try:
            values[name.strip()] = np.array([float(word) for word in rest.split()], np.float64)
        except ValueError:
            continue  # a date, or the time of day of the calibration
    return values


def calibration_numbers(values: Calibration, name: str, count: int, file: Path) -> Float64[np.ndarray, " n"]:
    """Numbers of one name; `CaptureError` if missing or not `count` finite ones."""
    found = values.get(name)
    if found is None or len(found) != count or not np.abs(found).max(initial=0) < _LARGEST:
        has = "no such line" if found is None else f"{len(found)} numbers"
        raise CaptureError(f"{file}: expected {count} finite numbers at {name}, it has {has}")
    return found


def _number_of(file: Path, *known: Mapping[int, object]) -> int:
    """Number of an image or lidar file; ValueError if it is not known in all mappings."""
    number = int(file.stem) if file.stem.isdecimal() else -1
    if number < 0 or not all(number in each for each in known):
        raise ValueError("its number, or the vehicle's place or time for it, is not known")
    return number


def add_kitti_views(
    log: DrivingLog,
    folder: Path,
    sensors: Sequence[str],
    below: str,
    camera_of: Callable[[str], tuple[KittiCamera, Times]],
    world_to_first: _Poses,
) -> None:
    """Add the images of the color cameras, the first two `sensors`, or of the gray ones if there are none.

    `camera_of` returns the calibration and times of a sensor, or raises ValueError.
    """
    there = [sensor for sensor in sensors if (folder / sensor).is_dir()]
    for sensor in [each for each in there if each in sensors[:2]] or there:
        with log.omitting(sensor):
            camera, times = camera_of(sensor)
            for file in images_in(folder / sensor / below):
                with log.omitting(f"{sensor}/{file.name}"):
                    number = _number_of(file, times, world_to_first)
                    name = f"{number:04d}_{sensor}"
                    log.views.append(camera.view(file, name, times[number], world_to_first[number]))
    log.views.sort(key=lambda view: view.name)


def kitti_scans(
    log: DrivingLog,
    sensor: str,
    files: Sequence[Path],
    times: Times,
    poses: _Poses,
    to_vehicle: Pose,
) -> Iterator[LidarScan]:
    """Turns of a lidar in files of x, y, z and reflectance, for which a time and the vehicle's pose are known."""
    for file in files:
        with log.omitting(f"{sensor}/{file.name}"):
            number = _number_of(file, times, poses)
            key = RowFile(file, 4)  # m, x forward, y left, z up; reflectance 0..1
            turn = key.read()
            yield LidarScan.placed(times[number], poses[number], to_vehicle, turn.points_m, turn.intensities, key)


# KITTI odometry
# The world has the first pose's axes, rotated to x forward, y left and z up, like the vehicle's frame, which is the
# first camera's. The world is as level as that camera was on the road.

_TO_VEHICLE = invert_pose(OPENCV_FROM_VEHICLE_AXES)


def recognizes_kitti_odometry(path: Path) -> bool:
    """Return whether a path is a sequence (calib.txt, times.txt), or a folder with sequences/NN."""
    return _is_sequence(path) or any(_is_sequence(each) for each in _sequences(path))


def read_kitti_odometry(path: Path) -> Capture:
    """Read a sequence; for the dataset the first one with poses. Raises `CaptureError`."""
    if _is_sequence(path):
        return _read_sequence(path, [])
    found = [each for each in _sequences(path) if _is_sequence(each)]
    posed = [each for each in found if _pose_file(each).is_file()]
    if not posed:
        raise CaptureError(f"{path}: no sequence of KITTI odometry with poses in it (sequences/00, poses/00.txt)")
    others = [str(each) for each in found if each != posed[0]]
    read = f"sequence {posed[0].name} is read; the others here: {abbreviated_names(others)}"
    return _read_sequence(posed[0], [read] if others else [])


def _is_sequence(path: Path) -> bool:
    return (path / "calib.txt").is_file() and (path / "times.txt").is_file()


def _sequences(path: Path) -> list[Path]:
    return sorted(path.glob("sequences/*")) or sorted(path.glob("dataset/sequences/*"))


def _pose_file(sequence: Path) -> Path:
    own = sequence / "poses.txt"
    return own if own.is_file() else sequence.parent.parent / "poses" / f"{sequence.name}.txt"


def _read_sequence(folder: Path, problems: list[str]) -> Capture:
    log = DrivingLog(folder.name, road_m=-CAMERA_HEIGHT_M, problems=problems)
    file = folder / "times.txt"
    try:
        times = dict(enumerate(float(line) for line in read_text(file, MAX_TEXT_BYTES).split()))
    except ValueError as error:
        raise CaptureError(f"{file}: {error}") from None
    poses = _first_camera_poses(_pose_file(folder), problems)
    to_world = {number: _TO_VEHICLE @ poses[number] for number in times if number in poses}
    log.stamps = [(times[number], pose @ OPENCV_FROM_VEHICLE_AXES) for number, pose in to_world.items()]
    file = folder / "calib.txt"
    calibration = read_kitti_calibration(file)

    def camera_of(sensor: str) -> tuple[KittiCamera, Times]:
        return KittiCamera(sensor, calibration_numbers(calibration, f"P{sensor[-1]}", 12, file).reshape(3, 4)), times

    to_first = {number: invert_pose(pose) for number, pose in to_world.items()}
    sensors = [f"image_{k}" for k in (2, 3, 0, 1)]
    add_kitti_views(log, folder, sensors, "", camera_of, to_first)
    files = sorted((folder / "velodyne").glob("*.bin"))
    if files:
        with log.omitting("lidar"):
            to_vehicle = _TO_VEHICLE @ rigid_from_numbers(calibration_numbers(calibration, "Tr", 12, file))
            places = dict(log.stamps)
            vehicles = {number: places[time] for number, time in times.items() if time in places}
            log.scans = kitti_scans(log, "velodyne", files, times, vehicles, to_vehicle)
            log.scan_count = len(files)
    return log.capture()


def _first_camera_poses(file: Path, problems: list[str]) -> dict[int, Pose]:
    """First camera to world, by image number."""
    if not file.is_file():
        raise CaptureError(f"{file}: no poses of this sequence (KITTI keeps those of 11 to 21); COLMAP can find them")
    poses: dict[int, Pose] = {}
    for number, line in enumerate(read_text(file, MAX_TEXT_BYTES).splitlines()):
        try:
            poses[number] = rigid_from_numbers([float(word) for word in line.split()])
        except ValueError as error:
            problems.append(f"{file}: line {number + 1}: {error}")
    return poses


# KITTI raw
# The vehicle's frame is that of the inertial unit (x forward, y left, z up); the world is x east, y north, z up.

_CAMERAS = ("image_02", "image_03", "image_00", "image_01")
_CALIBRATIONS = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt")


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
    return _read_drive(path, problems)


def kitti_surroundings(drive: Path) -> tuple[Path, Mapping[Path, Path]]:
    """Place of a drive in a folder that is complete, and of its files outside: calibration (raw), poses (odometry).

    Both places are relative to that folder; "." and no files for any other folder.
    """
    if _is_drive(drive):
        files = [each for name in _CALIBRATIONS if (each := drive.parent / name).is_file()]
        return (Path(drive.name), {each: Path(each.name) for each in files}) if files else (Path(), {})
    if _is_sequence(drive) and (poses := _pose_file(drive)).parent != drive and poses.is_file():
        return Path("sequences", drive.name), {poses: Path("poses", poses.name)}
    return Path(), {}


def _is_drive(path: Path) -> bool:
    return (path / "oxts" / "data").is_dir() and any((path / name).is_dir() for name in _CAMERAS)


def _drives(day: Path) -> list[Path]:
    return sorted(each for each in day.glob("*_drive_*") if _is_drive(each))


def _read_drive(folder: Path, problems: list[str]) -> Capture:
    log = DrivingLog(folder.name, road_m=-IMU_HEIGHT_M, problems=problems)
    day = folder if (folder / _CALIBRATIONS[0]).is_file() else folder.parent
    camera_file, lidar_file, imu_file = (day / name for name in _CALIBRATIONS)
    cameras, lidar, imu = (read_kitti_calibration(file) for file in (camera_file, lidar_file, imu_file))
    rectify = calibration_turn(cameras, "R_rect_00", camera_file)
    lidar_to_first = rectify @ _calibrated_pose(lidar, lidar_file)
    imu_to_lidar = _calibrated_pose(imu, imu_file)
    records: dict[int, OxtsRecord] = {}
    for file in sorted((folder / "oxts" / "data").glob("*.txt")):
        with log.omitting("a place of the vehicle"):
            records[_number_of(file)] = _read_oxts(file)
    poses = dict(zip(records, oxts_poses(list(records.values())), strict=True))
    times = read_kitti_times(folder / "oxts", problems)
    log.stamps = [(times[k], pose) for k, pose in poses.items() if k in times]

    def camera_of(sensor: str) -> tuple[KittiCamera, Times]:
        projection = calibration_numbers(cameras, f"P_rect_{sensor[-2:]}", 12, camera_file).reshape(3, 4)
        return KittiCamera(sensor, projection), read_kitti_times(folder / sensor, problems)

    to_first = {number: lidar_to_first @ imu_to_lidar @ invert_pose(pose) for number, pose in poses.items()}
    add_kitti_views(log, folder, _CAMERAS, "data", camera_of, to_first)
    lidar_folder = folder / "velodyne_points"
    lidar_times = read_kitti_times(lidar_folder, problems) if lidar_folder.is_dir() else {}
    to_vehicle = invert_pose(imu_to_lidar)
    if (folder / "tracklet_labels.xml").is_file():
        with log.omitting("boxes"):
            _add_boxes(log, folder / "tracklet_labels.xml", lidar_times or times, poses, to_vehicle)
    files = sorted((lidar_folder / "data").glob("*.bin"))
    log.scans = kitti_scans(log, "velodyne_points", files, lidar_times, poses, to_vehicle)
    log.scan_count = len(files)
    return log.capture()


def calibration_turn(values: Calibration, name: str, file: Path) -> Pose:
    """Rotation of one name; raises `CaptureError`."""
    return _rigid(calibration_numbers(values, name, 9, file), np.zeros(3), file)


def read_kitti_times(sensor: Path, problems: list[str]) -> dict[int, float]:
    """Times of a sensor's images or turns, by their numbers. Raises `CaptureError` without the file."""
    times: dict[int, float] = {}
    for number, line in enumerate(read_text(sensor / "timestamps.txt", MAX_TEXT_BYTES).splitlines()):
        try:
            times[number] = _seconds(line)
        except ValueError:
            if line.strip():
                problems.append(f"{sensor / 'timestamps.txt'}: line {number + 1} is no time stamp")
    return times


def _seconds(line: str) -> float:
    """Time stamp with nanoseconds, which datetime does not support; ValueError if invalid."""
    whole, _, fraction = line.strip().partition(".")
    moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
    return (moment - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds() + float(f"0.{fraction or 0}")


def _add_boxes(log: DrivingLog, file: Path, times: Times, poses: _Poses, lidar_to_vehicle: Pose) -> None:
    items = _read_tracklets(file)
    log.box_times_s = [times[number] for number in poses if number in times]
    for name, (class_name, size, first, centers_to_lidar) in enumerate(items):
        with log.omitting(f"tracklet {name}"):
            for number, to_lidar in enumerate(centers_to_lidar, first):
                if number in poses and number in times:
                    to_world = poses[number] @ lidar_to_vehicle @ to_lidar
                    log.boxes.append(BoxSample(str(name), class_name, times[number], size, to_world))


def _calibrated_pose(values: Calibration, file: Path) -> Pose:
    return _rigid(calibration_numbers(values, "R", 9, file), calibration_numbers(values, "T", 3, file), file)


def _rigid(turn: Float64[np.ndarray, "9"], place: Float64[np.ndarray, "3"], file: Path) -> Pose:
    try:
        return rigid_from_numbers(np.column_stack([turn.reshape(3, 3), place]))
    except ValueError as error:
        raise CaptureError(f"{file}: {error}") from None


# OXTS poses
# A Mercator projection as in devkit/matlab/convertOxtsToPose.m: scale of the first record's latitude, yaw 0 to the
# east. The world is x east, y north, z up; the frame is the inertial unit's: x forward, y left, z up.

OxtsRecord = Float64[np.ndarray, "6"]
"""Latitude, longitude (degrees), altitude (m), roll, pitch, yaw (rad)."""

_LARGEST_OXTS = 1e6  # maximum of angles and of meters above sea level; larger values indicate a damaged record
_EARTH_RADIUS_M = 6378137.0


def oxts_poses(records: Sequence[OxtsRecord]) -> list[Pose]:
    """Poses (inertial unit to world, the first at the origin) of records."""
    if not records:
        return []
    scale = np.cos(np.radians(records[0][0])) * _EARTH_RADIUS_M
    places = [_mercator(record, scale) for record in records]
    return [rigid_pose(_turn(record[3:]), place - places[0]) for record, place in zip(records, places, strict=True)]


def _read_oxts(file: Path) -> OxtsRecord:
    words = read_text(file, MAX_TEXT_BYTES).split()
    try:
        values = np.array([float(word) for word in words[:6]], np.float64)
    except ValueError as error:
        raise CaptureError(f"{file}: {error}") from None
    if len(values) != 6 or not np.abs(values).max() < _LARGEST_OXTS or abs(values[0]) >= 90:
        raise CaptureError(f"{file}: expected latitude, longitude, altitude, roll, pitch and yaw first")
    return values


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

_Tracklet = tuple[str, tuple[float, float, float], int, list[Pose]]
"""Class, length, width and height (m), first image, and box center to lidar for each image from the first."""


def _read_tracklets(file: Path) -> list[_Tracklet]:
    try:
        items = [_tracklet(item) for item in read_kitti_xml(file).iterfind("tracklets/item")]
    except ValueError as error:
        raise CaptureError(f"{file}: not a readable list of tracklets ({error})") from None
    return [item for item in items if item is not None]


def read_kitti_xml(file: Path) -> ElementTree.Element:
    """Root of a file; `CaptureError` if it is damaged, or defines entities, which can expand without bound."""
    text = read_text(file, MAX_TEXT_BYTES)
    if "<!ENTITY" in text:
        raise CaptureError(f"{file}: refused, for it defines entities, which no file of KITTI does")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise CaptureError(f"{file}: not readable XML ({error})") from None


def _tracklet(item: ElementTree.Element) -> _Tracklet | None:
    height, width, length = (_number(item, name) for name in ("h", "w", "l"))
    poses: list[Pose] = []
    for pose in item.iterfind("poses/item"):  # the position is that of the bottom; only the angle rz is used
        x, y, z, turn = (_number(pose, name) for name in ("tx", "ty", "tz", "rz"))
        poses.append(heading_pose((x, y, z + height / 2), turn))
    if not poses:
        return None
    name, first = item.findtext("objectType", "unknown").strip(), int(_number(item, "first_frame"))
    return name, (length, width, height), first, poses


def _number(item: ElementTree.Element, name: str) -> float:
    text = item.findtext(name)
    if text is None:
        raise ValueError(f"an item without {name}")
    return float(text)
