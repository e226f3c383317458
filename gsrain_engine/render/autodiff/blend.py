"""Differentiable blending of tiled splats to color, alpha and depth in float32 or float64, and its backward pass."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float

from ...fast_math import FAST
from ...kernels import kernel
from ..cpu.compositing import add_lanes, add_pairs, composite
from ..cpu.tiles import MAX_ALPHA, TILE, TileLists, absorb, alpha_at, nothing, walk_pixels, walk_tiles

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
    rgba, depth = composite(shapes, channels, tiles)
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
    _blend_backward(tiles, shapes, channels, (*picture, *gradient, by_pair))
    return add_pairs(tiles.members, by_pair, len(shapes))


# Lines of a tile's column: transmittance, gradient by three colors, depth and alpha, and the remaining part of the
# pixel's result times its gradient.


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _blend_backward(portion, tiles, shapes, channels, data):
    walk_tiles(portion, tiles, shapes, channels, 7, _SUMS, _load, _sum_splat, nothing, data)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _load(state, x0, y0, data):
    color, alpha, depth, by_color, by_alpha, by_depth, _ = data
    height, width = alpha.shape
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


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _sum_splat(shapes, channels, j, x, y, state, lanes, k, data):
    lanes[:] = 0
    walk_pixels(
        shapes[j], x, y, state, lanes, _sum_pixel, (channels[j, 0], channels[j, 1], channels[j, 2], channels[j, 3])
    )
    add_lanes(lanes, _SUMS, data[6][k])


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _sum_pixel(line, v, dx, dy, falloff, lanes, channels):
    """Accumulate over the same pixels with the same weights as blending; one lane per row of the tile."""
    real = line.dtype.type
    red, green, blue, far = channels
    alpha = alpha_at(line, dx, dy, falloff)
    before = line[v]
    weight = absorb(line, v, alpha)
    by_red, by_green, by_blue = line[v + TILE], line[v + 2 * TILE], line[v + 3 * TILE]
    by_far = line[v + 4 * TILE]
    share = weight * (red * by_red + green * by_green + blue * by_blue + far * by_far + line[v + 5 * TILE])
    rest = line[v + 6 * TILE] - share
    line[v + 6 * TILE] = rest
    q = share - rest * (alpha / (real(1) - alpha))
    # Clamped alpha has no gradient, and a finished pixel's rest is rounding error.
    q = q if alpha < real(MAX_ALPHA) else real(0)
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
