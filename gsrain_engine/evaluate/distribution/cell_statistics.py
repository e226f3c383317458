"""Plain numbers of a picture's sixteen cells, which need no weights: the features of "FD-pixels16"."""

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from .resizing import resized

CELLS = 4
SIZE_PX = 128
PER_CELL = 10
FEATURES = CELLS * CELLS * PER_CELL


def cell_statistics(image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, " d"]:
    """Return 160 numbers: colour, its spread, and edges by direction, of each of 4 x 4 cells.

    Of the picture at 128 x 128 (`resized`), in display values of 0..1: means and deviations of the three channels, and
    the mean square gradient of their mean along four directions (0, 45, 90, 135 degrees), as roots. It sees brightness,
    colour, contrast and texture, and nothing of what is shown: for tests, and where there are no weights.
    """
    values = resized(image, SIZE_PX, SIZE_PX).astype(np.float64) / 255
    across, down = np.gradient(values.mean(axis=2), axis=(1, 0))
    slopes = np.stack([across, (across + down) / np.sqrt(2), down, (down - across) / np.sqrt(2)], axis=2)
    parts = (_means(values), _deviations(values), np.sqrt(_means(slopes**2)))
    return np.concatenate(parts, axis=2).reshape(-1).astype(np.float32)


def _means(values: Float64[np.ndarray, "h w c"]) -> Float64[np.ndarray, "cells cells c"]:
    height, width, channels = values.shape
    return values.reshape(CELLS, height // CELLS, CELLS, width // CELLS, channels).mean(axis=(1, 3))


def _deviations(values: Float64[np.ndarray, "h w c"]) -> Float64[np.ndarray, "cells cells c"]:
    return np.sqrt(np.maximum(_means(values**2) - _means(values) ** 2, 0))
