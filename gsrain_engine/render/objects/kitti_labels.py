"""Labels of rendered frames as KITTI's object benchmark has them: label_2, calib, and numbered instance masks.

Source: the development kit of KITTI's object benchmark (Geiger et al., 2012). Its pixel centres are whole numbers,
ours are halves: boxes and principal points are shifted by half a pixel.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt16

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.coco_classes import coco_class

from .seen_objects import SeenObject

_CLASSES = {"car": "Car", "truck": "Truck", "person": "Pedestrian", "cyclist": "Cyclist", "train": "Tram"}
_FREE, _PARTLY = 0.8, 0.4
"""Visibilities from which on an object is fully visible, and partly occluded."""
_EGO_TO_CAMERA = "0 -1 0 0 0 0 -1 0 1 0 0 0"
"""From x forward, y left, z up to x right, y down, z forward, as KITTI's lidar has it; without an offset."""


def label_line(seen: SeenObject) -> str:
    """Type, truncation, occlusion, alpha, 2D box, height width length, place of the bottom centre, rotation about y."""
    x, y, z = seen.to_camera[:3, 3]
    ahead = seen.to_camera[:3, 0]
    turn = float(np.arctan2(-ahead[2], ahead[0]))
    alpha = _wrapped(turn - float(np.arctan2(x, z)))
    occlusion = 0 if seen.visibility >= _FREE else 1 if seen.visibility >= _PARTLY else 2
    length, width, height = seen.size_lwh_m
    box = [edge - 0.5 for edge in seen.box_xyxy]
    numbers = [alpha, *box, height, width, length, x, y, z, turn]
    return f"{_kind(seen)} {seen.truncation:.2f} {occlusion} " + " ".join(f"{each:.2f}" for each in numbers)


def label_file(seen: Sequence[SeenObject]) -> str:
    """Lines of a frame, the nearest object first."""
    return "".join(f"{label_line(each)}\n" for each in seen)


def calibration_file(camera: Camera) -> str:
    """Calibration of a frame: four equal cameras without a baseline, and a lidar in the camera's own place."""
    matrix = f"{camera.fx:.12e} 0 {camera.cx - 0.5:.12e} 0 0 {camera.fy:.12e} {camera.cy - 0.5:.12e} 0 0 0 1 0"
    cameras = "".join(f"P{number}: {matrix}\n" for number in range(4))
    return (
        f"{cameras}R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {_EGO_TO_CAMERA}\n"
        "Tr_imu_to_velo: 1 0 0 0 0 1 0 0 0 0 1 0\n"
    )


def instances(seen: Sequence[SeenObject], camera: Camera) -> UInt16[np.ndarray, "h w"]:
    """Which line of the label file, counted from 1, each pixel belongs to; 0 is none."""
    picture = np.zeros((camera.height, camera.width), np.uint16)
    for line, each in enumerate(seen, start=1):
        picture[each.mask] = line
    return picture


def _kind(seen: SeenObject) -> str:
    name = seen.object.class_name
    if name.lower() == "van":
        return "Van"
    return _CLASSES.get(coco_class(name), "Misc")


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
