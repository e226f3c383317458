"""Differentiable blending of tiled splats to color, alpha and depth in float32 or float64, and its backward pass."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float, Int32
from numba import extending, types

from ..cpu.compositing import BATCH, columns_of, is_finished
from ..cpu.fast_math import FAST, exp_of_negative
from ..cpu.tiles import TILE, TileLists

MAX_ALPHA = 0.999
MIN_TRANSMITTANCE = 1e-4


class BlendedImage(NamedTuple):
    """Blended image, or a loss's gradient with respect to it."""

    color: Float[np.ndarray, "h w 3"]
    """Display color, premultiplied over nothing."""
    alpha: Float[np.ndarray, "h w"]
    depth: Float[np.ndarray, "h w"]
    """Sum of view depths (m) times weights."""


def blend(shapes: Float[np.ndarray, "n 8"], channels: Float[np.ndarray, "n 4"], tiles: TileLists) -> BlendedImage:
    """Blend color and depth of the splats (three channels and one) over nothing, in the precision of `shapes`.

    The weights are those of `compositing.composite`. The output is byte-identical at any thread count.
    """
    h, w, dtype = tiles.height, tiles.width, shapes.dtype
    picture = BlendedImage(np.empty((h, w, 3), dtype), np.empty((h, w), dtype), np.empty((h, w), dtype))
    _blend_tiles(shapes, channels, tiles.starts, tiles.members, tiles.columns, *picture)
    return picture


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def fragment(power, log_cut, most, nothing):
    """Alpha of a fragment from its logarithm: at most `most`, and `nothing` below the cut."""
    alpha = exp_kernel(power)
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
    # A column's lines of TILE numbers: transmittance (0 once finished), three colors, depth, alpha.
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


# Backward pass

SUMS = 10


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
    by_pair = np.zeros((len(tiles.members), SUMS), shapes.dtype)
    _gather_tiles(shapes, channels, tiles.starts, tiles.members, tiles.columns, *picture, *gradient, by_pair)
    return add_pairs(tiles.members, by_pair, len(shapes))


@numba.njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _gather_tiles(
    shapes, channels, starts, members, columns, color, alpha, depth, by_color, by_alpha, by_depth, by_pair
):
    rows = (len(starts) - 1) // columns
    for place in numba.prange(len(starts) - 1):
        # Column by column, as in compositing.
        tile = place % rows * columns + place // rows
        _gather_tile(
            tile, shapes, channels, starts, members, columns, color, alpha, depth, by_color, by_alpha, by_depth, by_pair
        )


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _gather_tile(
    tile, shapes, channels, starts, members, columns, color, alpha, depth, by_color, by_alpha, by_depth, by_pair
):
    height, width = alpha.shape
    real = shapes.dtype.type
    x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
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
    lanes = np.empty(SUMS * TILE, shapes.dtype)
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
            lanes[:] = 0
            _gather(near_shapes[j], near_channels[j], real(x0 + 0.5), real(y0 + 0.5), state, lanes)
            add_lanes(lanes, SUMS, by_pair[first + j])


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _gather(shape, channels, x0, y0, state, lanes):
    """Accumulate over the same pixels with the same weights as blending; one lane per row of the tile."""
    real = state.dtype.type
    most, least, nothing, one = real(MAX_ALPHA), real(MIN_TRANSMITTANCE), real(0), real(1)
    red, green, blue, far = channels[0], channels[1], channels[2], channels[3]
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
            by_red, by_green, by_blue = line[v + TILE], line[v + 2 * TILE], line[v + 3 * TILE]
            by_far = line[v + 4 * TILE]
            share = weight * (red * by_red + green * by_green + blue * by_blue + far * by_far + line[v + 5 * TILE])
            rest = line[v + 6 * TILE] - share
            line[v + 6 * TILE] = rest
            q = share - rest * (alpha / (one - alpha))
            # Clamped alpha has no gradient, and a finished pixel's rest is rounding error.
            q = q if alpha < most else nothing
            q = q if before > nothing else nothing
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


# Backward pass of colors alone


def blend_colors_backward(
    shapes: Float[np.ndarray, "n 8"], tiles: TileLists, gradient: Float[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "n 3"]:
    """Sum w G over the pixels of each splat: the gradient of its color for fixed geometry."""
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


# Deterministic sums


def add_pairs(
    members: Int32[np.ndarray, " pairs"], by_pair: Float[np.ndarray, "pairs c"], count: int
) -> Float[np.ndarray, "{count} c"]:
    """Add the rows of each splat's tiles in the order of the tiles; `members` as in `TileLists`, of `count` splats."""
    sums = np.zeros((count, by_pair.shape[1]), by_pair.dtype)
    _add_pairs(members, by_pair, sums, numba.get_num_threads())
    return sums


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _add_pairs(members, by_pair, sums, shares):
    """Each thread goes through all pairs but owns a range of splats, so that no row is written by two."""
    count = len(sums)
    for share in numba.prange(shares):
        first, last = share * count // shares, (share + 1) * count // shares
        for k in range(len(members)):
            n = members[k]
            if first <= n < last:
                for c in range(by_pair.shape[1]):
                    sums[n, c] += by_pair[k, c]


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST | {"reassoc"})
@no_type_check
def add_lanes(lanes, count, sums):
    """Add up `count` lines of lanes; a constant count lets LLVM vectorize it, always in the same order."""
    for c in range(count):
        total = lanes[c * TILE]
        for v in range(1, TILE):
            total += lanes[c * TILE + v]
        sums[c] = total


# Exponential


@no_type_check
def exp_kernel(x):
    """exp(x) for x <= 0 inside compiled code, in the precision of x; see `exp_of_negative` for float32."""
    return np.exp(x)


@extending.overload(exp_kernel, inline="always")
@no_type_check
def _exponential(x):
    if x == types.float32:
        return lambda x: exp_of_negative(x)  # noqa: PLW0108 - numba wants a function with this one's arguments
    return lambda x: np.exp(x)  # noqa: PLW0108
