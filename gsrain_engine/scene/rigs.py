"""Camera rigs of the two large driving data sets, in the ego frame (x forward, y left, z up, 1.5 m above the road)."""

import numpy as np

from .camera import DEFAULT_EXPOSURE_S
from .geometry import rotation_about_z
from .scene import RigCamera

SENSOR_HEIGHT_M = 1.5
"""Height of the ego frame's origin above the road."""

# name, yaw (deg, to the left), x, y, height above the road (m), fx (px), cx, cy (px)
_WAYMO = (
    ("FRONT", 0.0, 1.54, -0.02, 2.12, 2059.0, 957.0, 640.0),
    ("FRONT_LEFT", 45.0, 1.49, 0.10, 2.12, 2059.0, 960.0, 640.0),
    ("FRONT_RIGHT", -45.0, 1.49, -0.10, 2.12, 2059.0, 963.0, 640.0),
)

# Calibration of the sample log of 2018-07-24, positions to a centimeter and angles to half a degree.
_NUSCENES = (
    ("CAM_FRONT", 0.0, 1.70, 0.02, 1.51, 1266.4, 816.3, 491.5),
    ("CAM_FRONT_RIGHT", -56.0, 1.55, -0.49, 1.50, 1260.8, 808.0, 495.3),
    ("CAM_FRONT_LEFT", 55.0, 1.52, 0.50, 1.51, 1272.6, 826.6, 479.8),
    ("CAM_BACK", 180.0, 0.03, 0.00, 1.58, 809.2, 829.2, 481.8),
    ("CAM_BACK_LEFT", 108.5, 1.04, 0.48, 1.59, 1256.7, 792.1, 492.8),
    ("CAM_BACK_RIGHT", -110.5, 1.02, -0.48, 1.56, 1259.5, 807.3, 501.2),
)

_CAMERA_TO_FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""OpenCV axes to ego axes for a camera that points straight ahead."""


def driving_rigs() -> dict[str, tuple[RigCamera, ...]]:
    """Rigs by name: `waymo_front3` (three cameras ahead) and `nuscenes` (six, all around)."""
    return {
        "waymo_front3": tuple(_camera(row, 1920, 1280) for row in _WAYMO),
        "nuscenes": tuple(_camera(row, 1600, 900) for row in _NUSCENES),
    }


def _camera(row: tuple[str, float, float, float, float, float, float, float], width: int, height: int) -> RigCamera:
    name, yaw_deg, x, y, above_road, f, cx, cy = row
    pose = np.eye(4)
    pose[:3, :3] = rotation_about_z(yaw_deg) @ _CAMERA_TO_FORWARD
    pose[:3, 3] = x, y, above_road - SENSOR_HEIGHT_M
    return RigCamera(name, width, height, f, f, cx, cy, pose, DEFAULT_EXPOSURE_S)
