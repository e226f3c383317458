"""What moves before a camera that stands still: frames minus their temporal median, and statistics of that."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

VISIBLE_LEVELS = 8
"""A pixel counts as changed where it differs from its median by more grey levels than this."""

RESTLESS_LEVELS = 4.5
"""Where the typical deviation is larger, something moves in most frames: leaves, water, people. Rain is in few."""

_MAD_TO_SIGMA = 1.4826
_LEAST_SIGMA = 0.5  # of a level: a grey value is a whole number
_RESTLESS_MARGIN_PX = 3


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Grey levels (0-255) of a camera that stands still."""

    median: UInt8[np.ndarray, "h w"]
    """Of each pixel over time."""
    values: Float32[np.ndarray, "t h w"]
    """Frame minus median, after the frame's own common shift (automatic exposure) is taken out."""
    sigma: Float32[np.ndarray, "h w"]
    """Typical deviation around each pixel, 1.4826 times the median of |value|: noise, as rain is in few frames."""
    still: Bool[np.ndarray, "h w"]
    """Where nothing but noise and rain moves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualStatistics:
    """Over all frames of the still pixels; shares are of those pixels, levels are grey levels of 255."""

    frames: int
    still_share: float
    """Of all pixels."""
    background_levels: float
    """Median over the still pixels of their temporal median."""
    noise_levels: float
    """Median over the still pixels of their typical deviation."""
    std_levels: float
    share_above: float
    """More than VISIBLE_LEVELS over the median."""
    share_below: float
    """As much under the median: before a dark background no rain does this."""


def residuals(frames: UInt8[np.ndarray, "t h w"]) -> Residuals:
    """Take the temporal median from grey frames. Raises ValueError for fewer than 5 frames: their median holds rain."""
    if len(frames) < 5:
        raise ValueError(f"{len(frames)} frames: a temporal median free of rain takes at least 5")
    middle = len(frames) // 2
    median = np.partition(frames, middle, axis=0)[middle]
    values = frames.astype(np.float32) - median
    values -= np.median(values.reshape(len(values), -1), axis=1).astype(np.float32)[:, None, None]
    # Grey levels are whole numbers: only neighbours together tell a deviation to better than 1.5 levels.
    sigma = cv2.blur(_MAD_TO_SIGMA * np.partition(np.abs(values), middle, axis=0)[middle], (7, 7)).astype(np.float32)
    restless = (sigma > RESTLESS_LEVELS).astype(np.uint8)
    around = np.ones((2 * _RESTLESS_MARGIN_PX + 1,) * 2, np.uint8)
    still = cv2.dilate(restless, around) == 0
    return Residuals(median, values, np.maximum(sigma, np.float32(_LEAST_SIGMA)), still)


def residual_statistics(found: Residuals) -> ResidualStatistics:
    """Summarize residuals. Raises ValueError where no pixel is still."""
    if not found.still.any():
        raise ValueError("no pixel stands still in these frames: choose another window")
    values = found.values[:, found.still]
    return ResidualStatistics(
        frames=len(values),
        still_share=float(found.still.mean()),
        background_levels=float(np.median(found.median[found.still])),
        noise_levels=float(np.median(found.sigma[found.still])),
        std_levels=float(values.std()),
        share_above=float((values > VISIBLE_LEVELS).mean()),
        share_below=float((values < -VISIBLE_LEVELS).mean()),
    )
