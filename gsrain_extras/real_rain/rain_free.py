"""Frames without rain, from frames of a static camera in rain: streaks are replaced by other frames' pixels."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from scipy.special import ndtr

from .streaks import LINE_DIRECTIONS, MAD_TO_SIGMA, STEEP_DEG, MedianResiduals, line_responses

_SCALES = (1, 3)  # px: wide, blurred drops respond in means of 3 x 3 px
_STEEP = tuple(k for k in range(LINE_DIRECTIONS) if min(k, LINE_DIRECTIONS - k) * 180 <= STEEP_DEG * LINE_DIRECTIONS)
_EDGE_Z, _PEAK_Z = 1.2, 2.5
"""Far lower than those of the search for streaks: replaced noise does no harm, faint rain adds up to a veil."""
_MARGIN = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))
_NEIGHBORS = 6  # frames: three before, three after
_FLOW_BLUR_PX = 1.0  # noise would be taken for motion
_COHERENT_PX = 4.0  # size of what comes from one frame
_ALIKE = 1.3  # times the median of the neighbors' squared differences
_NOISE_PX, _MIN_SIGMA = 7, 0.5


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
    """Return chosen frames (RGB) with marked pixels replaced by those of another frame, moved to where they belong.

    Leaves move: each of the six nearest frames in time is aligned with a frame by dense optical flow (Kroeger et al.
    2016), and what differs from their median and from that of all frames is rain. It is replaced by whole pixels of
    the one frame that differs least from the median around it, so that noise, texture and motion remain those of the
    camera. `light` are slow changes of light between the frames. Where rain is not `visible`, the frame stays.
    """
    lumas = [cv2.cvtColor(each, cv2.COLOR_RGB2GRAY) for each in colors]
    behind = [_behind(colors, lumas, light, found.still, number) for number in chosen]
    residuals = np.stack([
        _smaller(lumas[number] - median, found.values[number] - light[number])
        for number, (median, _) in zip(chosen, behind, strict=True)
    ])  # fmt: skip
    sigma = cv2.blur(MAD_TO_SIGMA * np.median(np.abs(residuals), axis=0), (_NOISE_PX,) * 2).astype(np.float32)
    made: list[UInt8[np.ndarray, "h w 3"]] = []
    for number, residual, (_, other) in zip(chosen, residuals, behind, strict=True):
        marked = rain_mask(residual, np.maximum(sigma, np.float32(_MIN_SIGMA)))
        if visible is not None:
            marked &= visible
        made.append(np.where(marked[..., None], other, colors[number]))
    return made


def _behind(
    colors: Sequence[UInt8[np.ndarray, "h w 3"]],
    lumas: Sequence[UInt8[np.ndarray, "h w"]],
    light: Float32[np.ndarray, "t h w"],
    still: Bool[np.ndarray, "h w"],
    number: int,
) -> tuple[Float32[np.ndarray, "h w"], UInt8[np.ndarray, "h w 3"]]:
    """Luma behind the rain of a frame, and a picture of pixels of its neighbors that agree with it."""
    near = sorted((k for k in range(len(colors)) if k != number), key=lambda k: abs(k - number))[:_NEIGHBORS]
    height, width = lumas[number].shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    first, *others = (cv2.GaussianBlur(lumas[k], (0, 0), _FLOW_BLUR_PX) for k in (number, *near))
    moved: list[UInt8[np.ndarray, "h w 3"]] = []
    aligned: list[Float32[np.ndarray, "h w"]] = []
    for k, other in zip(near, others, strict=True):
        motion = flow.calc(first, other, np.zeros((height, width, 2), np.float32))
        motion[still] = 0  # on even surfaces it follows the noise
        row = np.clip(np.rint(y + motion[..., 1]), 0, height - 1).astype(np.intp)
        column = np.clip(np.rint(x + motion[..., 0]), 0, width - 1).astype(np.intp)
        change = light[number] - light[k][row, column]
        aligned.append(lumas[k][row, column] + change)
        moved.append(np.clip(np.rint(colors[k][row, column] + change[..., None]), 0, 255).astype(np.uint8))
    median = np.median(aligned, axis=0).astype(np.float32)
    unlike = np.stack([cv2.GaussianBlur((each - median) ** 2, (0, 0), _COHERENT_PX) for each in aligned])
    # The nearest one in time that is no worse than usual: always taking the best would take the least noise.
    best = np.argmax(unlike <= _ALIKE * np.median(unlike, axis=0), axis=0)
    return median, np.take_along_axis(np.stack(moved), best[None, ..., None], axis=0)[0]


def _smaller(one: Float32[np.ndarray, "h w"], other: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    return np.where(np.abs(one) < np.abs(other), one, other)


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
