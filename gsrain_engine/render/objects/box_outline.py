"""A box in the camera's frame (OpenCV axes, metres) as it falls into the picture."""

import cv2
import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.box_corners import before_camera
from gsrain_engine.scene.camera import Camera

BoxXYXY = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels; the left edge of the first column is 0."""


def outline(corners: Float64[np.ndarray, "8 3"], camera: Camera) -> Float64[np.ndarray, "c 2"]:
    """Convex outline of a box in pixels, not cut at the picture's edges; none where all of it is behind the camera."""
    points = before_camera(corners)
    if len(points) < 3:
        return np.zeros((0, 2))
    pixels = points[:, :2] / points[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    return cv2.convexHull(pixels.astype(np.float32))[:, 0].astype(np.float64)


def cut_at_edges(hull: Float64[np.ndarray, "c 2"], camera: Camera) -> Float64[np.ndarray, "d 2"]:
    """The part of a convex outline that lies in the picture; none where no part does."""
    if len(hull) < 3:
        return np.zeros((0, 2))
    width, height = camera.width, camera.height
    picture = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    area, common = cv2.intersectConvexConvex(hull.astype(np.float32), picture)
    return common[:, 0].astype(np.float64) if area > 0 else np.zeros((0, 2))


def area_px(polygon: Float64[np.ndarray, "c 2"]) -> float:
    """Area of a polygon in square pixels."""
    x, y = polygon.T if len(polygon) else np.zeros((2, 1))
    return abs(float(x @ np.roll(y, 1) - y @ np.roll(x, 1))) / 2


def bounds(polygon: Float64[np.ndarray, "c 2"]) -> BoxXYXY:
    """Smallest upright box around points, of which there must be one."""
    left, top = polygon.min(axis=0).tolist()
    right, bottom = polygon.max(axis=0).tolist()
    return left, top, right, bottom
