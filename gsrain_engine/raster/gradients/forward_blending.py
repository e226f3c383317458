"""Sorted splats in tiles -> colour, alpha and depth in float32 or float64: the picture that gradients start from."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float

from ..compositing import BATCH, columns_of, is_finished
from ..fast_math import FAST
from ..tiles import TILE, TileLists
from .precision import exponential

MAX_ALPHA = 0.999
MIN_TRANSMITTANCE = 1e-4


class Picture(NamedTuple):
    """What splats are blended into, or a loss's gradient by it."""

    color: Float[np.ndarray, "h w 3"]
    """Display colour, premultiplied over nothing."""
    alpha: Float[np.ndarray, "h w"]
    depth: Float[np.ndarray, "h w"]
    """Sum of view depths (m) by weight."""


def blend(shapes: Float[np.ndarray, "n 8"], channels: Float[np.ndarray, "n 4"], tiles: TileLists) -> Picture:
    """Blend colour and depth of the splats (three channels and one) over nothing, in the precision of `shapes`.

    The weights are those of `compositing.composite`. The same bytes at any thread count.
    """
    h, w, dtype = tiles.height, tiles.width, shapes.dtype
    picture = Picture(np.empty((h, w, 3), dtype), np.empty((h, w), dtype), np.empty((h, w), dtype))
    _blend_tiles(shapes, channels, tiles.starts, tiles.members, tiles.columns, *picture)
    return picture


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def fragment(power, log_cut, most, nothing):
    """Alpha of a fragment from its logarithm: at most `most`, and `nothing` below the cut."""
    alpha = exponential(power)
    alpha = alpha if alpha < most else most
    return alpha if power >= log_cut else nothing


@numba.njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _blend_tiles(shapes, channels, starts, members, columns, color, alpha, depth):
    rows = (len(starts) - 1) // columns
    for place in numba.prange(len(starts) - 1):
        # Column by column, as in compositing.
        tile = place % rows * columns + place // rows
        _blend_tile(tile, shapes, channels, starts, members, columns, color, alpha, depth)


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _blend_tile(tile, shapes, channels, starts, members, columns, color, alpha, depth):
    height, width = alpha.shape
    real = shapes.dtype.type
    x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
    # A column's lines of TILE numbers: transmittance (0 once finished), three colours, depth, alpha.
    state = np.zeros((TILE, 6 * TILE), shapes.dtype)
    state[: width - x0, : min(TILE, height - y0)] = 1
    near_shapes, near_channels = np.empty((BATCH, 8), shapes.dtype), np.empty((BATCH, 4), shapes.dtype)
    for first in range(starts[tile], starts[tile + 1], BATCH):
        if is_finished(state):
            break
        batch = members[first : min(first + BATCH, starts[tile + 1])]
        for j in range(len(batch)):
            for i in range(8):
                near_shapes[j, i] = shapes[batch[j], i]
            for i in range(4):
                near_channels[j, i] = channels[batch[j], i]
        for j in range(len(batch)):
            _blend(near_shapes[j], near_channels[j], real(x0 + 0.5), real(y0 + 0.5), state)
    for v in range(min(TILE, height - y0)):
        for u in range(min(TILE, width - x0)):
            for c in range(3):
                color[y0 + v, x0 + u, c] = state[u, (c + 1) * TILE + v]
            depth[y0 + v, x0 + u] = state[u, 4 * TILE + v]
            alpha[y0 + v, x0 + u] = state[u, 5 * TILE + v]


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _blend(shape, channels, x0, y0, state):
    real = state.dtype.type
    most, least, nothing = real(MAX_ALPHA), real(MIN_TRANSMITTANCE), real(0)
    first, second, third, fourth = channels[0], channels[1], channels[2], channels[3]
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
            line[v + TILE] += weight * first
            line[v + 2 * TILE] += weight * second
            line[v + 3 * TILE] += weight * third
            line[v + 4 * TILE] += weight * fourth
            line[v + 5 * TILE] += weight
