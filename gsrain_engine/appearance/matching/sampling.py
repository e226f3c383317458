"""Pictures between their pixels. The first pixel has its centre at (0.5, 0.5)."""

import cv2
import numpy as np
from jaxtyping import Float, Float32


def sampled(
    image: Float[np.ndarray, "h w c"], places: Float32[np.ndarray, "h2 w2 2"]
) -> Float32[np.ndarray, "h2 w2 c"]:
    """Values at columns and rows in a picture, bilinear (OpenCV: to a 32nd of a pixel); its border goes on outside."""
    maps = places - np.float32(0.5)
    pixels = np.ascontiguousarray(image, np.float32)
    found = cv2.remap(pixels, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float32).reshape(*places.shape[:2], image.shape[2])
