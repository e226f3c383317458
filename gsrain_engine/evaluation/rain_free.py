"""Frames without rain, from frames of a static camera in rain: streaks are replaced by other frames' pixels."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from scipy.special import ndtr

from .streaks import LINE_DIRECTIONS, STEEP_DEG, MedianResiduals, line_responses

_SCALES = (1, 3)  # px: wide, blurred drops respond in means of 3 x 3 px
_STEEP = tuple(k for k in range(LINE_DIRECTIONS) if min(k, LINE_DIRECTIONS - k) * 180 <= STEEP_DEG * LINE_DIRECTIONS)
_EDGE_Z, _PEAK_Z = 1.2, 2.5
"""Far lower than those of the search for streaks: replaced noise does no harm, faint rain adds up to a veil."""
_MARGIN = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))


def rain_mask(residual: Float32[np.ndarray, "h w"], sigma: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Mark steep lines brighter or darker than the temporal median, faint ones and those before leaves included."""
    height, width = residual.shape
    marked = np.zeros((height, width), np.uint8)
    for scale in _SCALES:
        size = (max(width // scale, 1), max(height // scale, 1))
        normalized = cv2.resize(residual / sigma, size, interpolation=cv2.INTER_AREA)
        for sign in (1, -1):
            z = line_responses(np.float32(sign) * normalized, directions=_STEEP)
            labels = np.asarray(cv2.connectedComponents((z > _EDGE_Z).astype(np.uint8), connectivity=8)[1], np.int64)
            chosen = np.zeros(int(labels.max()) + 1, bool)
            chosen[np.unique(labels[z > _PEAK_Z])] = True
            chosen[0] = False
            found = chosen[labels].astype(np.uint8)
            marked[cv2.resize(found, (width, height), interpolation=cv2.INTER_NEAREST) > 0] = 1
    return cv2.dilate(marked, _MARGIN) > 0


def rain_free_frames(
    colors: Sequence[UInt8[np.ndarray, "h w 3"]],
    found: MedianResiduals,
    light: Float32[np.ndarray, "t h w"],
    chosen: Sequence[int],
    visible: Bool[np.ndarray, "h w"] | None = None,
) -> list[UInt8[np.ndarray, "h w 3"]]:
    """Return chosen frames (RGB) with marked pixels replaced by those of the nearest frame in time without a mark.

    Noise, compression and motion remain those of the camera. `light` are slow changes of light between the frames.
    Pixels that are marked in all frames become the median. Where rain is not `visible`, the frame stays.
    """
    masks = [rain_mask(values - slow, found.sigma) for values, slow in zip(found.values, light, strict=True)]
    median = np.median(colors, axis=0).astype(np.float32)
    made: list[UInt8[np.ndarray, "h w 3"]] = []
    for number in chosen:
        missing = masks[number] if visible is None else masks[number] & visible
        filled = colors[number].astype(np.float32)
        for other in sorted(range(len(colors)), key=lambda each: abs(each - number))[1:]:
            taken = missing & ~masks[other]
            change = (light[number] - light[other])[taken]
            filled[taken] = colors[other][taken] + change[:, None]
            missing = missing & masks[other]
        filled[missing] = median[missing] + light[number][missing][:, None]
        made.append(np.clip(np.rint(filled), 0, 255).astype(np.uint8))
    return made


# Black

_BLACK_NOISE_LEVELS = 4.0
"""Standard deviation of what is clipped at black, fitted to the rise of RainSense's streaks before gray 0 and 1."""
_DARKEST = -2.5  # standard deviations: darker ones leave no trace in some frames
_AROUND_PX = 5
_MEANS = np.linspace(-3, 8, 1 << 11)
_DENSITY = np.exp(-(_MEANS**2) / 2) / np.sqrt(2 * np.pi)
_CLIPPED = _DENSITY + _MEANS * ndtr(_MEANS)
"""Mean of a normal law of deviation 1 around each of _MEANS, values below 0 set to 0 (Tobin 1958)."""
_BELOW = _MEANS - _DENSITY / ndtr(-_MEANS)
"""Mean of its values below 0."""


def below_black(colors: Sequence[UInt8[np.ndarray, "h w 3"]]) -> Float32[np.ndarray, "h w 3"]:
    """Return the gray levels, below 0, that pixels of 0 would have if the camera did not clip them at black.

    Noise lifts some pixels above black: the fewer, the darker they are. Streaks must lift a pixel over that, too.
    """
    around = np.stack([cv2.blur(each.astype(np.float32), (_AROUND_PX,) * 2) for each in colors])
    mean = np.maximum(np.interp(np.median(around, axis=0) / _BLACK_NOISE_LEVELS, _CLIPPED, _MEANS), _DARKEST)
    return (_BLACK_NOISE_LEVELS * np.interp(mean, _MEANS, _BELOW)).astype(np.float32)
