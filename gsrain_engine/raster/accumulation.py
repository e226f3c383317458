"""The transpose of compositing: what each splat gathers from an image through its own weights."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32

from .compositing import BATCH, MIN_TRANSMITTANCE, alpha_of, columns_of, is_finished
from .fast_math import FAST
from .tiles import TILE, TileLists


def accumulate(
    shapes: Float32[np.ndarray, "m 8"], image: Float32[np.ndarray, "h w 3"], tiles: TileLists
) -> Float32[np.ndarray, "m 4"]:
    """Sum w(pixel) * image(pixel) over all pixels, a splat; the fourth column is the sum of w^2.

    The weights w are those of `composite`: blending is image = W colors, this is W^T image and the diagonal of W^T W.
    A splat's sum over each tile is taken by itself, then those in tile order: the same bytes at any thread count.
    """
    by_pair = np.zeros((len(tiles.members), 4), np.float32)
    _accumulate(shapes, tiles.starts, tiles.members, tiles.columns, image, by_pair)
    sums = np.zeros((len(shapes), 4), np.float32)
    _add_pairs(tiles.members, by_pair, sums)
    return sums


@numba.njit(cache=True)
@no_type_check
def _add_pairs(members, by_pair, sums):
    for k in range(len(members)):
        n = members[k]
        for channel in range(4):
            sums[n, channel] += by_pair[k, channel]


@numba.njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _accumulate(shapes, starts, members, columns, image, by_pair):
    height, width = image.shape[0], image.shape[1]
    rows = (len(starts) - 1) // columns
    for place in numba.prange(len(starts) - 1):
        # Column by column, as in compositing.
        tile = place % rows * columns + place // rows
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        # One line a column: transmittance (0 once finished) and the image's three channels.
        state = np.zeros((TILE, 4 * TILE), np.float32)
        state[: width - x0, : min(TILE, height - y0)] = 1
        for v in range(min(TILE, height - y0)):
            for u in range(min(TILE, width - x0)):
                for channel in range(3):
                    state[u, (channel + 1) * TILE + v] = image[y0 + v, x0 + u, channel]
        lanes = np.empty(4 * TILE, np.float32)
        for k in range(starts[tile], starts[tile + 1]):
            if (k - starts[tile]) % BATCH == 0 and is_finished(state):
                break
            lanes[:] = 0
            _gather(shapes[members[k]], np.float32(x0 + 0.5), np.float32(y0 + 0.5), state, lanes)
            for channel in range(4):
                total = np.float32(0)
                for u in range(TILE):
                    total += lanes[channel * TILE + u]
                by_pair[k, channel] = total


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _gather(shape, x0, y0, state, lanes):
    """Walk the same pixels with the same weights as compositing does; one lane a row of the tile."""
    y, shear, sharpness, log_cut = shape[1], shape[2], shape[4], shape[6]
    left, right = columns_of(shape, x0)
    for u in range(left, right):
        dx = np.float32(u) + (x0 - shape[0])
        peak = shape[5] + shape[3] * dx * dx
        start = y0 - (y + shear * dx)
        line = state[u]
        for v in range(TILE):
            dy = start + np.float32(v)
            alpha = alpha_of(sharpness * dy * dy + peak, log_cut)
            before = line[v]
            weight = before * alpha
            after = before - weight
            line[v] = after if after >= MIN_TRANSMITTANCE else np.float32(0)
            lanes[v] += weight * line[v + TILE]
            lanes[v + TILE] += weight * line[v + 2 * TILE]
            lanes[v + 2 * TILE] += weight * line[v + 3 * TILE]
            lanes[v + 3 * TILE] += weight * weight
