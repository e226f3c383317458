"""Points and lines of the world in the picture."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.camera import Camera

NEAR_M = 0.05


class Seen(NamedTuple):
    """A point in the picture."""

    x: float
    y: float
    depth_m: float


def projected_point(point: Float64[np.ndarray, "3"], camera: Camera) -> Seen | None:
    """A point of the world (metres) in pixels; None before the near plane."""
    x, y, z = (camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]).tolist()
    return Seen(camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, z) if z > NEAR_M else None


def projected_lines(lines: Float64[np.ndarray, "n 2 3"], camera: Camera) -> Float64[np.ndarray, "m 2 2"]:
    """Lines of the world (metres) in pixels, cut off at the near plane."""
    seen = lines @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    depth = seen[..., 2]
    seen = seen[(depth > NEAR_M).any(axis=1)]
    start, end = seen[:, 0], seen[:, 1]
    behind = seen[..., 2] < NEAR_M
    rise = np.where(behind.any(axis=1), end[:, 2] - start[:, 2], 1.0)
    crossing = start + ((NEAR_M - start[:, 2]) / rise)[:, None] * (end - start)
    seen = np.where(behind[..., None], crossing[:, None], seen)
    focal, center = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    return focal * seen[..., :2] / seen[..., 2:] + center
