"""Guided filters (He, Sun and Tang 2013): smoothing that follows the edges of a guide, by a brightness or by colors.

They need box filters only, which each build of OpenCV has: other packages install the one without `ximgproc`.
"""

from typing import Any

import lazy_loader
import numpy as np
from jaxtyping import Bool, Float32

cv2: Any = lazy_loader.load("cv2")  # only photographs need it

Image = Float32[np.ndarray, "h w 3"]
Plane = Float32[np.ndarray, "h w"]


def guided_filter(values: Plane, guide: Plane, radius: int, variance: float) -> Plane:
    """Smooth `values` along the edges of `guide`, as a local linear function of it (He, Sun and Tang 2013).

    `radius` is that of the window in pixels, `variance` that of the guide from which it has an edge.
    """
    size = (2 * radius + 1, 2 * radius + 1)
    mean, mean_guide = cv2.blur(values, size), cv2.blur(guide, size)
    together = cv2.blur(values * guide, size) - mean * mean_guide
    alone = cv2.blur(guide * guide, size) - mean_guide**2
    slope = together / (np.maximum(alone, 0) + variance)
    offset = mean - slope * mean_guide
    return (cv2.blur(slope, size) * guide + cv2.blur(offset, size)).astype(np.float32)


def color_guided_filter(
    values: Plane, guide: Image, radius_px: int, spread: float, known: Bool[np.ndarray, "h w"] | None = None
) -> Plane:
    """Fit values by a linear function of the guide's color in each window, and take the mean of the fits.

    `spread` is the standard deviation of color (0..1) below which nothing counts as an edge. Where only some values
    are `known`, the others are filled from their neighbors.
    """
    side = (2 * radius_px + 1, 2 * radius_px + 1)

    def mean(each: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.blur(each, side, borderType=cv2.BORDER_REFLECT))

    weight = np.ones_like(values) if known is None else known.astype(np.float32)
    total = np.maximum(mean(weight), np.float32(1e-6))
    channels = [np.ascontiguousarray(guide[..., i]) for i in range(3)]
    colors = [mean(each * weight) / total for each in channels]
    value = mean(values * weight) / total

    def covariance(i: int, j: int) -> np.ndarray:
        own = np.float32(spread**2 if i == j else 0)
        return mean(channels[i] * channels[j] * weight) / total - colors[i] * colors[j] + own

    rr, rg, rb, gg, gb, bb = (covariance(*pair) for pair in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    r, g, b = (
        mean(each * values * weight) / total - color * value for each, color in zip(channels, colors, strict=True)
    )
    # Rows of the inverse by cofactors: a solver for millions of small matrices takes several times as long.
    first, second, third = gg * bb - gb * gb, gb * rb - rg * bb, rg * gb - gg * rb
    inverse = 1 / (rr * first + rg * second + rb * third)
    slopes = (
        (first * r + second * g + third * b) * inverse,
        (second * r + (rr * bb - rb * rb) * g + (rg * rb - rr * gb) * b) * inverse,
        (third * r + (rg * rb - rr * gb) * g + (rr * gg - rg * rg) * b) * inverse,
    )
    offset = value - sum(slope * color for slope, color in zip(slopes, colors, strict=True))
    counts = (total > 1e-6).astype(np.float32)  # only windows with a known value count
    fitted = sum(mean(slope * counts) * each for slope, each in zip(slopes, channels, strict=True))
    return ((fitted + mean(offset * counts)) / np.maximum(mean(counts), 1e-6)).astype(np.float32)
