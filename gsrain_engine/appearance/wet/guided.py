"""The guided filter: smooths one picture, and keeps to the edges of another one."""

import cv2
import numpy as np
from jaxtyping import Float32

Plane = Float32[np.ndarray, "h w"]


def guided(values: Plane, guide: Plane, radius: int, variance: float) -> Plane:
    """Return `values` as a local linear function of `guide` (He, Sun and Tang 2013).

    Args:
        values: What is smoothed.
        guide: Whose edges stay.
        radius: Of the surroundings, in pixels.
        variance: Of the guide, from which something is an edge.
    """
    size = (2 * radius + 1, 2 * radius + 1)
    mean, mean_guide = cv2.blur(values, size), cv2.blur(guide, size)
    together = cv2.blur(values * guide, size) - mean * mean_guide
    alone = cv2.blur(guide * guide, size) - mean_guide**2
    slope = together / (np.maximum(alone, 0) + variance)
    offset = mean - slope * mean_guide
    return (cv2.blur(slope, size) * guide + cv2.blur(offset, size)).astype(np.float32)
