"""Rigid poses as 4x4 matrices: built, inverted, and turned from vehicle axes to those of a camera."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Float64

from gsrain_engine.scene.rotations import matrices_from_quaternions, quaternions_from_matrices

OPENCV_FROM_VEHICLE_AXES: Float64[np.ndarray, "4 4"] = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Turns x forward, y left, z up into x right, y down, z forward."""

_NOT_RIGID, _FARTHEST_M = 1e-2, 1e9


def rigid(rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> Float64[np.ndarray, "4 4"]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return matrix


def moved_to(translation: Float[np.ndarray, "3"]) -> Float64[np.ndarray, "4 4"]:
    """Pose without a turn."""
    return rigid(np.eye(3), translation)


def rigid_from_quaternion(quaternion_wxyz: Any, translation: Any) -> Float64[np.ndarray, "4 4"]:
    """Pose of a quaternion (4 numbers, any length) and a translation (3); ValueError where they are none."""
    turn, place = np.asarray(quaternion_wxyz, np.float64), np.asarray(translation, np.float64)
    if turn.shape != (4,) or place.shape != (3,):
        raise ValueError("a pose has 4 numbers for its rotation (w x y z) and 3 for its translation")
    in_bounds = np.abs(turn).max() < _FARTHEST_M and np.abs(place).max() < _FARTHEST_M
    length = np.linalg.norm(turn) if in_bounds else 0.0
    if not length > 1e-6:
        raise ValueError("the numbers of a pose must be finite, its place on this planet and its quaternion not zero")
    return rigid(matrices_from_quaternions(turn / length), place)


def rigid_from_numbers(values: Any) -> Float64[np.ndarray, "4 4"]:
    """Pose of 12 or 16 numbers by rows (nested or flat); ValueError where they are no rigid pose.

    Rounding of the file is taken out of the rotation, up to 1 %.
    """
    numbers = np.asarray(values, np.float64)
    if numbers.size not in (12, 16):
        raise ValueError(f"a pose has 12 or 16 numbers, not {numbers.size}")
    rows = numbers.reshape(-1, 4)[:3]
    rotation = rows[:, :3]
    if not np.abs(rows).max() < _FARTHEST_M:
        raise ValueError("the numbers of a pose must be finite, and its place on this planet")
    if (
        np.abs(rotation).max() > 2
        or np.abs(rotation @ rotation.T - np.eye(3)).max() > _NOT_RIGID
        or np.linalg.det(rotation) < 0
    ):
        raise ValueError("a pose must be a rotation without scale or mirroring")
    return rigid(matrices_from_quaternions(quaternions_from_matrices(rotation)), rows[:, 3])


def inverse(pose: Float[np.ndarray, "*n 4 4"]) -> Float64[np.ndarray, "*n 4 4"]:
    rotation = np.swapaxes(pose[..., :3, :3], -1, -2)
    matrix = np.zeros(pose.shape)
    matrix[..., :3, :3] = rotation
    matrix[..., :3, 3] = -(rotation @ pose[..., :3, 3:])[..., 0]
    matrix[..., 3, 3] = 1.0
    return matrix


@np.errstate(over="ignore", invalid="ignore")  # what is no number stays none, and is refused by who takes the points
def transformed(pose: Float[np.ndarray, "4 4"], points_m: Float[np.ndarray, "p 3"]) -> Float64[np.ndarray, "p 3"]:
    return points_m @ pose[:3, :3].T + pose[:3, 3]


def named_pose(values: Mapping[str, Any]) -> Float64[np.ndarray, "4 4"]:
    """Pose of {translation: {x y z}, rotation: {qw qx qy qz}}, as DGP writes it."""
    turn, place = values["rotation"], values["translation"]
    return rigid_from_quaternion([turn[f"q{axis}"] for axis in "wxyz"], [place[axis] for axis in "xyz"])
