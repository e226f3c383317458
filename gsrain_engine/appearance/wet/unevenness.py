"""Small slopes of the water's surface that a picture resolves: reflections get ragged edges from them."""

import numpy as np
from jaxtyping import Float32, Float64

from .bumps import bumps

_SIZES_M = (0.45, 0.17, 0.07)
_SEEN = 0.5
"""Part of a bump's size up to which a pixel's length shows it."""


def unevenness(
    points_m: Float64[np.ndarray, "h w 3"], footprint_m: Float32[np.ndarray, "h w"], seed: int
) -> Float32[np.ndarray, "h w 2"]:
    """Slopes along the world's x and y at places, at random, with a standard deviation of 1.

    `footprint_m` is a pixel's length on the ground: bumps that it hides are left out.
    """
    slopes = np.zeros((*footprint_m.shape, 2), np.float32)
    for k, size in enumerate(_SIZES_M):
        share = np.float32(len(_SIZES_M) ** -0.5) / (1 + np.square(np.minimum(footprint_m / (_SEEN * size), 1e3)))
        for axis in range(2):
            slopes[..., axis] += share * bumps(points_m, size, 1.3 * k + axis, 977 * (seed + 1) + 2 * k + axis)
    return slopes


def tilted(
    normals: Float32[np.ndarray, "h w 3"], slopes: Float32[np.ndarray, "h w 2"], by: float
) -> Float32[np.ndarray, "h w 3"]:
    """Tilt upward unit normals by slopes times a number."""
    tilts = np.concatenate([np.float32(by) * slopes, np.zeros_like(slopes[..., :1])], axis=-1)
    return (normals + tilts) / np.sqrt(1 + np.sum(tilts * tilts, axis=-1, keepdims=True))
