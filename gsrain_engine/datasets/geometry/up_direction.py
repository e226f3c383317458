"""Which way is up in a world that nobody levelled, from the cameras that stood in it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.camera import Camera

_TIE_BREAK = 0.02
"""Weight of "the pictures' own up on average" beside "right is level": decides only what the latter leaves open."""
_FLAT = 0.02
"""Places lie in a plane or on a line where their smallest variance is below this part of the largest."""
_STEEPEST_DRIVE = 0.5
"""Cosine between a way and the pictures' up from which on the way itself is up: a lift or a drone, not a road."""


def up_of_cameras(cameras: Sequence[Camera]) -> tuple[float, float, float]:
    """Estimate the unit upward direction in the world's axes.

    People and cars hold cameras so that the picture's rows are level: up is what is most square to all right axes.
    Cameras that all look one way leave their pitch open; where they stood on a flat course, up is square to it as well,
    else it is the mean of the pictures' own up.
    """
    rotations = np.stack([camera.world_to_camera[:3, :3] for camera in cameras])
    right, upright = rotations[:, 0], -rotations[:, 1].mean(axis=0)
    length = np.linalg.norm(upright)
    if length < 1e-9:
        return (0.0, 0.0, 1.0)
    upright = upright / length
    against = right.T @ right / len(right) + _course(cameras, upright)
    against += _TIE_BREAK * (np.eye(3) - np.outer(upright, upright))
    up = np.linalg.eigh(against)[1][:, 0]
    up = up if up @ upright > 0 else -up
    return (float(up[0]), float(up[1]), float(up[2]))


def _course(cameras: Sequence[Camera], upright: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """What directions the cameras went along, as a penalty; nothing where they went up, or everywhere."""
    places = np.stack([camera.position for camera in cameras])
    scatter = np.cov(places.T, bias=True) if len(places) > 2 else np.zeros((3, 3))
    variances, directions = np.linalg.eigh(scatter)
    if variances[2] <= 1e-12 or variances[0] > _FLAT * variances[2]:
        return np.zeros((3, 3))
    went = directions[:, 2]
    return np.zeros((3, 3)) if abs(went @ upright) > _STEEPEST_DRIVE else np.outer(went, went)
