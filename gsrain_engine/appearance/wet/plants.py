"""Leaves and grass, told by their colour."""

import numpy as np
from jaxtyping import Float32

from .smoothstep import smoothstep


def plant_share(image: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w"]:
    """How much a display colour looks like leaves and grass: greener than blue and than a warm grey."""
    red, green, blue = (image[..., i] for i in range(3))
    brightest = np.maximum(image.max(axis=-1), 1e-3)
    return smoothstep(0.08, 0.3, (green - blue) / brightest) * smoothstep(-0.06, 0.06, (green - red) / brightest)
