"""Cameras of calibrations that were made with OpenCV, where the first pixel's centre is (0, 0), not (0.5, 0.5)."""

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.camera import Camera

_TO_OURS_PX = 0.5


def opencv_camera(
    focal_px: tuple[float, float],
    center_px: tuple[float, float],
    size: tuple[int, int],
    world_to_camera: Float64[np.ndarray, "4 4"],
) -> Camera:
    """Build a camera (`size` is width, height); ValueError where its calibration is none."""
    if not np.isfinite([*focal_px, *center_px]).all() or min(focal_px) <= 0:
        raise ValueError("its calibration has no focal length above 0 px")
    cx, cy = (value + _TO_OURS_PX for value in center_px)
    return Camera(size[0], size[1], focal_px[0], focal_px[1], cx, cy, world_to_camera)


def opencv_camera_of_matrix(
    matrix: Float64[np.ndarray, "..."], size: tuple[int, int], world_to_camera: Float64[np.ndarray, "4 4"]
) -> Camera:
    """Build a camera of a 3x3, 3x4 or 4x4 camera matrix."""
    if matrix.shape not in ((3, 3), (3, 4), (4, 4)):
        raise ValueError("its calibration has no 3x3 matrix of a camera")
    fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return opencv_camera((fx, fy), (cx, cy), size, world_to_camera)
