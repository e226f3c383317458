"""The nearest ellipsoid in each pixel: Gaussians as solid bodies."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32

from .compositing import BATCH, columns_of, is_finished
from .fast_math import FAST
from .tiles import TILE, TileLists

SURFACE_ALPHA = 1 / 4
"""A Gaussian's surface is where its alpha is this."""

_LOG_SURFACE_ALPHA = np.float32(np.log(SURFACE_ALPHA))


def nearest_surfaces(
    shapes: Float32[np.ndarray, "m 8"], colors: Float32[np.ndarray, "m 4"], tiles: TileLists
) -> Float32[np.ndarray, "h w 4"]:
    """Colour each pixel as the nearest splat whose alpha there is at least `SURFACE_ALPHA`, with an alpha of 1.

    Shaded like a ball: full colour in the middle, half of it at the rim. `shapes` and `colors` as in `Splats`.
    """
    rgba = np.empty((tiles.height, tiles.width, 4), np.float32)
    _cover(shapes, colors, tiles.starts, tiles.members, tiles.columns, rgba)
    return rgba


@numba.njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _cover(shapes, colors, starts, members, columns, rgba):
    height, width = rgba.shape[:2]
    for tile in numba.prange(len(starts) - 1):
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        # A column's lines of TILE numbers: 1 while nothing covers the pixel, three channels.
        state = np.zeros((TILE, 4 * TILE), np.float32)
        state[: width - x0, : min(TILE, height - y0)] = 1
        for k in range(starts[tile], starts[tile + 1]):
            if (k - starts[tile]) % BATCH == 0 and is_finished(state):
                break
            _cover_pixels(shapes[members[k]], colors[members[k]], np.float32(x0 + 0.5), np.float32(y0 + 0.5), state)
        for v in range(min(TILE, height - y0)):
            for u in range(min(TILE, width - x0)):
                for channel in range(3):
                    rgba[y0 + v, x0 + u, channel] = state[u, (1 + channel) * TILE + v]
                rgba[y0 + v, x0 + u, 3] = 1 - state[u, v]


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _cover_pixels(shape, color, x0, y0, state):
    by_height = 1 / (shape[5] - _LOG_SURFACE_ALPHA)
    left, right = columns_of(shape, x0)
    for u in range(left, right):
        dx = np.float32(u) + (x0 - shape[0])
        fall = shape[3] * dx * dx
        start = y0 - (shape[1] + shape[2] * dx)
        line = state[u]
        for v in range(TILE):
            dy = start + np.float32(v)
            power = shape[4] * dy * dy + fall
            is_hit = line[v] > 0 and shape[5] + power >= _LOG_SURFACE_ALPHA
            shade = np.float32(0.5) + np.float32(0.5) * np.sqrt(max(1 + power * by_height, np.float32(0)))
            line[v] = np.float32(0) if is_hit else line[v]
            for channel in range(3):
                before = line[v + (1 + channel) * TILE]
                line[v + (1 + channel) * TILE] = color[channel] * shade if is_hit else before
