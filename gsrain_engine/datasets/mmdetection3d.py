"""MMDetection3D's info files (.pkl) of nuScenes, KITTI and Waymo, of versions 1.x ("data_list") and before ("infos").

The files have no object identities: each box exists only around its own sample. Boxes are in the lidar's frame (of
nuScenes x right, y forward, z up), given by their centers. Images are rectified.
Facts: tools/dataset_converters/ of github.com/open-mmlab/mmdetection3d.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from .capture import Capture, CaptureError, CaptureFrame, check_inside
from .driving_log import DrivingLog, LidarScan
from .geometry import (
    BoxSample,
    Pose,
    heading_pose,
    invert_pose,
    opencv_camera_of_matrix,
    rigid_from_numbers,
    rigid_from_quaternion,
)
from .io.arrays import WRONG_VALUES, what_is_wrong
from .io.images import image_size, images_in, read_color
from .io.safe_pickle import read_pickle
from .io.sweep_files import RowFile
from .kitti import KittiCamera
from .kitti_objects import LIDAR_HEIGHT_M, kitti_box

_US = 1e-6
_NEXT_DRIVE_S = 5.0
_CAMERA = re.compile(r"(^|_)CAM_(FRONT|BACK)(_LEFT|_RIGHT)?_")
_BOX_NUMBERS = 7
_KITTI_FOLDERS = ("image_2", "velodyne_reduced", "velodyne")
_WAYMO_FOLDERS = {
    "CAM_FRONT": "image_0",
    "CAM_FRONT_LEFT": "image_1",
    "CAM_FRONT_RIGHT": "image_2",
    "CAM_SIDE_LEFT": "image_3",
    "CAM_SIDE_RIGHT": "image_4",
}
_WAYMO_LIDAR_M = (1.43, 0.0, 2.18)  # on the roof, by Waymo's calibrations
_WAYMO_CLASSES = {0: "Car", 1: "Pedestrian", 2: "Cyclist"}


def recognizes_infos(path: Path) -> bool:
    """Return whether a path is an info file, its N-th drive (FILE.pkl/N), or a folder with an info file and images."""
    if path.suffix == ".pkl":
        return path.is_file()
    if path.is_dir():
        return bool(list(path.glob("*.pkl"))) and (
            (path / "samples").is_dir() or any(_CAMERA.search(file.name) for file in images_in(path))
        )
    return path.parent.suffix == ".pkl" and path.name.isdecimal() and path.parent.is_file()


def read_infos(path: Path) -> Capture:
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
    infos, wrong = _infos_of(read_pickle(file), file)
    drives: list[list[_Info]] = []
    for info in infos:
        if drives and 0 <= info.time_s - drives[-1][-1].time_s < _NEXT_DRIVE_S:
            drives[-1].append(info)
        else:
            drives.append([info])
    problems += [f"{file.name}: {each}" for each in wrong]
    if not 0 <= number < len(drives):
        raise CaptureError(f"{file}: has drives 0 to {len(drives) - 1}, not {number}")
    if len(drives) > 1 and path.parent.suffix != ".pkl":
        problems.append(f"drive 0 is read of {len(drives)}; open another as {file}/1")
    name = f"{file.stem}_{number}" if len(drives) > 1 else file.stem
    return _capture(file.parent, drives[number], DrivingLog(name, road_m=drives[number][0].road_m, problems=problems))


@dataclass(frozen=True, slots=True, eq=False)
class _InfoCamera:
    """An image of a sample."""

    channel: str
    file: str
    time_s: float
    matrix: Float64[np.ndarray, "..."]
    camera_to_world: Pose


@dataclass(frozen=True, slots=True, eq=False)
class _Info:
    """A sample: pose of the vehicle at the lidar's time, its images, and boxes in the lidar's frame."""

    time_s: float
    vehicle_to_world: Pose
    lidar_to_vehicle: Pose
    lidar_file: str
    lidar_columns: int
    cameras: tuple[_InfoCamera, ...]
    class_names: tuple[str, ...]
    boxes: Float64[np.ndarray, "b 7"]
    """Center x y z, three sides, rotation about z, as in the file."""
    lidar_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the lidar in the frame of its points."""
    road_m: float = 0.0
    """Height of the road in the vehicle's frame according to the data set."""
    has_old_boxes: bool = False
    """True if sides may be width, length, height and the rotation clockwise from -y, as before version 1.0."""


def _capture(folder: Path, infos: list[_Info], log: DrivingLog) -> Capture:
    named = [(each.file, each.channel) for info in infos for each in info.cameras]
    named += [(info.lidar_file, "LIDAR_TOP") for info in infos if info.lidar_file]
    check_inside(folder, (str(found) for name, sensor in named if (found := _found(folder, name, sensor))), folder)
    old = _has_old_boxes(folder, infos)
    for number, info in enumerate(infos):
        log.stamps.append((info.time_s, info.vehicle_to_world))
        for each in info.cameras:
            with log.omitting(f"{each.channel} of sample {number}"):
                file = _find(folder, each.file, each.channel)
                camera = opencv_camera_of_matrix(each.matrix, image_size(file), invert_pose(each.camera_to_world))
                name = f"{number:04d}_{each.channel}"
                log.views.append(CaptureFrame(name, camera, partial(read_color, file), each.time_s, each.channel))
        log.box_times_s.append(info.time_s)
        for box, (size, to_lidar) in enumerate(_boxes_in_lidar(info.boxes, old)):
            with log.omitting(f"box {box} of sample {number}"):
                pose = info.vehicle_to_world @ info.lidar_to_vehicle @ to_lidar
                log.boxes.append(BoxSample(f"{number}-{box}", info.class_names[box], info.time_s, size, pose))
    log.scans, log.scan_count = _scans(folder, infos, log), len(infos)
    return log.capture()


def _scans(folder: Path, infos: list[_Info], log: DrivingLog) -> Iterator[LidarScan]:
    for info in infos:
        if info.lidar_file:
            with log.omitting(info.lidar_file):
                file = _find(folder, info.lidar_file, "LIDAR_TOP")
                pose, key = info.vehicle_to_world, RowFile(file, info.lidar_columns, origin_m=info.lidar_m)
                to_vehicle, turn = info.lidar_to_vehicle, key.read()
                yield LidarScan.placed(
                    info.time_s, pose, to_vehicle, turn.points_m, turn.intensities, key, info.lidar_m
                )


def _find(folder: Path, named: str, sensor: str) -> Path:
    """Path of a file: as in the info file, in samples/SENSOR, or next to the info file. Raises `CaptureError`."""
    found = _found(folder, named, sensor)
    if found is None:
        raise CaptureError(f"{named}: no such file in {folder}")
    return found


def _found(folder: Path, named: str, sensor: str) -> Path | None:
    parts = [part for part in Path(named).parts if part not in ("..", ".", "/")]
    places = [folder.joinpath(*parts[start:]) for start in range(len(parts))]
    places += [folder / below / sensor / parts[-1] for below in ("samples", "sweeps") if parts]
    folders = (_WAYMO_FOLDERS[sensor],) if sensor in _WAYMO_FOLDERS else _KITTI_FOLDERS
    places += [folder / "training" / below / parts[-1] for below in folders if parts]
    return next((place for place in places if place.is_file()), None)


def _infos_of(values: Any, file: Path) -> tuple[list[_Info], list[str]]:
    """Read all samples and list the omitted ones; `CaptureError` if the file holds none."""
    if isinstance(values, Mapping) and isinstance(values.get("data_list"), Sequence):
        classes = values.get("metainfo", {}).get("categories", {})
        names = {int(number): str(name) for name, number in dict(classes).items()}
        read = _info_of_waymo if values.get("metainfo", {}).get("dataset") == "waymo" else _info_of_1_x
        return _read_rows(values["data_list"], partial(read, names=names), file)
    rows = values.get("infos") if isinstance(values, Mapping) else values
    if isinstance(rows, Sequence) and rows and isinstance(rows[0], Mapping) and "cams" in rows[0]:
        return _read_rows(rows, _info_before_1_0, file)
    raise CaptureError(f'{file}: not an info file of nuScenes (it has neither "data_list" nor "infos" with cameras)')


def _read_rows(rows: Any, read: Callable[[Any], _Info], file: Path) -> tuple[list[_Info], list[str]]:
    infos: list[_Info] = []
    problems: list[str] = []
    for number, row in enumerate(rows):
        try:
            infos.append(read(row))
        except WRONG_VALUES as error:
            problems.append(f"sample {number} left out: {what_is_wrong(error)}")
    if not infos:
        raise CaptureError(f"{file}: no sample that can be used" + (f" ({problems[0]})" if problems else ""))
    return infos, problems


def _info_of_1_x(row: Any, names: Mapping[int, str]) -> _Info:
    if "ego2global" not in row and "lidar2ego" not in row["lidar_points"]:
        return _info_of_kitti(row, names)
    return _placed_info(row, names, rigid_from_numbers(row["lidar_points"]["lidar2ego"]), 1.0)


def _info_of_waymo(row: Any, names: Mapping[int, str]) -> _Info:
    """A sample of Waymo: points and boxes, by their bottom centers, in the vehicle's frame; times in microseconds."""
    info = _placed_info(row, names or _WAYMO_CLASSES, np.eye(4), _US)
    info.boxes[:, 2] += info.boxes[:, 5] / 2
    return replace(info, lidar_m=_WAYMO_LIDAR_M)


def _placed_info(row: Any, names: Mapping[int, str], to_vehicle: Pose, unit_s: float) -> _Info:
    to_world, lidar = rigid_from_numbers(row["ego2global"]), row["lidar_points"]
    cameras = tuple(
        _InfoCamera(
            str(channel),
            str(each["img_path"]),
            float(each.get("timestamp", row["timestamp"])) * unit_s,
            np.asarray(each["cam2img"], np.float64),
            # At the lidar's time: lidar2cam includes the vehicle's motion between the two times, cam2ego doesn't.
            to_world @ to_vehicle @ invert_pose(rigid_from_numbers(each["lidar2cam"])),
        )
        for channel, each in row.get("images", {}).items()
        if each.get("img_path")
    )
    boxes, classes = _instances(row, names)
    file, columns = str(lidar.get("lidar_path") or ""), int(lidar.get("num_pts_feats", 5))
    time_s = float(row["timestamp"]) * unit_s
    return _Info(time_s, to_world, to_vehicle, file, columns, cameras, classes, boxes)


def _instances(row: Any, names: Mapping[int, str]) -> tuple[Float64[np.ndarray, "b 7"], tuple[str, ...]]:
    """Boxes as in the file, and the names of their classes."""
    instances = [each for each in row.get("instances", ()) if len(each.get("bbox_3d", ())) >= _BOX_NUMBERS]
    boxes = np.array([each["bbox_3d"][:_BOX_NUMBERS] for each in instances], np.float64).reshape(-1, _BOX_NUMBERS)
    labels = [int(each["bbox_label_3d"]) for each in instances]
    classes = tuple(names.get(label, f"class {label}" if label >= 0 else "unknown") for label in labels)
    return boxes, classes


def _info_of_kitti(row: Any, names: Mapping[int, str]) -> _Info:
    """A picture of KITTI's object detection, whose world and vehicle are the lidar's frame; each is a drive.

    Boxes are in the first rectified camera: bottom center, length, height, width, and the rotation about y.
    """
    named = {str(name): each for name, each in row["images"].items() if "lidar2cam" in each and each.get("img_path")}
    if not named:
        raise ValueError("has no picture with lidar2cam")
    to_first = rigid_from_numbers(next(iter(named.values()))["lidar2cam"])
    number = int(row.get("sample_idx", row.get("sample_id", 0)))
    time_s = number * 2 * _NEXT_DRIVE_S
    cameras: list[_InfoCamera] = []
    for name, each in named.items():
        projection = np.asarray(each["cam2img"], np.float64)[:3]
        camera = KittiCamera(name, projection)
        to_world = invert_pose(camera.from_first @ to_first)
        cameras.append(_InfoCamera(name, str(each["img_path"]), time_s, projection[:, :3], to_world))
    labeled = [each for each in row.get("instances", ()) if int(each.get("bbox_label_3d", -1)) >= 0]  # not DontCare
    stored, classes = _instances({"instances": labeled}, names)
    boxes = np.zeros_like(stored)
    for box, (x, y, z, length, height, width, turn) in zip(boxes, stored.tolist(), strict=True):
        pose = invert_pose(to_first) @ kitti_box(np.array([x, y - height / 2, z]), turn)
        box[:] = [*pose[:3, 3], length, width, height, np.arctan2(pose[1, 0], pose[0, 0])]
    lidar, same = row["lidar_points"], np.eye(4)
    file, columns = str(lidar.get("lidar_path") or ""), int(lidar.get("num_pts_feats", 4))
    return _Info(time_s, same, same, file, columns, tuple(cameras), classes, boxes, road_m=-LIDAR_HEIGHT_M)


def _info_before_1_0(row: Any) -> _Info:
    to_world, to_vehicle = _named_pose(row, "ego2global"), _named_pose(row, "lidar2ego")
    cameras = tuple(
        _InfoCamera(
            str(channel),
            str(each["data_path"]),
            float(each["timestamp"]) * _US,
            np.asarray(each["cam_intrinsic"], np.float64),
            _named_pose(each, "ego2global") @ _named_pose(each, "sensor2ego"),
        )
        for channel, each in row["cams"].items()
    )
    boxes = np.asarray(row.get("gt_boxes", ()), np.float64).reshape(-1, _BOX_NUMBERS)
    classes = tuple(str(name) for name in row.get("gt_names", ()))
    if len(classes) != len(boxes):
        raise ValueError(f"has {len(boxes)} boxes and {len(classes)} names of them")
    time_s, file = float(row["timestamp"]) * _US, str(row.get("lidar_path") or "")
    return _Info(time_s, to_world, to_vehicle, file, 5, cameras, classes, boxes, has_old_boxes=True)


def _named_pose(row: Any, name: str) -> Pose:
    return rigid_from_quaternion(row[f"{name}_rotation"], row[f"{name}_translation"])


def _has_old_boxes(folder: Path, infos: list[_Info]) -> bool:
    """Return whether the boxes of the first available sweep hold more points in the convention before version 1.0.

    The layout is the same, and no field distinguishes the conventions.
    """
    for info in infos:
        if info.has_old_boxes and info.lidar_file and len(info.boxes):
            try:
                points = RowFile(_find(folder, info.lidar_file, "LIDAR_TOP"), info.lidar_columns).read().points_m
            except CaptureError:
                continue
            with np.errstate(invalid="ignore"):  # NaN lies in no box
                exact = points.astype(np.float64)
                return _points_inside(info.boxes, exact, True) > _points_inside(info.boxes, exact, False)
    return False


def _points_inside(boxes: Float64[np.ndarray, "b 7"], points_m: Float64[np.ndarray, "p 3"], old: bool) -> int:
    count = 0
    for size, pose in _boxes_in_lidar(boxes, old):
        local = (points_m - pose[:3, 3]) @ pose[:3, :3]
        count += int(np.count_nonzero((np.abs(local) <= np.array(size) / 2).all(axis=1)))
    return count


def _boxes_in_lidar(boxes: Float64[np.ndarray, "b 7"], old: bool) -> Iterator[tuple[tuple[float, float, float], Pose]]:
    """Sides (length, width, height, m) and pose (box, x forward, to lidar) of rows of a file."""
    for row in boxes:
        x, y, z, first, second, height, turn = (float(value) for value in row)
        length, width, angle = (second, first, -turn - np.pi / 2) if old else (first, second, turn)
        yield (length, width, height), heading_pose((x, y, z), angle)
