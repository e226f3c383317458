"""Actors from objects in boxes, with axes of their own and poses over time, as recordings and trainings have them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float64

from ..gaussians import Gaussians
from ..geometry import matrices_from_quaternions, quaternions_from_matrices
from ..scene import Actor, PoseTrack
from ..transforms import transform_gaussians

FORWARD, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
"""Of an object with our axes."""


def boxed_actor(
    name: str,
    class_name: str,
    gaussians: Gaussians,
    front: Float64[np.ndarray, "3"],
    up: Float64[np.ndarray, "3"],
    corners: Sequence[Float[np.ndarray, "3"]] | Float64[np.ndarray, "c 3"],
    times: Float64[np.ndarray, " t"],
    poses: Float64[np.ndarray, "t 4 4"],
    valid: Bool[np.ndarray, " t"],
) -> Actor:
    """Turn an object to our axes: x forward, y left, z up, origin at the bottom center of its box.

    `front`, `up` and the box's `corners` are in the object's own frame, which `poses` place in the scene at `times`
    (increasing, seconds); it is present from a time to the next one where `valid`.
    """
    to_actor = np.eye(4)
    to_actor[:3, :3] = np.stack([front, np.cross(up, front), up])
    turned = np.asarray(corners, np.float64) @ to_actor[:3, :3].T
    low, high = turned.min(axis=0), turned.max(axis=0)
    to_actor[:3, 3] = *(-(low + high) / 2)[:2], -low[2]
    length, width, height = (high - low).tolist()
    track = track_of(times, poses @ np.linalg.inv(to_actor), valid)
    return Actor(name, class_name, (length, width, height), transform_gaussians(gaussians, to_actor), track)


def hidden_actor(name: str, gaussians: Gaussians) -> Actor:
    """Actor at the origin, in a box around its own, of an object whose track is unknown."""
    half = np.abs(gaussians.means).max(axis=0, initial=0).astype(np.float64)
    pose = np.eye(4)[None]
    actor = boxed_actor(name, "object", gaussians, FORWARD, UP, [-half, half], np.zeros(1), pose, np.ones(1, np.bool_))
    return replace(actor, visible=False)


def track_of(
    times: Float64[np.ndarray, " t"], poses: Float64[np.ndarray, "t 4 4"], valid: Bool[np.ndarray, " t"]
) -> PoseTrack:
    """Track of rigid poses."""
    return PoseTrack(times, poses[:, :3, 3], quaternions_from_matrices(poses[:, :3, :3]), valid)


def poses_of(positions: Any, quaternions_wxyz: Any) -> Float64[np.ndarray, "t 4 4"]:
    """Matrices of positions and quaternions of any length above 0."""
    positions, quaternions = np.asarray(positions, np.float64), np.asarray(quaternions_wxyz, np.float64)
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, 3] = positions
    poses[:, :3, :3] = matrices_from_quaternions(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))
    return poses


def valid_between(present: Bool[np.ndarray, " f"]) -> Bool[np.ndarray, " t"]:
    """Mask, for the frames in which an object is present, of those that it is present to the next one from.

    In the last frame of all it stays.
    """
    after = np.append(present[1:], True)
    return after[present]
