"""The road under the cameras of a drive, as a plane: what is left to assume where points are few."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Float64
from scipy.spatial import KDTree

from gsrain_engine.scene.camera import Camera

from ..capture import View
from .view_rays import pixel_rays

_LOWEST = 0.03
"""Part of the points near the cameras that lie under the road: errors of triangulation."""
_LEAST_POINTS = 50


def road_drop(
    points: Float64[np.ndarray, "p 3"], views: Sequence[View], up: tuple[float, float, float]
) -> float | None:
    """How far the road lies under the cameras, in the world's unit: as deep as the lowest points near them.

    None where there are too few points, or none under the cameras.
    """
    eyes = np.array([view.camera.position for view in views])
    distance, nearest = KDTree(eyes).query(points)
    near = distance <= 2 * np.median(distance)
    below = (eyes[nearest] - points)[near] @ (np.array(up) / np.linalg.norm(up))
    if len(below) < _LEAST_POINTS:
        return None
    drop = float(np.quantile(below, 1 - _LOWEST))
    return drop if drop > 0 else None


def road_depth(camera: Camera, drop: float, up: tuple[float, float, float]) -> Float32[np.ndarray, "h w"]:
    """Depth along the view axis at which pixels meet a plane so far under the camera; inf above the horizon."""
    falling = -(pixel_rays(camera) @ (np.array(up) / np.linalg.norm(up)))
    return np.where(falling > 1e-3, drop / np.maximum(falling, 1e-3), np.inf).astype(np.float32)
