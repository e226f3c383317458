"""nuScenes as MMDetection3D's info files (.pkl) tell it: of versions 1.x ("data_list") and before ("infos").

Facts: tools/dataset_converters/ of github.com/open-mmlab/mmdetection3d. The files know no identities: each box is there
around its own sample. Boxes are in the lidar's frame (x right, y forward, z up), with their centres.
"""

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ..capture import Capture, CaptureError, View
from ..driving_record import DrivingRecord, Scan
from ..files.inside import check_inside
from ..files.picture_file import picture_size, pictures_in, read_color
from ..files.reading_errors import what_is_wrong
from ..files.safe_pickle import read_pickle
from ..geometry.box_tracks import BoxSample
from ..geometry.opencv_camera import opencv_camera_of_matrix
from ..geometry.rigid_poses import inverse, transformed
from .info_rows import Info, InfoCamera, boxes_are_old, boxes_in_lidar, infos_of
from .reader import read_nuscenes_points

_NEXT_DRIVE_S = 5.0
_CAMERA = re.compile(r"(^|_)CAM_(FRONT|BACK)(_LEFT|_RIGHT)?_")


def recognizes_nuscenes_infos(path: Path) -> bool:
    """Whether a path is an info file, the N-th drive of one (FILE.pkl/N), or a folder of one with its pictures."""
    if path.suffix == ".pkl":
        return path.is_file()
    if path.is_dir():
        return bool(list(path.glob("*.pkl"))) and (
            (path / "samples").is_dir() or any(_CAMERA.search(file.name) for file in pictures_in(path))
        )
    return path.parent.suffix == ".pkl" and path.name.isdecimal() and path.parent.is_file()


def read_nuscenes_infos(path: Path) -> Capture:
    """Read one drive of an info file, the first of it unless the path says FILE.pkl/N. Raises `CaptureError`."""
    file, number = (path.parent, int(path.name)) if path.parent.suffix == ".pkl" else (path, 0)
    problems: list[str] = []
    if file.is_dir():
        found = sorted(file.glob("*.pkl"))
        if not found:
            raise CaptureError(f"{file}: no info file (.pkl) in it")
        if found[1:]:
            problems.append(f"{found[0].name} is read of {len(found)} info files")
        file = found[0]
    infos, wrong = infos_of(read_pickle(file), file)
    drives = _drives(infos)
    problems += [f"{file.name}: {each}" for each in wrong]
    if not 0 <= number < len(drives):
        raise CaptureError(f"{file}: has drives 0 to {len(drives) - 1}, not {number}")
    if len(drives) > 1 and path.parent.suffix != ".pkl":
        problems.append(f"drive 0 is read of {len(drives)}; open another as {file}/1")
    name = f"{file.stem}_{number}" if len(drives) > 1 else file.stem
    return _capture(file.parent, drives[number], DrivingRecord(name, road_m=0.0, problems=problems))


def _drives(infos: list[Info]) -> list[list[Info]]:
    drives: list[list[Info]] = []
    for info in infos:
        if drives and 0 <= info.time_s - drives[-1][-1].time_s < _NEXT_DRIVE_S:
            drives[-1].append(info)
        else:
            drives.append([info])
    return drives


def _capture(folder: Path, infos: list[Info], record: DrivingRecord) -> Capture:
    named = [(each.file, each.channel) for info in infos for each in info.cameras]
    named += [(info.lidar_file, "LIDAR_TOP") for info in infos if info.lidar_file]
    check_inside(folder, (str(found) for name, sensor in named if (found := _found(folder, name, sensor))), folder)
    old = _has_old_boxes(folder, infos)
    for number, info in enumerate(infos):
        record.stamps.append((info.time_s, info.vehicle_to_world))
        for camera in info.cameras:
            try:
                record.views.append(_view(folder, camera, number))
            except (CaptureError, ValueError) as error:
                record.problems.append(f"{camera.channel} of sample {number} left out: {what_is_wrong(error)}")
        record.box_times_s.append(info.time_s)
        for box, (size, to_lidar) in enumerate(boxes_in_lidar(info.boxes, old)):
            try:
                pose = info.vehicle_to_world @ info.lidar_to_vehicle @ to_lidar
                record.boxes.append(BoxSample(f"{number}-{box}", info.class_names[box], info.time_s, size, pose))
            except ValueError as error:
                record.problems.append(f"box {box} of sample {number} left out: {error}")
    record.scans, record.scan_count = _scans(folder, infos, record.problems), len(infos)
    return record.capture()


def _has_old_boxes(folder: Path, infos: list[Info]) -> bool:
    """Ask the first sweep that is there and has boxes around it."""
    for info in infos:
        if info.has_old_boxes and info.lidar_file and len(info.boxes):
            try:
                points, _ = read_nuscenes_points(_find(folder, info.lidar_file, "LIDAR_TOP"), info.lidar_columns)
            except CaptureError:
                continue
            with np.errstate(invalid="ignore"):  # what is no number lies in no box
                return boxes_are_old(info.boxes, points.astype(np.float64))
    return False


def _view(folder: Path, camera: InfoCamera, number: int) -> View:
    file = _find(folder, camera.file, camera.channel)
    shape = opencv_camera_of_matrix(camera.matrix, picture_size(file), inverse(camera.camera_to_world))
    return View(f"{number:04d}_{camera.channel}", shape, partial(read_color, file), camera.time_s, camera.channel)


def _scans(folder: Path, infos: list[Info], problems: list[str]) -> Iterator[Scan]:
    for info in infos:
        if not info.lidar_file:
            continue
        try:
            points, light = read_nuscenes_points(_find(folder, info.lidar_file, "LIDAR_TOP"), info.lidar_columns)
            placed = transformed(info.lidar_to_vehicle, points)
            yield Scan(info.time_s, info.vehicle_to_world, placed, info.lidar_to_vehicle[:3, 3], light)
        except (CaptureError, ValueError) as error:
            problems.append(f"{info.lidar_file} left out: {what_is_wrong(error)}")


def _find(folder: Path, named: str, sensor: str) -> Path:
    """Where a file lies: as the info file has it, in samples/SENSOR, or beside the info file. Raises `CaptureError`."""
    found = _found(folder, named, sensor)
    if found is None:
        raise CaptureError(f"{named}: no such file in {folder}")
    return found


def _found(folder: Path, named: str, sensor: str) -> Path | None:
    parts = [part for part in Path(named).parts if part not in ("..", ".", "/")]
    places = [Path(*parts[start:]) for start in range(len(parts))]
    places += [Path("samples", sensor, parts[-1]), Path("sweeps", sensor, parts[-1])] if parts else []
    for place in places:
        if (folder / place).is_file():
            return folder / place
    return None
