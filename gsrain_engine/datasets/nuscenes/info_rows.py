"""Rows of MMDetection3D's info files, of both layouts, as one kind of value."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from ..capture import CaptureError
from ..files.reading_errors import WRONG_VALUES, what_is_wrong
from ..geometry.rigid_poses import inverse, rigid, rigid_from_numbers, rigid_from_quaternion

_US = 1e-6
_BOX_NUMBERS = 7


@dataclass(frozen=True, slots=True, eq=False)
class InfoCamera:
    """A picture of a sample."""

    channel: str
    file: str
    time_s: float
    matrix: Float64[np.ndarray, "..."]
    camera_to_world: Float64[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True, eq=False)
class Info:
    """A sample: where the vehicle was at the lidar's time, its pictures, and boxes in the lidar's frame."""

    time_s: float
    vehicle_to_world: Float64[np.ndarray, "4 4"]
    lidar_to_vehicle: Float64[np.ndarray, "4 4"]
    lidar_file: str
    lidar_columns: int
    cameras: tuple[InfoCamera, ...]
    class_names: tuple[str, ...]
    boxes: Float64[np.ndarray, "b 7"]
    """Centre x y z, three sides, turn about z: as the file has them."""
    has_old_boxes: bool = False
    """Whether the sides may be width, length, height and the turn clockwise from -y, as before version 1.0."""


def infos_of(values: Any, file: Path) -> tuple[list[Info], list[str]]:
    """Read all samples, and say which were left out; `CaptureError` where the file holds none."""
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
            # Of the lidar's time: this holds what the vehicle moved between the two, cam2ego doesn't.
            to_world @ to_vehicle @ inverse(rigid_from_numbers(each["lidar2cam"])),
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
        found.append(((length, width, height), rigid(rotation, np.array([x, y, z]))))
    return found


def boxes_are_old(boxes: Float64[np.ndarray, "b 7"], points_m: Float64[np.ndarray, "p 3"]) -> bool:
    """Whether the boxes hold more points of their lidar when they are read as files before version 1.0 wrote them.

    The layout is the same, and nothing in the file tells which it is.
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
