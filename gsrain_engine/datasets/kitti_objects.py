"""KITTI's object detection: single pictures, each with calibration, lidar and labeled boxes.

Each picture is of another place, and no poses are known: the world is the lidar's frame (x forward, y left, z up).
Facts: Geiger et al., "Are we ready for Autonomous Driving?" (2012), and the readme of the object development kit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from .capture import Capture, CaptureError
from .driving_log import DrivingLog, LidarScan
from .geometry import BoxSample, Pose, invert_pose, rigid_from_numbers, rigid_pose
from .io.arrays import read_text
from .io.images import images_in
from .io.sweep_files import RowFile
from .kitti import MAX_TEXT_BYTES, Calibration, KittiCamera, calibration_numbers, read_kitti_calibration

_SPLITS, _SENSORS = ("training", "testing"), ("image_2", "image_3")
LIDAR_HEIGHT_M = 1.73
"""Height of the lidar above the road (figure 3 of Geiger et al., 2013)."""

_STEP_S = 1.0  # between two pictures, which have no times
_NO_OBJECT = "DontCare"
_LABEL_WORDS = 15


def recognizes_kitti_objects(path: Path) -> bool:
    """Return whether a path is the data set, `training` or `testing` of it, or one picture: KITTI/training/000008."""
    if not path.exists():
        return path.name.isdecimal() and path.parent.is_dir() and _split(path.parent) is not None
    return path.is_dir() and _split(path) is not None


def read_kitti_objects(path: Path) -> Capture:
    """Read all pictures of a split, without poses, or one with its pose. Raises `CaptureError`."""
    one = None if path.is_dir() else path.name
    folder = _split(path if one is None else path.parent)
    if folder is None:
        raise CaptureError(f"{path}: no pictures (training/image_2) with calibrations (training/calib)")
    problems = [f"{folder.name} is read; give testing for the other pictures"] if _has_both(path) else []
    log = DrivingLog(folder.resolve().name if one is None else one, road_m=-LIDAR_HEIGHT_M, problems=problems)
    frames = _frames(folder, one, log)
    log.scans, log.scan_count = _scans(log, folder, frames), len(frames)
    capture = log.capture()
    if len(frames) == 1:
        return capture
    single = f"its {len(frames)} pictures are of different places: good for rain on pictures and lidar, not for a "
    single += f"reconstruction; open one with its pose as {folder.name}/{frames[0]}"
    return replace(capture, has_poses=False, problems=(*capture.problems, single))


def _split(path: Path) -> Path | None:
    """Folder of the pictures: the path itself, or the first split in it."""
    found = (each for each in (path, *(path / name for name in _SPLITS)) if (each / _SENSORS[0]).is_dir())
    return next((each for each in found if next((each / "calib").glob("[0-9]*.txt"), None) is not None), None)


def _has_both(path: Path) -> bool:
    return all((path / name / _SENSORS[0]).is_dir() for name in _SPLITS)


def _frames(folder: Path, one: str | None, log: DrivingLog) -> list[str]:
    """Add views, places and boxes of all pictures, or of one; returns the names of those with a calibration."""
    pictures = {sensor: {file.stem: file for file in images_in(folder / sensor)} for sensor in _SENSORS}
    names = sorted(pictures[_SENSORS[0]])
    if one is not None and one not in names:
        raise CaptureError(f"{folder}: has no picture {one} in {_SENSORS[0]}, which has {len(names)}")
    frames: list[str] = []
    for number, name in enumerate(names if one is None else [one]):
        time_s = number * _STEP_S
        with log.omitting(name):
            values = read_kitti_calibration(file := folder / "calib" / f"{name}.txt")
            to_first = _lidar_to_first(values, file)
            frames.append(name)
            log.stamps.append((time_s, np.eye(4)))
            for sensor in _SENSORS:
                if name in pictures[sensor]:
                    with log.omitting(f"{sensor}/{pictures[sensor][name].name}"):
                        projection = calibration_numbers(values, f"P{sensor[-1]}", 12, file).reshape(3, 4)
                        camera = KittiCamera(sensor, projection)
                        log.views.append(camera.view(pictures[sensor][name], f"{name}_{sensor}", time_s, to_first))
            log.box_times_s.append(time_s)
            labels = folder / "label_2" / f"{name}.txt"
            if labels.is_file():
                _add_boxes(log, labels, time_s, invert_pose(to_first))
    return frames


def _lidar_to_first(values: Calibration, file: Path) -> Pose:
    """Pose of the lidar in the first rectified camera."""
    try:
        turn = calibration_numbers(values, "R0_rect", 9, file).reshape(3, 3)
        rectify = rigid_from_numbers(np.column_stack([turn, np.zeros(3)]))
        return rectify @ rigid_from_numbers(calibration_numbers(values, "Tr_velo_to_cam", 12, file))
    except CaptureError:
        raise
    except ValueError as error:
        raise CaptureError(f"{file}: {error}") from None


def _scans(log: DrivingLog, folder: Path, frames: Sequence[str]) -> Iterator[LidarScan]:
    times = {view.name.partition("_")[0]: view.time_s for view in log.views}
    for name in frames:
        file = folder / "velodyne" / f"{name}.bin"
        if name in times and file.is_file():
            with log.omitting(f"velodyne/{file.name}"):
                key = RowFile(file, 4)
                turn = key.read()
                yield LidarScan(times[name], np.eye(4), turn.points_m, np.zeros(3), turn.intensities, key)


def _add_boxes(log: DrivingLog, file: Path, time_s: float, first_to_world: Pose) -> None:
    """Add the boxes of a label file, whose objects have no identity over time."""
    with log.omitting(f"label_2/{file.name}"):
        for number, line in enumerate(read_text(file, MAX_TEXT_BYTES).splitlines()):
            words = line.split()
            if not words or words[0] == _NO_OBJECT:
                continue
            with log.omitting(f"label_2/{file.name}: line {number + 1}"):
                if len(words) < _LABEL_WORDS:
                    raise ValueError(f"has {len(words)} words, expected {_LABEL_WORDS}")
                height, width, length, x, y, z, turn = (float(word) for word in words[8:15])
                pose = first_to_world @ kitti_box(np.array([x, y - height / 2, z]), turn)
                box = BoxSample(f"{file.stem}-{number}", words[0], time_s, (length, width, height), pose)
                log.boxes.append(box)


def kitti_box(center: Float64[np.ndarray, "3"], turn: float) -> Pose:
    """Pose of a box (x forward, y left, z up) by its center in camera axes and its rotation about y, from x."""
    forward, up = np.array([np.cos(turn), 0.0, -np.sin(turn)]), np.array([0.0, -1.0, 0.0])
    return rigid_pose(np.column_stack([forward, np.cross(up, forward), up]), center)
