"""Premultiplied pictures as display values and as linear light."""

import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.srgb import linear_to_srgb, srgb_to_linear

_LEAST_ALPHA = np.float32(1e-6)


def to_light(rgba: Float32[np.ndarray, "h w 4"]) -> Float32[np.ndarray, "h w 4"]:
    """Turn display colours times alpha into linear light times alpha; the colour itself is decoded, not the product."""
    alpha = np.maximum(rgba[..., 3:], _LEAST_ALPHA)
    return np.concatenate([srgb_to_linear(rgba[..., :3] / alpha) * alpha, rgba[..., 3:]], axis=-1, dtype=np.float32)


def to_display(light: Float32[np.ndarray, "h w 4"]) -> Float32[np.ndarray, "h w 4"]:
    """Turn linear light times alpha into display colours times alpha."""
    alpha = np.maximum(light[..., 3:], _LEAST_ALPHA)
    return np.concatenate([linear_to_srgb(light[..., :3] / alpha) * alpha, light[..., 3:]], axis=-1, dtype=np.float32)
