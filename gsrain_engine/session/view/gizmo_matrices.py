"""What a gizmo library wants to know of a camera, and what its handles mean: 4x4 matrices, column by column."""

from typing import Literal

import numpy as np
from jaxtyping import Float32, Float64

from gsrain_engine.scene.camera import Camera

Handle = Literal["translate", "rotate", "scale"]

_NEAR_M, _FAR_M = 0.05, 5000.0


def opengl_view(camera: Camera) -> list[float]:
    """World to eye in OpenGL's axes (x right, y up, z backward)."""
    return column_major(np.diag([1.0, -1.0, -1.0, 1.0]) @ camera.world_to_camera)


def opengl_projection(camera: Camera) -> list[float]:
    """Eye to clip space of OpenGL, by the camera's own focal lengths and centre."""
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[0, 2] = 2 * camera.fx / camera.width, 1 - 2 * camera.cx / camera.width
    matrix[1, 1], matrix[1, 2] = 2 * camera.fy / camera.height, 2 * camera.cy / camera.height - 1
    matrix[2, 2] = -(_FAR_M + _NEAR_M) / (_FAR_M - _NEAR_M)
    matrix[2, 3] = -2 * _FAR_M * _NEAR_M / (_FAR_M - _NEAR_M)
    matrix[3, 2] = -1
    return column_major(matrix)


def column_major(matrix: Float64[np.ndarray, "4 4"]) -> list[float]:
    """Sixteen numbers, one column after the other."""
    return matrix.T.ravel().tolist()


def from_column_major(values: Float32[np.ndarray, "16"]) -> Float64[np.ndarray, "4 4"]:
    """Matrix of sixteen numbers, one column after the other."""
    return values.astype(np.float64).reshape(4, 4).T


def standing_at(point_m: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "4 4"]:
    """Frame at a point of the world, with the world's axes."""
    frame = np.eye(4)
    frame[:3, 3] = point_m
    return frame


def dragged_by(
    handle: Handle, start: Float64[np.ndarray, "4 4"], now: Float64[np.ndarray, "4 4"]
) -> Float64[np.ndarray, "4 4"]:
    """Similarity of the world by which a handle took a gizmo's frame from `start` to `now`.

    A gizmo computes in single precision and scales each axis on its own: what a handle does not mean is left out, and
    the axis that was scaled most scales all three, around the gizmo's place.
    """
    there, back, way = standing_at(start[:3, 3]), standing_at(-start[:3, 3]), np.eye(4)
    if handle == "translate":
        way[:3, 3] = now[:3, 3] - start[:3, 3]
        return way
    change = now[:3, :3] @ np.linalg.inv(start[:3, :3])
    if handle == "scale":
        factors = np.clip(np.linalg.norm(change, axis=0), 1e-3, 1e3)
        way[:3, :3] *= factors[np.argmax(np.abs(np.log(factors)))]
    else:
        u, _, v = np.linalg.svd(change)  # the nearest rotation
        way[:3, :3] = u @ v
    return there @ way @ back
