"""KITTI odometry: a sequence of rectified pictures with the poses of its first camera.

The world has the first pose's axes, turned so that x is forward, y left and z up; so is the vehicle's frame, the first
camera's. It is as level as that camera stood on the road.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from ..capture import Capture, CaptureError
from ..driving_record import DrivingRecord, Scan
from ..files.picture_file import pictures_in
from ..geometry.rigid_poses import OPENCV_FROM_VEHICLE_AXES, inverse, rigid_from_numbers, transformed
from ..named_problems import some_names
from .calibration import (
    CAMERA_HEIGHT_M,
    Calibration,
    KittiCamera,
    numbers_of,
    read_calibration,
    read_text,
    read_velodyne,
)

_COLOR, _GREY = ("image_2", "image_3"), ("image_0", "image_1")
_TO_VEHICLE = inverse(OPENCV_FROM_VEHICLE_AXES)


def recognizes_kitti_odometry(path: Path) -> bool:
    """Whether a path is a sequence (calib.txt, times.txt), or a folder with sequences/NN."""
    return _is_sequence(path) or any(_is_sequence(each) for each in _sequences(path))


def read_kitti_odometry(path: Path) -> Capture:
    """Read a sequence; of the data set the first one with poses. Raises `CaptureError`."""
    if _is_sequence(path):
        return _read(path, DrivingRecord(path.name, road_m=-CAMERA_HEIGHT_M))
    found = [each for each in _sequences(path) if _is_sequence(each)]
    posed = [each for each in found if _pose_file(each).is_file()]
    if not posed:
        raise CaptureError(f"{path}: no sequence of KITTI odometry with poses in it (sequences/00, poses/00.txt)")
    record = DrivingRecord(posed[0].name, road_m=-CAMERA_HEIGHT_M)
    others = [str(each) for each in found if each != posed[0]]
    if others:
        record.problems.append(f"sequence {posed[0].name} is read; the others here: {some_names(others)}")
    return _read(posed[0], record)


def _is_sequence(path: Path) -> bool:
    return (path / "calib.txt").is_file() and (path / "times.txt").is_file()


def _sequences(path: Path) -> list[Path]:
    return sorted(path.glob("sequences/*")) or sorted(path.glob("dataset/sequences/*"))


def _pose_file(sequence: Path) -> Path:
    beside = sequence / "poses.txt"
    return beside if beside.is_file() else sequence.parent.parent / "poses" / f"{sequence.name}.txt"


def _read(folder: Path, record: DrivingRecord) -> Capture:
    times = _times(folder / "times.txt")
    poses = _poses(_pose_file(folder), record.problems)
    known = [number for number in range(len(times)) if number in poses]
    in_world = {number: _TO_VEHICLE @ poses[number] for number in known}
    record.stamps = [(times[number], in_world[number] @ OPENCV_FROM_VEHICLE_AXES) for number in known]
    calibration = read_calibration(folder / "calib.txt")
    _pictures(folder, record, calibration, times, in_world)
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
    """First camera to world, by picture numbers."""
    if not file.is_file():
        raise CaptureError(f"{file}: no poses of this sequence (KITTI keeps those of 11 to 21); COLMAP can find them")
    poses: dict[int, Float64[np.ndarray, "4 4"]] = {}
    for number, line in enumerate(read_text(file).splitlines()):
        try:
            poses[number] = rigid_from_numbers([float(word) for word in line.split()])
        except ValueError as error:
            problems.append(f"{file}: line {number + 1}: {error}")
    return poses


def _pictures(
    folder: Path,
    record: DrivingRecord,
    calibration: Calibration,
    times: list[float],
    in_world: dict[int, Float64[np.ndarray, "4 4"]],
) -> None:
    present = [name for name in _COLOR if (folder / name).is_dir()]
    for sensor in present or [name for name in _GREY if (folder / name).is_dir()]:
        try:
            numbers = numbers_of(calibration, f"P{sensor[-1]}", 12, folder / "calib.txt")
            camera = KittiCamera(sensor, numbers.reshape(3, 4))
        except (CaptureError, ValueError) as error:
            record.problems.append(f"{sensor} left out: {error}")
            continue
        for file in pictures_in(folder / sensor):
            number = int(file.stem) if file.stem.isdecimal() else -1
            try:
                if number not in in_world:
                    raise ValueError("its pose or its time is not known")
                name = f"{number:04d}_{sensor}"
                record.views.append(camera.view(file, name, times[number], inverse(in_world[number])))
            except (CaptureError, ValueError) as error:
                record.problems.append(f"{sensor}/{file.name} left out: {error}")
    record.views.sort(key=lambda view: view.name)


def _scans(
    files: list[Path], record: DrivingRecord, times: dict[int, float], to_vehicle: Float64[np.ndarray, "4 4"]
) -> Iterator[Scan]:
    places = dict(record.stamps)
    for file in files:
        try:
            time = times.get(int(file.stem)) if file.stem.isdecimal() else None
            if time is None or time not in places:
                raise ValueError("its pose or its time is not known")
            points, light = read_velodyne(file)
            yield Scan(time, places[time], transformed(to_vehicle, points), to_vehicle[:3, 3], light)
        except (CaptureError, ValueError) as error:
            record.problems.append(f"velodyne/{file.name} left out: {error}")
