"""What splats' colours alone ask of a picture's gradient: all that a fixed geometry needs, in either precision."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float

from ..compositing import BATCH, columns_of, is_finished
from ..fast_math import FAST
from ..tiles import TILE, TileLists
from .forward_blending import MAX_ALPHA, MIN_TRANSMITTANCE, fragment
from .pair_sums import add_lanes, add_pairs


def gather_colors(
    shapes: Float[np.ndarray, "n 8"], tiles: TileLists, gradient: Float[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "n 3"]:
    """Sum w G over the pixels of each splat: all that its colour needs where nothing else is to move."""
    by_pair = np.zeros((len(tiles.members), 3), shapes.dtype)
    _gather_colors(shapes, tiles.starts, tiles.members, tiles.columns, gradient, by_pair)
    return add_pairs(tiles.members, by_pair, len(shapes))


@numba.njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _gather_colors(shapes, starts, members, columns, by_color, by_pair):
    rows = (len(starts) - 1) // columns
    for place in numba.prange(len(starts) - 1):
        # Column by column, as in compositing.
        tile = place % rows * columns + place // rows
        _gather_colors_of_tile(tile, shapes, starts, members, columns, by_color, by_pair)


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _gather_colors_of_tile(tile, shapes, starts, members, columns, by_color, by_pair):
    height, width = by_color.shape[:2]
    real = shapes.dtype.type
    x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
    state = np.zeros((TILE, 4 * TILE), shapes.dtype)
    state[: width - x0, : min(TILE, height - y0)] = 1
    for v in range(min(TILE, height - y0)):
        for u in range(min(TILE, width - x0)):
            for c in range(3):
                state[u, (c + 1) * TILE + v] = by_color[y0 + v, x0 + u, c]
    lanes = np.empty(3 * TILE, shapes.dtype)
    near_shapes = np.empty((BATCH, 8), shapes.dtype)
    for first in range(starts[tile], starts[tile + 1], BATCH):
        if is_finished(state):
            break
        batch = members[first : min(first + BATCH, starts[tile + 1])]
        for j in range(len(batch)):
            for i in range(8):
                near_shapes[j, i] = shapes[batch[j], i]
        for j in range(len(batch)):
            lanes[:] = 0
            _gather_color(near_shapes[j], real(x0 + 0.5), real(y0 + 0.5), state, lanes)
            add_lanes(lanes, 3, by_pair[first + j])


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _gather_color(shape, x0, y0, state, lanes):
    real = state.dtype.type
    most, least, nothing = real(MAX_ALPHA), real(MIN_TRANSMITTANCE), real(0)
    y, shear, sharpness, log_cut = shape[1], shape[2], shape[4], shape[6]
    left, right = columns_of(shape, x0)
    for u in range(left, right):
        dx = real(u) + (x0 - shape[0])
        peak = shape[5] + shape[3] * dx * dx
        start = y0 - (y + shear * dx)
        line = state[u]
        for v in range(TILE):
            dy = start + real(v)
            alpha = fragment(sharpness * dy * dy + peak, log_cut, most, nothing)
            before = line[v]
            weight = before * alpha
            after = before - weight
            line[v] = after if after >= least else nothing
            lanes[v] += weight * line[v + TILE]
            lanes[v + TILE] += weight * line[v + 2 * TILE]
            lanes[v + 2 * TILE] += weight * line[v + 3 * TILE]
