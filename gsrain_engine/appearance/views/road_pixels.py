"""Guesses the road in a picture of which nothing is known: what looks like the patch before the car, and joins it."""

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

_SEED = (0.60, 0.74, 0.40, 0.60)
"""Rows and columns, as parts of the picture, of the patch before a car with a camera; below it a bonnet may be."""
_SPREAD = 3.0
"""Deviations from the patch's colours up to which a pixel looks like it."""
_DEVIATIONS = np.array([[4.0, 1.5, 1.5], [14.0, 3.0, 3.0]], np.float32)
"""Least and largest that are taken for the patch's, in CIELAB as OpenCV scales it to bytes: shade may differ more than
hue."""
_STEP = 7.0
"""Gradient of lightness, a byte's steps a pixel, that is the edge of something else; that of a patch may be more."""
_DARKEST = 30.0
"""Lightness, as a byte, of a patch of which nothing can be told: at night all is alike."""
_HOLE = 0.005
"""Part of the picture up to which what the road encloses is on it: markings, cracks, spots of sun."""
_MOST = 0.6
"""Part of the picture from which it is not the road that was found."""


def road_pixels(image: UInt8[np.ndarray, "h w 3"], may_be: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Which pixels look like the road; none where the patch before the camera is not even.

    Args:
        image: Display colour.
        may_be: Pixels that look down and are no sky.
    """
    height, width = may_be.shape
    top, bottom, left, right = (round(part * side) for part, side in zip(_SEED, (height, height, width, width),
                                                                         strict=True))  # fmt: skip
    lab = cv2.cvtColor(cv2.GaussianBlur(image, (0, 0), max(width / 400, 0.8)), cv2.COLOR_RGB2LAB).astype(np.float32)
    seed = lab[top:bottom, left:right].reshape(-1, 3)
    nothing = np.zeros((height, width), np.bool_)
    if not len(seed):
        return nothing
    middle = np.median(seed, axis=0)
    if middle[0] < _DARKEST:
        return nothing
    deviation = np.clip(1.48 * np.median(np.abs(seed - middle), axis=0), *_DEVIATIONS)
    alike = (np.abs(lab - middle) <= _SPREAD * deviation).all(axis=2)
    slope = cv2.magnitude(*(cv2.Sobel(lab[..., 0], cv2.CV_32F, *way, scale=0.125) for way in ((1, 0), (0, 1))))
    own_slope = float(np.quantile(slope[top:bottom, left:right], 0.8))
    smooth = (alike & (slope <= max(_STEP, own_slope)) & may_be).astype(np.uint8)
    reach = max(width // 60, 3)  # lane markings, cracks and cables lie on the road
    opened = cv2.morphologyEx(smooth, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    joined = cv2.morphologyEx(opened, cv2.MORPH_CLOSE, np.ones((reach, reach), np.uint8))
    parts = cv2.connectedComponents(joined)[1]
    in_seed = np.bincount(parts[top:bottom, left:right].ravel(), minlength=2)
    in_seed[0] = 0
    if in_seed.max() < 0.4 * len(seed):
        return nothing
    found = parts == in_seed.argmax()
    road = _without_small_holes(found) & may_be
    return road if road.mean() <= _MOST else nothing


def _without_small_holes(found: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    parts = np.asarray(cv2.connectedComponents((~found).astype(np.uint8), connectivity=4)[1], np.int64)
    is_small = np.bincount(parts.ravel()) < _HOLE * found.size
    is_small[0] = True  # the road itself
    return np.asarray(is_small[parts])
