"""A picture blurred by every power of two across and down, each by itself: what a rough mirror shows is stretched."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Int64

_ACROSS, _DOWN = 5, 8


class Blurred(NamedTuple):
    """Pictures of halving sizes, one after the other (a "ripmap", McReynolds et al. 1998)."""

    values: Float32[np.ndarray, " n"]
    """All pictures, rows of three channels."""
    table: Int64[np.ndarray, "down across 3"]
    """Where each picture begins among the values, its rows and columns."""


def blurred(image: Float32[np.ndarray, "h w 3"]) -> Blurred:
    """Halve a picture (linear light) down and across, again and again."""
    pieces, rows = list[Float32[np.ndarray, " n"]](), list[list[tuple[int, int, int]]]()
    start, tall = 0, np.ascontiguousarray(image)
    for _ in range(_DOWN):
        wide, line = tall, list[tuple[int, int, int]]()
        for _ in range(_ACROSS):
            line.append((start, wide.shape[0], wide.shape[1]))
            pieces.append(wide.ravel())
            start += wide.size
            wide = cv2.resize(wide, (max(wide.shape[1] // 2, 1), wide.shape[0]), interpolation=cv2.INTER_AREA)
        rows.append(line)
        tall = cv2.resize(tall, (tall.shape[1], max(tall.shape[0] // 2, 1)), interpolation=cv2.INTER_AREA)
    return Blurred(np.concatenate(pieces), np.array(rows, np.int64))
