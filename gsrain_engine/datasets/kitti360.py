"""KITTI-360: drives with two rectified cameras, poses, lidar and boxes.

The files' vehicle frame is the inertial unit's: x forward, y right, z down; the world is z up. Fisheye cameras are left
out. Facts: Liao et al., "KITTI-360" (2022), and kitti360scripts/helpers of github.com/autonomousvision/kitti360Scripts.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from .capture import Capture, CaptureError, abbreviated_names
from .driving_log import DrivingLog
from .geometry import BoxSample, Pose, invert_pose, rigid_from_numbers
from .io.arrays import read_text
from .kitti import (
    MAX_TEXT_BYTES,
    KittiCamera,
    Times,
    add_kitti_views,
    calibration_numbers,
    calibration_turn,
    kitti_scans,
    read_kitti_calibration,
    read_kitti_times,
    read_kitti_xml,
)

_PICTURES, _LIDAR, _POSES, _BOXES = "data_2d_raw", "data_3d_raw", "data_poses", "data_3d_bboxes"
_CAMERAS, _FISHEYES = ("image_00", "image_01"), ("image_02", "image_03")
_INTRINSICS, _MOUNTS, _TO_LIDAR = (
    f"calibration/{name}.txt" for name in ("perspective", "calib_cam_to_pose", "calib_cam_to_velo")
)
_IMU_HEIGHT_M = 0.90  # cameras are 1.55 m above the road, and 0.65 m above the inertial unit
_FROM_IMU_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
_OBJECTS = frozenset(["bicycle", "bus", "car", "caravan", "motorcycle", "person", "rider", "trailer", "train", "truck"])
"""Labels of boxes that are read; the others are of buildings, poles and the like."""


def recognizes_kitti360(path: Path) -> bool:
    """Return whether a path is the folder of the data set, or ROOT/DRIVE (a name, not a folder on disk)."""
    return _is_root(path) or (_is_root(path.parent) and (path.parent / _PICTURES / path.name).is_dir())


def read_kitti360(path: Path) -> Capture:
    """Read one drive: ROOT/2013_05_28_drive_0000_sync or, for the data set, the first with poses.

    Raises `CaptureError`.
    """
    root, name = (path, None) if _is_root(path) else (path.parent, path.name)
    drives = sorted(file.parent.name for file in (root / _POSES).glob("*/poses.txt"))
    there = [each for each in drives if (root / _PICTURES / each).is_dir()]
    if name is None and not there:
        raise CaptureError(f"{root}: no drive with pictures and poses ({_PICTURES}/DRIVE, {_POSES}/DRIVE/poses.txt)")
    drive = name or there[0]
    others = [] if name else [str(root / each) for each in there[1:]]
    problems = [f"{drive} is read; the others here: {abbreviated_names(others)}"] if others else []
    return _read_drive(root, drive, problems)


def _is_root(path: Path) -> bool:
    return (path / _PICTURES).is_dir() and (path / _INTRINSICS).is_file()


def _read_drive(root: Path, drive: str, problems: list[str]) -> Capture:
    log = DrivingLog(drive, road_m=-_IMU_HEIGHT_M, problems=problems)
    calibration, mounts = read_kitti_calibration(root / _INTRINSICS), read_kitti_calibration(root / _MOUNTS)
    rectify = calibration_turn(calibration, "R_rect_00", root / _INTRINSICS)
    first_to_imu = _pose(calibration_numbers(mounts, _CAMERAS[0], 12, root / _MOUNTS), root / _MOUNTS)
    imu_to_first = rectify @ invert_pose(first_to_imu)
    poses = _read_poses(root / _POSES / drive / "poses.txt", problems)
    vehicles = {number: pose @ _FROM_IMU_AXES for number, pose in poses.items()}
    folder = root / _PICTURES / drive
    by_camera: dict[str, Times] = {}
    for sensor in _CAMERAS:
        if (folder / sensor).is_dir():
            with log.omitting(sensor):
                by_camera[sensor] = read_kitti_times(folder / sensor, problems)

    def camera_of(sensor: str) -> tuple[KittiCamera, Times]:
        projection = calibration_numbers(calibration, f"P_rect_{sensor[-2:]}", 12, root / _INTRINSICS)
        return KittiCamera(sensor, projection.reshape(3, 4)), by_camera[sensor]

    to_first = {number: imu_to_first @ invert_pose(pose) for number, pose in poses.items()}
    add_kitti_views(log, folder, tuple(by_camera), "data_rect", camera_of, to_first)
    if fisheyes := [each for each in _FISHEYES if (folder / each).is_dir()]:
        problems.append(f"{' and '.join(fisheyes)} left out: fisheye cameras of 180 degrees are not read")
    times = next(iter(by_camera.values()), {})
    log.stamps = [(times[number], pose) for number, pose in vehicles.items() if number in times]
    turns = root / _LIDAR / drive / "velodyne_points"
    if turns.is_dir():
        with log.omitting("lidar"):
            words = read_text(root / _TO_LIDAR, MAX_TEXT_BYTES).split()
            first_to_lidar = _pose([float(word) for word in words], root / _TO_LIDAR)
            to_vehicle = invert_pose(_FROM_IMU_AXES) @ first_to_imu @ invert_pose(first_to_lidar)
            files = sorted((turns / "data").glob("*.bin"))
            log.scans = kitti_scans(log, turns.name, files, read_kitti_times(turns, problems), vehicles, to_vehicle)
            log.scan_count = len(files)
    file = next(iter(sorted((root / _BOXES).glob(f"*/{drive}.xml"))), None)
    if file is not None:
        with log.omitting("boxes"):
            _add_boxes(log, file, {number: times[number] for number in poses if number in times})
    return log.capture()


def _read_poses(file: Path, problems: list[str]) -> dict[int, Pose]:
    """Inertial unit to world, by the number of the image."""
    poses: dict[int, Pose] = {}
    for row, line in enumerate(read_text(file, MAX_TEXT_BYTES).splitlines()):
        try:
            number, *values = (float(word) for word in line.split())
            poses[int(number)] = rigid_from_numbers(values)
        except (ValueError, OverflowError) as error:
            problems.append(f"{file}: line {row + 1}: {error}")
    return poses


def _pose(values: object, file: Path) -> Pose:
    try:
        return rigid_from_numbers(values)
    except ValueError as error:
        raise CaptureError(f"{file}: {error}") from None


class _Box(NamedTuple):
    id: str
    label: str
    size_lwh: tuple[float, float, float]
    center_to_world: Pose
    first: int
    last: int
    """Numbers of the images for which it stands there."""


def _add_boxes(log: DrivingLog, file: Path, times: Mapping[int, float]) -> None:
    log.box_times_s = list(times.values())
    numbers = np.array(list(times), np.int64)
    for item in read_kitti_xml(file):
        if (item.findtext("label") or "").strip() in _OBJECTS:
            with log.omitting(f"box {item.tag}"):
                box = _read_box(item)
                for number in numbers[(numbers >= box.first) & (numbers <= box.last)].tolist():
                    log.boxes.append(BoxSample(box.id, box.label, times[number], box.size_lwh, box.center_to_world))


def _read_box(item: ElementTree.Element) -> _Box:
    """Box of an object that stands still (time stamp -1), or of one moment of one that moves. Raises ValueError."""
    moment, label = _integer(item, "timestamp"), (item.findtext("label") or "").strip()
    first, last = (moment, moment) if moment >= 0 else (_integer(item, "start_frame"), _integer(item, "end_frame"))
    transform, corners = _matrix(item, "transform"), _matrix(item, "vertices")
    if transform.shape != (4, 4) or corners.ndim != 2 or corners.shape[1] != 3 or not len(corners):
        raise ValueError(f"a transform of {transform.shape} and vertices of {corners.shape}")
    scales = np.linalg.norm(transform[:3, :3], axis=0)
    if not (scales > 0).all():
        raise ValueError("its transform is not finite, or flat")
    low, high = corners.min(axis=0), corners.max(axis=0)
    center = transform[:3, :3] @ ((low + high) / 2) + transform[:3, 3]
    pose = rigid_from_numbers(np.column_stack([transform[:3, :3] / scales, center]))
    length, width, height = (scales * (high - low)).tolist()
    name = f"{_integer(item, 'semanticId')}-{_integer(item, 'instanceId')}"
    return _Box(name, label, (length, width, height), pose, first, last)


def _integer(item: ElementTree.Element, name: str) -> int:
    return int(item.findtext(name, "").strip())


def _matrix(item: ElementTree.Element, name: str) -> Float64[np.ndarray, "r c"]:
    """Matrix as OpenCV writes it."""
    data = item.findtext(f"{name}/data", "").split()
    rows, columns = (int(item.findtext(f"{name}/{each}", "").strip()) for each in ("rows", "cols"))
    return np.array([float(word) for word in data], np.float64).reshape(rows, columns)
