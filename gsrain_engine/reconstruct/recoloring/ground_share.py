"""Which pixels of a view show ground: what faces up, at the ground's height."""

import numpy as np
from jaxtyping import Float32, Float64

from gsrain_engine.appearance.normals.from_depth import world_points
from gsrain_engine.scene.camera import Camera

_FACING_UP = (0.6, 0.9)
"""Upward parts of normals from which surfaces may be ground, and from which they are."""
_BAND_M = (0.25, 0.6)
"""Heights over the ground up to which they are, and from which they aren't."""


def ground_share(
    depth: Float32[np.ndarray, "h w"], upness: Float32[np.ndarray, "h w"], camera: Camera, ground_m: float
) -> Float32[np.ndarray, "h w"]:
    """How much each pixel shows of the ground, 0 to 1.

    Args:
        depth: Along the view axis in metres, 0 where unknown.
        upness: World-up part of the unit normal, -1..1.
        camera: In the world (metres, z up).
        ground_m: Height of the ground in the world.
    """
    heights = world_points(depth, camera)[..., 2] - ground_m
    share = _rising(*_FACING_UP, upness.astype(np.float64)) * (1 - _rising(*_BAND_M, heights))
    return np.where(depth > 0, share, 0).astype(np.float32)


def _rising(low: float, high: float, x: Float64[np.ndarray, "h w"]) -> Float64[np.ndarray, "h w"]:
    """Go smoothly from 0 at `low` to 1 at `high`."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
