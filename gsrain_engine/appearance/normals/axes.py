"""Turns normals between the world (metres, z up), where they point towards the eye, and the axes of estimators."""

import numpy as np
from jaxtyping import Float, Float32

from gsrain_engine.scene.camera import Camera


def right_down_outward(normals: Float[np.ndarray, "h w 3"], camera: Camera) -> Float32[np.ndarray, "h w 3"]:
    """Turn world normals towards the eye into camera axes (x right, y down, z forward), pointing away from the eye.

    DSINE's convention (Bae and Davison 2024): a wall that faces the camera has (0, 0, 1), the ground (0, 1, 0).
    """
    return (-(normals @ camera.world_to_camera[:3, :3].T)).astype(np.float32)


def from_right_down_outward(normals: Float[np.ndarray, "h w 3"], camera: Camera) -> Float32[np.ndarray, "h w 3"]:
    """Turn normals in camera axes (x right, y down, z forward) that point away from the eye into ours."""
    return (-(normals @ camera.world_to_camera[:3, :3])).astype(np.float32)


def from_right_up_backward(normals: Float[np.ndarray, "h w 3"], camera: Camera) -> Float32[np.ndarray, "h w 3"]:
    """Turn normals with x right, y up, z towards the eye, which point towards the eye, into ours.

    Marigold's convention (Ke et al. 2024): a wall that faces the camera has (0, 0, 1), the ground (0, 1, 0).
    """
    return ((normals * [1, -1, -1]) @ camera.world_to_camera[:3, :3]).astype(np.float32)
