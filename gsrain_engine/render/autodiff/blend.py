"""Differentiable blending of tiled splats to color, alpha and depth in float32 or float64, and its backward pass."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float

from ..cpu import compositing
from ..cpu.compositing import absorb, add_lanes, alpha_of, column_of, columns_of, gather_rows, is_finished, tile_at
from ..cpu.fast_math import FAST
from ..cpu.tiles import BATCH, TILE, TileLists

_SUMS = 10


class BlendedImage(NamedTuple):
    """Blended image, or a loss's gradient with respect to it."""

    color: Float[np.ndarray, "h w 3"]
    """Display color, premultiplied over nothing."""
    alpha: Float[np.ndarray, "h w"]
    depth: Float[np.ndarray, "h w"]
    """Sum of view depths (m) times weights."""


def blend(shapes: Float[np.ndarray, "n 8"], channels: Float[np.ndarray, "n 4"], tiles: TileLists) -> BlendedImage:
    """Blend color and depth of the splats (three channels and one) over nothing, in the precision of `shapes`."""
    rgba, depth = compositing.composite(shapes, channels, tiles)
    color = np.stack([rgba[..., channel] for channel in range(3)], axis=-1)  # faster than a copy of the slice
    return BlendedImage(color, np.ascontiguousarray(rgba[..., 3]), depth)


def blend_backward(
    shapes: Float[np.ndarray, "n 8"],
    channels: Float[np.ndarray, "n 4"],
    tiles: TileLists,
    picture: BlendedImage,
    gradient: BlendedImage,
) -> Float[np.ndarray, "n 10"]:
    """Sum the gradients for each splat over the pixels that it covers.

    `picture` is the result of `blend`, `gradient` the loss's derivative with respect to it. With w a fragment's weight,
    G the gradient at its pixel and q the loss's derivative with respect to ln alpha, the columns are the sums of
        w G_red, w G_green, w G_blue, w G_depth, q, q dx, q dx^2, q e, q e dx, q e^2
    with dx and e = v - y - shear * dx as in `Splats`. The order is front to back as in blending: the contribution
    behind a fragment is the pixel's result minus the part blended so far, so that q = w (c G) - behind alpha / (1 -
    alpha) needs only the stored image. A splat's sums are taken per tile, then added in tile order: byte-identical at
    any thread count.
    """
    by_pair = np.zeros((len(tiles.members), _SUMS), shapes.dtype)
    _gather_tiles(shapes, channels, tiles.starts, tiles.members, tiles.columns, *picture, *gradient, by_pair)
    return compositing.add_pairs(tiles.members, by_pair, len(shapes))


@numba.njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _gather_tiles(
    shapes, channels, starts, members, columns, color, alpha, depth, by_color, by_alpha, by_depth, by_pair
):
    height, width = alpha.shape
    real = shapes.dtype.type
    for place in numba.prange(len(starts) - 1):
        tile, x0, y0 = tile_at(place, starts, columns)
        # A column's lines of TILE numbers: transmittance (0 once finished), gradient by three colors, depth and alpha,
        # and the remaining part of the pixel's result times its gradient.
        state = np.zeros((TILE, 7 * TILE), shapes.dtype)
        state[: width - x0, : min(TILE, height - y0)] = 1
        for v in range(min(TILE, height - y0)):
            for u in range(min(TILE, width - x0)):
                y, x = y0 + v, x0 + u
                rest = depth[y, x] * by_depth[y, x] + alpha[y, x] * by_alpha[y, x]
                for c in range(3):
                    state[u, (c + 1) * TILE + v] = by_color[y, x, c]
                    rest += color[y, x, c] * by_color[y, x, c]
                state[u, 4 * TILE + v] = by_depth[y, x]
                state[u, 5 * TILE + v] = by_alpha[y, x]
                state[u, 6 * TILE + v] = rest
        lanes = np.empty(_SUMS * TILE, shapes.dtype)
        near_shapes, near_channels = np.empty((BATCH, 8), shapes.dtype), np.empty((BATCH, 4), shapes.dtype)
        for first in range(starts[tile], starts[tile + 1], BATCH):
            if is_finished(state):
                break
            batch = members[first : min(first + BATCH, starts[tile + 1])]
            gather_rows(shapes, batch, 8, near_shapes)
            gather_rows(channels, batch, 4, near_channels)
            for j in range(len(batch)):
                lanes[:] = 0
                _gather(near_shapes[j], near_channels[j], real(x0 + 0.5), real(y0 + 0.5), state, lanes)
                add_lanes(lanes, _SUMS, by_pair[first + j])


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _gather(shape, channels, x0, y0, state, lanes):
    """Accumulate over the same pixels with the same weights as blending; one lane per row of the tile."""
    real = shape.dtype.type
    red, green, blue, far = channels[0], channels[1], channels[2], channels[3]
    sharpness, log_cut = shape[4], shape[6]
    left, right = columns_of(shape, x0)
    for u in range(left, right):
        dx, peak, start = column_of(shape, u, x0, y0)
        line = state[u]
        for v in range(TILE):
            dy = start + real(v)
            alpha = alpha_of(sharpness * dy * dy + peak, log_cut, real)
            before = line[v]
            weight = absorb(line, v, alpha, real)
            by_red, by_green, by_blue = line[v + TILE], line[v + 2 * TILE], line[v + 3 * TILE]
            by_far = line[v + 4 * TILE]
            share = weight * (red * by_red + green * by_green + blue * by_blue + far * by_far + line[v + 5 * TILE])
            rest = line[v + 6 * TILE] - share
            line[v + 6 * TILE] = rest
            q = share - rest * (alpha / (real(1) - alpha))
            # Clamped alpha has no gradient, and a finished pixel's rest is rounding error.
            q = q if alpha < real(compositing.MAX_ALPHA) else real(0)
            q = q if before > real(0) else real(0)
            across, down = q * dx, q * dy
            lanes[v] += weight * by_red
            lanes[v + TILE] += weight * by_green
            lanes[v + 2 * TILE] += weight * by_blue
            lanes[v + 3 * TILE] += weight * by_far
            lanes[v + 4 * TILE] += q
            lanes[v + 5 * TILE] += across
            lanes[v + 6 * TILE] += across * dx
            lanes[v + 7 * TILE] += down
            lanes[v + 8 * TILE] += down * dx
            lanes[v + 9 * TILE] += down * dy
