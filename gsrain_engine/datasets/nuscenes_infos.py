"""nuScenes from MMDetection3D's info files (.pkl), of versions 1.x ("data_list") and before ("infos").

Facts: tools/dataset_converters/ of github.com/open-mmlab/mmdetection3d. The files have no object identities: each box
exists only around its own sample. Boxes are in the lidar's frame (x right, y forward, z up), given by their centers.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from .capture import Capture, CaptureError, CaptureFrame, check_inside
from .driving_log import DrivingLog, LidarScan
from .geometry import (
    BoxSample,
    invert_pose,
    opencv_camera_of_matrix,
    rigid_from_numbers,
    rigid_from_quaternion,
    rigid_pose,
    transform_points,
)
from .io.arrays import WRONG_VALUES, what_is_wrong
from .io.images import image_size, images_in, read_color
from .io.safe_pickle import read_pickle
from .nuscenes import read_nuscenes_points

_NEXT_DRIVE_S = 5.0
_CAMERA = re.compile(r"(^|_)CAM_(FRONT|BACK)(_LEFT|_RIGHT)?_")


def recognizes_nuscenes_infos(path: Path) -> bool:
    """Return whether a path is an info file, its N-th drive (FILE.pkl/N), or a folder with an info file and images."""
    if path.suffix == ".pkl":
        return path.is_file()
    if path.is_dir():
        return bool(list(path.glob("*.pkl"))) and (
            (path / "samples").is_dir() or any(_CAMERA.search(file.name) for file in images_in(path))
        )
    return path.parent.suffix == ".pkl" and path.name.isdecimal() and path.parent.is_file()


def read_nuscenes_infos(path: Path) -> Capture:
    """Read one drive of an info file, the first unless the path is FILE.pkl/N. Raises `CaptureError`."""
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
    return _capture(file.parent, drives[number], DrivingLog(name, road_m=0.0, problems=problems))


# Rows of both layouts


@dataclass(frozen=True, slots=True, eq=False)
class InfoCamera:
    """An image of a sample."""

    channel: str
    file: str
    time_s: float
    matrix: Float64[np.ndarray, "..."]
    camera_to_world: Float64[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True, eq=False)
class Info:
    """A sample: pose of the vehicle at the lidar's time, its images, and boxes in the lidar's frame."""

    time_s: float
    vehicle_to_world: Float64[np.ndarray, "4 4"]
    lidar_to_vehicle: Float64[np.ndarray, "4 4"]
    lidar_file: str
    lidar_columns: int
    cameras: tuple[InfoCamera, ...]
    class_names: tuple[str, ...]
    boxes: Float64[np.ndarray, "b 7"]
    """Center x y z, three sides, rotation about z, as in the file."""
    has_old_boxes: bool = False
    """True if sides may be width, length, height and the rotation clockwise from -y, as before version 1.0."""


def _drives(infos: list[Info]) -> list[list[Info]]:
    drives: list[list[Info]] = []
    for info in infos:
        if drives and 0 <= info.time_s - drives[-1][-1].time_s < _NEXT_DRIVE_S:
            drives[-1].append(info)
        else:
            drives.append([info])
    return drives


def _capture(folder: Path, infos: list[Info], record: DrivingLog) -> Capture:
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
    """Decide by the first available sweep with boxes."""
    for info in infos:
        if info.has_old_boxes and info.lidar_file and len(info.boxes):
            try:
                points, _ = read_nuscenes_points(_find(folder, info.lidar_file, "LIDAR_TOP"), info.lidar_columns)
            except CaptureError:
                continue
            with np.errstate(invalid="ignore"):  # NaN lies in no box
                return boxes_are_old(info.boxes, points.astype(np.float64))
    return False


def _view(folder: Path, camera: InfoCamera, number: int) -> CaptureFrame:
    file = _find(folder, camera.file, camera.channel)
    shape = opencv_camera_of_matrix(camera.matrix, image_size(file), invert_pose(camera.camera_to_world))
    return CaptureFrame(
        f"{number:04d}_{camera.channel}", shape, partial(read_color, file), camera.time_s, camera.channel
    )


def _scans(folder: Path, infos: list[Info], problems: list[str]) -> Iterator[LidarScan]:
    for info in infos:
        if not info.lidar_file:
            continue
        try:
            points, light = read_nuscenes_points(_find(folder, info.lidar_file, "LIDAR_TOP"), info.lidar_columns)
            placed = transform_points(info.lidar_to_vehicle, points)
            yield LidarScan(info.time_s, info.vehicle_to_world, placed, info.lidar_to_vehicle[:3, 3], light)
        except (CaptureError, ValueError) as error:
            problems.append(f"{info.lidar_file} left out: {what_is_wrong(error)}")


def _find(folder: Path, named: str, sensor: str) -> Path:
    """Path of a file: as in the info file, in samples/SENSOR, or next to the info file. Raises `CaptureError`."""
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


_US = 1e-6
_BOX_NUMBERS = 7


def infos_of(values: Any, file: Path) -> tuple[list[Info], list[str]]:
    """Read all samples and list the omitted ones; `CaptureError` if the file holds none."""
    if isinstance(values, Mapping) and isinstance(values.get("data_list"), Sequence):
        classes = values.get("metainfo", {}).get("categories", {})
        names = {int(number): str(name) for name, number in dict(classes).items()}
        return _each(values["data_list"], lambda row: _info_of_1_x(row, names), file)
    rows = values.get("infos") if isinstance(values, Mapping) else values
    if isinstance(rows, Sequence) and rows and isinstance(rows[0], Mapping) and "cams" in rows[0]:
        return _each(rows, _info_before_1_0, file)
    raise CaptureError(f'{file}: not an info file of nuScenes (it has neither "data_list" nor "infos" with cameras)')


def _each(rows: Any, read: Callable[[Any], Info], file: Path) -> tuple[list[Info], list[str]]:
    infos: list[Info] = []
    problems: list[str] = []
    for number, row in enumerate(rows):
        try:
            infos.append(read(row))
        except WRONG_VALUES as error:
            problems.append(f"sample {number} left out: {what_is_wrong(error)}")
    if not infos:
        raise CaptureError(f"{file}: no sample that can be used" + (f" ({problems[0]})" if problems else ""))
    return infos, problems


def _info_of_1_x(row: Any, names: Mapping[int, str]) -> Info:
    to_world = rigid_from_numbers(row["ego2global"])
    lidar = row["lidar_points"]
    to_vehicle = rigid_from_numbers(lidar["lidar2ego"])
    cameras = tuple(
        InfoCamera(
            str(channel),
            str(each["img_path"]),
            float(each.get("timestamp", row["timestamp"])),
            np.asarray(each["cam2img"], np.float64),
            # At the lidar's time: lidar2cam includes the vehicle's motion between the two times, cam2ego doesn't.
            to_world @ to_vehicle @ invert_pose(rigid_from_numbers(each["lidar2cam"])),
        )
        for channel, each in row.get("images", {}).items()
        if each.get("img_path")
    )
    instances = [each for each in row.get("instances", ()) if len(each.get("bbox_3d", ())) >= _BOX_NUMBERS]
    boxes = np.array([each["bbox_3d"][:_BOX_NUMBERS] for each in instances], np.float64).reshape(-1, _BOX_NUMBERS)
    labels = [int(each["bbox_label_3d"]) for each in instances]
    classes = tuple(names.get(label, f"class {label}" if label >= 0 else "unknown") for label in labels)
    file, columns = str(lidar.get("lidar_path") or ""), int(lidar.get("num_pts_feats", 5))
    return Info(float(row["timestamp"]), to_world, to_vehicle, file, columns, cameras, classes, boxes)


def _info_before_1_0(row: Any) -> Info:
    to_world = rigid_from_quaternion(row["ego2global_rotation"], row["ego2global_translation"])
    to_vehicle = rigid_from_quaternion(row["lidar2ego_rotation"], row["lidar2ego_translation"])
    cameras = tuple(
        InfoCamera(
            str(channel),
            str(each["data_path"]),
            float(each["timestamp"]) * _US,
            np.asarray(each["cam_intrinsic"], np.float64),
            rigid_from_quaternion(each["ego2global_rotation"], each["ego2global_translation"])
            @ rigid_from_quaternion(each["sensor2ego_rotation"], each["sensor2ego_translation"]),
        )
        for channel, each in row["cams"].items()
    )
    boxes = np.asarray(row.get("gt_boxes", ()), np.float64).reshape(-1, _BOX_NUMBERS)
    classes = tuple(str(name) for name in row.get("gt_names", ()))
    if len(classes) != len(boxes):
        raise ValueError(f"has {len(boxes)} boxes and {len(classes)} names of them")
    time_s, file = float(row["timestamp"]) * _US, str(row.get("lidar_path") or "")
    return Info(time_s, to_world, to_vehicle, file, 5, cameras, classes, boxes, has_old_boxes=True)


def boxes_in_lidar(
    boxes: Float64[np.ndarray, "b 7"], old: bool
) -> list[tuple[tuple[float, float, float], Float64[np.ndarray, "4 4"]]]:
    """Sides (length, width, height, m) and pose (box, x forward, to lidar) of rows of a file."""
    found: list[tuple[tuple[float, float, float], Float64[np.ndarray, "4 4"]]] = []
    for row in boxes:
        x, y, z, first, second, height, turn = (float(value) for value in row)
        length, width, angle = (second, first, -turn - np.pi / 2) if old else (first, second, turn)
        cosine, sine = np.cos(angle), np.sin(angle)
        rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        found.append(((length, width, height), rigid_pose(rotation, np.array([x, y, z]))))
    return found


def boxes_are_old(boxes: Float64[np.ndarray, "b 7"], points_m: Float64[np.ndarray, "p 3"]) -> bool:
    """Return whether the boxes hold more lidar points if read in the convention before version 1.0.

    The layout is the same, and no field distinguishes the conventions.
    """
    held = [
        sum(_count_inside(points_m, size, pose) for size, pose in boxes_in_lidar(boxes, old)) for old in (False, True)
    ]
    return held[1] > held[0]


def _count_inside(
    points_m: Float64[np.ndarray, "p 3"], size_lwh: tuple[float, float, float], pose: Float64[np.ndarray, "4 4"]
) -> int:
    local = (points_m - pose[:3, 3]) @ pose[:3, :3]
    return int(np.count_nonzero((np.abs(local) <= np.array(size_lwh) / 2).all(axis=1)))
