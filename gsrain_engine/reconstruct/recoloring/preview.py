"""Pictures of the work while it goes on."""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

_WIDTH_PX = 320


def small_picture(picture: Float32[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "_ _ 3"]:
    """Return a picture (display colour) at most 320 pixels wide, for a panel to show."""
    shrink = min(1.0, _WIDTH_PX / picture.shape[1])
    small = cv2.resize(picture, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    return np.rint(np.clip(small, 0, 1) * np.float32(255)).astype(np.uint8)
