"""The sRGB transfer function (IEC 61966-2-1): display values <-> linear light."""

from typing import Any

import numpy as np
from jaxtyping import Float


def srgb_to_linear(display: Float[np.ndarray, "*n"]) -> Float[Any, "*n"]:
    """Turn display values into linear light; both are 1 for white. Values below 0 count as 0."""
    c = np.maximum(display, 0)
    return np.where(c > 0.04045, ((c + 0.055) / 1.055) ** 2.4, c / 12.92)


def linear_to_srgb(linear: Float[np.ndarray, "*n"]) -> Float[Any, "*n"]:
    """Turn linear light into display values; both are 1 for white. Values below 0 count as 0."""
    c = np.maximum(linear, 0)
    return np.where(c > 0.0031308, 1.055 * c ** (1 / 2.4) - 0.055, 12.92 * c)
