"""A soft step between two values."""

import numpy as np
from jaxtyping import Float, Float32


def smoothstep(low: float, high: float, x: Float[np.ndarray, "*n"]) -> Float32[np.ndarray, "*n"]:
    """Rise from 0 at `low` to 1 at `high`."""
    t = np.clip((x - low) / (high - low), 0, 1).astype(np.float32)
    return t * t * (3 - 2 * t)
