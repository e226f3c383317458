"""Random bumps of the ground, as a function of place in the world: all views see the same. Metres."""

from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, Float32

_TEXTURE = 512
"""Bumps along a side until they repeat."""
_BLENDED = 0.85
"""Standard deviation that cubic blending leaves of independent random heights."""


def bumps(points_m: Float[np.ndarray, "h w 3"], size_m: float, turn: float, seed: int) -> Float32[np.ndarray, "h w"]:
    """Smooth noise of mean 0 and variance 1 on a turned lattice of the given pitch."""
    c, s = np.cos(turn) / size_m, np.sin(turn) / size_m
    x, y = points_m[..., 0], points_m[..., 1]
    across, along = c * x + s * y, c * y - s * x
    columns, rows = (np.mod(each, _TEXTURE - 4).astype(np.float32) + 1 for each in (across, along))
    return cv2.remap(_texture(seed), columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP)


@lru_cache(maxsize=32)
def _texture(seed: int) -> Float32[np.ndarray, "n n"]:
    """Random heights that repeat; scaled for the variance that blending between them takes away."""
    side = _TEXTURE - 4
    values = np.random.default_rng(seed).standard_normal((side, side)).astype(np.float32)
    return np.pad(values / np.float32(_BLENDED), (1, 3), mode="wrap")
