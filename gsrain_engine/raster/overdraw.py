"""How many fragments a pixel is made of."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32

from .compositing import columns_of
from .fast_math import FAST
from .tiles import TILE, TileLists


def count_fragments(shapes: Float32[np.ndarray, "m 8"], tiles: TileLists) -> Float32[np.ndarray, "h w"]:
    """Count the splats whose alpha in a pixel is not below their cut, also those behind what is opaque."""
    counts = np.empty((tiles.height, tiles.width), np.float32)
    _count(shapes, tiles.starts, tiles.members, tiles.columns, counts)
    return counts


@numba.njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _count(shapes, starts, members, columns, counts):
    height, width = counts.shape
    for tile in numba.prange(len(starts) - 1):
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        state = np.zeros((TILE, TILE), np.float32)
        for k in range(starts[tile], starts[tile + 1]):
            _count_pixels(shapes[members[k]], np.float32(x0 + 0.5), np.float32(y0 + 0.5), state)
        for v in range(min(TILE, height - y0)):
            for u in range(min(TILE, width - x0)):
                counts[y0 + v, x0 + u] = state[u, v]


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _count_pixels(shape, x0, y0, state):
    left, right = columns_of(shape, x0)
    for u in range(left, right):
        dx = np.float32(u) + (x0 - shape[0])
        peak = shape[5] + shape[3] * dx * dx
        start = y0 - (shape[1] + shape[2] * dx)
        for v in range(TILE):
            dy = start + np.float32(v)
            state[u, v] += np.float32(1) if shape[4] * dy * dy + peak >= shape[6] else np.float32(0)
