"""Guided filters (He, Sun and Tang 2013): smoothing that follows the edges of a guide, by a brightness or by colors.

They need box filters only, which each build of OpenCV has: other packages install the one without `ximgproc`.
Fits of a small guide also follow the edges of the same picture in a larger size (He and Sun 2015, Fast guided filter).
"""

from collections.abc import Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True, eq=False)
class GuidedFit:
    """Values as a linear function of the guide's channels around each pixel, weighted by `weight`."""

    slopes: tuple[Plane, ...]
    """One a channel."""
    offset: Plane
    weight: Plane

    def at(self, channels: Sequence[Plane]) -> Plane:
        """Return the values at a guide's channels, one for each slope, of the size of the fit's own or larger."""
        size = channels[0].shape[1], channels[0].shape[0]

        def resized(each: Plane) -> Float32[np.ndarray, "tall wide"]:
            return each if each.shape == channels[0].shape else cv2.resize(each, size, interpolation=cv2.INTER_LINEAR)

        fitted = sum(resized(slope) * each for slope, each in zip(self.slopes, channels, strict=True))
        return ((fitted + resized(self.offset)) / np.maximum(resized(self.weight), 1e-6)).astype(np.float32)


def guided_fit(
    values: Plane, guide: Plane, radius_px: int, spread: float, known: Bool[np.ndarray, "h w"] | None = None
) -> GuidedFit:
    """Fit values by a linear function of a brightness; the arguments are those of `color_guided_fit`."""
    side = (2 * radius_px + 1, 2 * radius_px + 1)
    weight = np.ones_like(values) if known is None else known.astype(np.float32)
    total = np.maximum(cv2.blur(weight, side), np.float32(1e-6))
    mean, mean_guide = cv2.blur(values * weight, side) / total, cv2.blur(guide * weight, side) / total
    together = cv2.blur(values * guide * weight, side) / total - mean * mean_guide
    alone = cv2.blur(guide * guide * weight, side) / total - mean_guide**2
    slope = together / (np.maximum(alone, 0) + np.float32(spread**2))
    counts = (total > 1e-6).astype(np.float32)
    offset = mean - slope * mean_guide
    return GuidedFit((cv2.blur(slope * counts, side),), cv2.blur(offset * counts, side), cv2.blur(counts, side))


def color_guided_filter(
    values: Plane, guide: Image, radius_px: int, spread: float, known: Bool[np.ndarray, "h w"] | None = None
) -> Plane:
    """Return the values of a `color_guided_fit` at its own guide."""
    fit = color_guided_fit(values, guide, radius_px, spread, known)
    return fit.at([np.ascontiguousarray(guide[..., i]) for i in range(3)])


def color_guided_fit(
    values: Plane, guide: Image, radius_px: int, spread: float, known: Bool[np.ndarray, "h w"] | None = None
) -> GuidedFit:
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
    return GuidedFit(tuple(mean(slope * counts) for slope in slopes), mean(offset * counts), mean(counts))
