"""Tiles of the image: the splats that touch each, nearest first, and the walks over tiles, splats and pixels."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Int32, Int64
from numba.cpython.unsafe.numbers import trailing_zeros

from ...fast_math import FAST, ROOT, exponential_of_root, stack_lines
from ...kernels import kernel, range_of
from .splats import MIN_SCENE_CUT

TILE = 16  # side of a tile in pixels: a column of it is one 512-bit or two 256-bit vectors of float32
BATCH = 32  # splats gathered from memory before they are processed, so that their cache misses overlap; bits of _BITS
_CHUNKS = 32  # parts of the splat list that are processed in parallel; the result does not depend on it
_MAX_PAIRS = 1 << 30
_BITS = np.dtype(np.uint32)
_SIDE_SHIFT = 3
_SIDE = 1 << _SIDE_SHIFT  # maximum side, in tiles, of a splat's box whose tiles have a bit each
_SLACK_PX = 1e-2  # margin for float32 rounding, so that an ellipse's edge never loses a pixel


class TileLists(NamedTuple):
    """For each tile of an image, row by row, the splats whose ellipse touches it, nearest first."""

    width: int
    height: int
    starts: Int64[np.ndarray, " tiles_and_one"]
    """Start of each tile's list in `members`; the last entry is the total length."""
    members: Int32[np.ndarray, " pairs"]

    @property
    def columns(self) -> int:
        return -(-self.width // TILE)


def bin_into_tiles(
    shapes: Float32[np.ndarray, "m 8"], order: Int32[np.ndarray, " drawn"], width: int, height: int
) -> TileLists:
    """List the splats of each tile in a given order; `shapes` as in `Splats`.

    The test is exact: a tile is listed if and only if the rectangle of its pixel centers meets the ellipse on which
    alpha is the splat's cut (the idea of Speedy-Splat, Hanson et al. 2025, column by column).

    Raises:
        MemoryError: When the lists would hold more than 2^30 entries.
    """
    columns, rows = -(-width // TILE), -(-height // TILE)
    counts = np.zeros((_CHUNKS, columns * rows), np.int64)
    corners, masks = np.empty(len(order), np.int32), np.empty(len(order), np.uint64)
    _count(shapes, order, columns, rows, counts, corners, masks)
    by_tile = counts.T.ravel()
    ends = np.cumsum(by_tile)
    pairs = int(ends[-1])
    if pairs > _MAX_PAIRS:
        raise MemoryError(f"{len(order)} splats touch {pairs} tiles in all, expected at most {_MAX_PAIRS}")
    places = np.ascontiguousarray((ends - by_tile).reshape(-1, _CHUNKS).T)
    starts = np.append(places[0], pairs)
    members = np.empty(pairs, np.int32)
    _write(shapes, order, columns, rows, corners, masks, places, members)
    return TileLists(width, height, starts, members)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _count(portion, shapes, order, columns, rows, counts, corners, masks):
    """Count each tile's splats. For each splat store the first tile of the box around it, and a mask of touched ones.

    The mask has _SIDE bits for each column of the box. If that has more columns or rows, the first tile is stored as
    -1. Each chunk of the splats has its own counts, since chunks are processed in parallel.
    """
    size = (len(order) + _CHUNKS - 1) // _CHUNKS
    for chunk in range_of(portion, _CHUNKS):
        count = counts[chunk]
        # A line for each number of a batch's ellipses, so that LLVM vectorizes the loop over its splats, which has no
        # branches; those of the loop over tiles are mispredicted too often for the processor to overlap divisions.
        near, ellipses, boxes = np.ones((8, BATCH), np.float32), np.empty((8, BATCH)), np.empty((5, BATCH))
        bits = np.empty((2, BATCH), np.uint64)  # of the first two columns, more than most splats have
        for first in range(chunk * size, min(len(order), (chunk + 1) * size), BATCH):
            last = min(first + BATCH, len(order), (chunk + 1) * size)
            for k in range(first, last):
                n = order[k]
                for i in range(8):
                    near[i, k - first] = shapes[n, i]
            for j in range(BATCH):
                ellipse = _ellipse(_column(near, j))
                box = _box(ellipse, columns, rows)
                bits[0, j] = _bits_of_column(ellipse, box, box[0], rows)
                bits[1, j] = _bits_of_column(ellipse, box, box[0] + 1, rows)
                x, y, reach_x, reach_y, shear, variance, depth, turn = ellipse
                ellipses[0, j], ellipses[1, j], ellipses[2, j], ellipses[3, j] = x, y, reach_x, reach_y
                ellipses[4, j], ellipses[5, j], ellipses[6, j], ellipses[7, j] = shear, variance, depth, turn
                left, right, top, bottom, is_exact = box
                boxes[0, j], boxes[1, j], boxes[2, j], boxes[3, j] = left, right, top, bottom
                boxes[4, j] = 1.0 if is_exact else 0.0
            for k in range(first, last):
                j = k - first
                left, right, top, bottom = int(boxes[0, j]), int(boxes[1, j]), int(boxes[2, j]), int(boxes[3, j])
                corner, mask = top * columns + left, np.uint64(0)
                if right - left <= _SIDE and bottom - top <= _SIDE:
                    mask = bits[0, j] | bits[1, j] << np.uint64(_SIDE)
                    for column in range(left + 2, right):
                        box = boxes[0, j], boxes[1, j], boxes[2, j], boxes[3, j], boxes[4, j] > 0
                        more = _bits_of_column(_column(ellipses, j), box, np.float64(column), rows)
                        mask |= more << np.uint64(_SIDE * (column - left))
                    bits_left = mask
                    while bits_left != 0:
                        count[corner + _tile_of_bit(bits_left, columns)] += 1
                        bits_left &= bits_left - np.uint64(1)
                else:
                    corner = -1
                    for column in range(left, right):
                        highest, lowest = _rows_of_column(_column(ellipses, j), column, rows)
                        for row in range(int(highest), int(lowest)):
                            count[row * columns + column] += 1
                corners[k], masks[k] = corner, mask


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _write(portion, shapes, order, columns, rows, corners, masks, places, members):
    """Write each splat to the places of the tiles that it touches, and advance those by one."""
    size = (len(order) + _CHUNKS - 1) // _CHUNKS
    for chunk in range_of(portion, _CHUNKS):
        place = places[chunk]
        for k in range(chunk * size, min(len(order), (chunk + 1) * size)):
            mask, corner, n = masks[k], corners[k], order[k]
            if corner >= 0:
                while mask != 0:
                    tile = corner + _tile_of_bit(mask, columns)
                    members[place[tile]] = n
                    place[tile] += 1
                    mask &= mask - np.uint64(1)
            else:
                ellipse = _ellipse(shapes[n])
                left, right, _, _, _ = _box(ellipse, columns, rows)
                for column in range(int(left), int(right)):
                    highest, lowest = _rows_of_column(ellipse, column, rows)
                    for row in range(int(highest), int(lowest)):
                        tile = row * columns + column
                        members[place[tile]] = n
                        place[tile] += 1


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _tile_of_bit(mask, columns):
    """Offset, from the first tile of a box, of the tile of a mask's lowest bit."""
    bit = np.int64(trailing_zeros(mask))
    return (bit & (_SIDE - 1)) * columns + (bit >> _SIDE_SHIFT)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _bits_of_column(ellipse, box, column, rows):
    """Bits of the rows of tiles that the ellipse touches in one column, from the top of its box; none beyond that."""
    _, right, top, bottom, is_exact = box
    highest, lowest = _rows_of_column(ellipse, column, rows)
    highest = top if is_exact else max(highest, top)
    lowest = bottom if is_exact else min(lowest, bottom)
    count = lowest - highest if column < right else 0.0
    above = np.int32(min(max(0.0, highest - top), np.float64(_SIDE)))
    ones = (np.uint64(1) << np.uint64(np.int32(min(max(0.0, count), np.float64(_SIDE))))) - np.uint64(1)
    return ones << np.uint64(above)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _column(lines, j):
    """Column j of eight lines of numbers."""
    return (lines[0, j], lines[1, j], lines[2, j], lines[3, j], lines[4, j], lines[5, j], lines[6, j], lines[7, j])


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _ellipse(shape):
    """Ellipse at the alpha cut: center, reach in x and y, shear, and parameters of each column's extent; float64."""
    shear, cov_xx, variance = np.float64(shape[2]), -0.5 / np.float64(shape[3]), -0.5 / np.float64(shape[4])
    depth = np.float64(shape[5]) - shape[6]  # ln(alpha / cut) at the center
    cov_yy = variance + shear * shear * cov_xx
    reach_y = np.sqrt(2 * depth * cov_yy)
    # Horizontal offset of the lowest point from the center; the highest is opposite.
    turn = reach_y * shear * cov_xx / cov_yy
    return np.float64(shape[0]), np.float64(shape[1]), np.float64(shape[7]), reach_y, shear, variance, depth, turn


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _box(ellipse, columns, rows):
    """First and past-the-last tile in x and y, and whether all in between are certainly touched.

    They are if the ellipse lies within the pixel centers of one row or one column of tiles.
    """
    x, y, reach_x, reach_y = ellipse[:4]
    left, right = _tiles_between(x - reach_x, x + reach_x, columns)
    top, bottom = _tiles_between(y - reach_y, y + reach_y, rows)
    # By `&` and `|`, without branches.
    in_column = (x - reach_x >= left * TILE + 0.5) & (x + reach_x <= (left + 1) * TILE - 0.5) & (right - left == 1)
    in_row = (y - reach_y >= top * TILE + 0.5) & (y + reach_y <= (top + 1) * TILE - 0.5) & (bottom - top == 1)
    return left, right, top, bottom, in_column | in_row


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _tiles_between(low, high, count):
    """First and past-the-last of `count` tiles with a pixel center in [low, high] px, clamped before it becomes int."""
    first = np.ceil((low - (TILE - 0.5) - _SLACK_PX) / TILE)
    last = np.floor((high - 0.5 + _SLACK_PX) / TILE)
    return min(max(0.0, first), np.float64(count)), min(max(0.0, last + 1), np.float64(count))


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _rows_of_column(ellipse, column, rows):
    """Tiles of one column that the ellipse touches: its extent in y within the band of the column's pixel centers."""
    x, y, reach, _, shear, variance, depth, turn = ellipse
    left = min(max(column * TILE + 0.5 - _SLACK_PX - x, -reach), reach)
    right = max(min((column + 1) * TILE - 0.5 + _SLACK_PX - x, reach), -reach)
    at_bottom, at_top = min(max(turn, left), right), min(max(-turn, left), right)
    fall = depth / (reach * reach)
    bottom = y + shear * at_bottom + np.sqrt(2 * variance * max(depth - fall * at_bottom * at_bottom, 0.0))
    top = y + shear * at_top - np.sqrt(2 * variance * max(depth - fall * at_top * at_top, 0.0))
    return _tiles_between(top, bottom, rows)


# Walk over tiles, splats and pixels
# Numba inlines these functions, and those passed to them, into each kernel, in the precision of `shapes`. A function
# that is not inlined costs 30 ns for counting the references of its arrays, as much as a small splat. They write to
# `data[0]`, never to a name that the tuple is unpacked into: Numba takes those writes for dead code.

MAX_ALPHA = 0.999  # maximum alpha of a fragment, as in the reference rasterizer

MIN_TRANSMITTANCE = 1e-4
"""Transmittance below which a pixel is finished.

3DGS (Kerbl et al. 2023) stops before the splat that falls below it, which loses up to a tenth of a pixel at once: a
drop that hardly dims a pixel could switch such a splat off. Here that splat is blended, so the loss never exceeds this
value.
"""


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def walk_tiles(portion, tiles, shapes, channels, lines, sums, enter, visit, leave, data):
    """Walk over all tiles in parallel, and over the splats of each, nearest first, until all its pixels are finished.

    The tile's `state` has one row for each column of pixels, with `lines` lines of TILE numbers: the transmittance, 1
    at first and 0 once finished or outside the image, then whatever the kernel needs, 0 at first. `lanes` has one
    number for each row of pixels and each of `sums`, for sums over a splat's pixels. `data` belongs to the kernel.

    The kernel's functions are called as enter(state, x0, y0, data) before a tile's splats, (x0, y0) being its first
    pixel; as visit(shapes, channels, j, x, y, state, lanes, k, data) for each splat, (x, y) being the center of the
    first pixel; and leave, like enter, last. `shapes` and `channels` hold a batch of splats in `visit`, of which it is
    row j; an array of all splats goes into `data`, and its row is `members[k]`.
    """
    width, height, starts, members = tiles
    real = shapes.dtype.type
    columns, rows = (width + TILE - 1) // TILE, (height + TILE - 1) // TILE
    for place in range_of(portion, columns * rows):
        # Column by column, so that each thread has sky and road.
        tile = place % rows * columns + place // rows
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        state = np.zeros((TILE, lines * TILE), shapes.dtype)
        state[: width - x0, : min(TILE, height - y0)] = 1
        enter(state, x0, y0, data)
        lanes = np.empty(sums * TILE, shapes.dtype)
        near_shapes = np.empty((BATCH, 8), shapes.dtype)
        near_channels = np.empty((BATCH, channels.shape[1]), shapes.dtype)
        for first in range(starts[tile], starts[tile + 1], BATCH):
            if is_finished(state):
                break
            batch = members[first : min(first + BATCH, starts[tile + 1])]
            gather_rows(shapes, batch, near_shapes)
            gather_rows(channels, batch, near_channels)
            for j in range(len(batch)):
                visit(near_shapes, near_channels, j, real(x0 + 0.5), real(y0 + 0.5), state, lanes, first + j, data)
        leave(state, x0, y0, data)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def walk_columns(portion, tiles, shapes, channels, lines, enter, visit, leave, data):
    """Walk over tiles as `walk_tiles` does, and in each batch of splats over the columns of pixels, then the splats.

    So the lines of a column are held in registers while all splats of a batch are blended into it. That takes 0.7 of
    the time, for kernels that need no sums over a splat's pixels. Each pixel meets the same splats in the same order.
    `visit` is called as visit(line, falloff, channels, j, data) for each splat and column; `walk_rows` takes `line` and
    `falloff`, and row j of `channels` is the splat's. `lines` is a number or a constant's name, since a sum has no
    constant type for Numba.
    """
    width, height, starts, members = tiles
    real = shapes.dtype.type
    share = real(1 / ROOT)
    columns, rows = (width + TILE - 1) // TILE, (height + TILE - 1) // TILE
    for place in range_of(portion, columns * rows):
        # Column by column, so that each thread has sky and road.
        tile = place % rows * columns + place // rows
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        x, y = real(x0 + 0.5), real(y0 + 0.5)
        state = np.zeros((TILE, lines * TILE), shapes.dtype)
        state[: width - x0, : min(TILE, height - y0)] = 1
        enter(state, x0, y0, data)
        near, near_channels = stack_lines(BATCH, 8, shapes.dtype), np.empty((BATCH, channels.shape[1]), shapes.dtype)
        # Of each splat and column, the place of the splat's line, and the logarithm of alpha on it.
        at, logs = stack_lines(BATCH, TILE, shapes.dtype), stack_lines(BATCH, TILE, shapes.dtype)
        reached = stack_lines(1, TILE, _BITS)  # of each column, one bit for each splat that reaches it
        for first in range(starts[tile], starts[tile + 1], BATCH):
            if is_finished(state):
                break
            last = min(first + BATCH, starts[tile + 1])
            for j in range(last - first):
                n = members[first + j]
                for i in range(8):
                    near[8 * j + i] = shapes[n, i]
                for i in range(3, 7):
                    near[8 * j + i] *= share
                for c in range(4):
                    near_channels[j, c] = channels[n, c]
                for c in range(4, channels.shape[1]):
                    near_channels[j, c] = channels[n, c]
            for u in range(TILE):
                reached[u] = 0
            for j in range(last - first):
                left, right = _reached(near[8 * j], near[8 * j + 7], x)
                bit = np.uint32(1) << np.uint32(j)
                center_x, center_y, shear = near[8 * j], near[8 * j + 1], near[8 * j + 2]
                sharpness, log_opacity = near[8 * j + 3], near[8 * j + 5]
                for u in range(TILE):
                    dx = real(u) + (x - center_x)
                    at[j * TILE + u] = y - (center_y + shear * dx)
                    logs[j * TILE + u] = log_opacity + sharpness * dx * dx
                    reached[u] |= bit if (real(u) >= left) & (real(u) <= right) else np.uint32(0)
            for u in range(TILE):
                if reached[u] != 0:
                    _walk_column(at, logs, near, near_channels, reached[u], u, state, lines, visit, data)
        leave(state, x0, y0, data)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _walk_column(at, logs, near, channels, reached, u, state, lines, visit, data):
    """Walk over the splats that reach column u, of which each has a bit."""
    line = stack_lines(lines, TILE, state.dtype)
    for i in range(lines * TILE):
        line[i] = state[u, i]
    while reached != 0:
        j = np.int64(trailing_zeros(reached))
        reached &= reached - np.uint32(1)
        visit(line, (at[j * TILE + u], near[8 * j + 4], logs[j * TILE + u], near[8 * j + 6]), channels, j, data)
    for i in range(lines * TILE):
        state[u, i] = line[i]


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def walk_rows(line, falloff, visit, numbers):
    """Walk over the pixels of a column: visit(line, v, alpha, numbers), with `falloff` of `walk_columns`."""
    real = line.dtype.type
    start, sharpness, log_alpha_on_line, log_cut = falloff
    for v in range(TILE):
        dy = start + real(v)
        x = sharpness * dy * dy + log_alpha_on_line
        visit(line, v, alpha_of_root(line, x, log_cut), numbers)


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def is_rain(falloff):
    """Return whether a splat is of rain, with `falloff` of `walk_columns`."""
    return falloff[3] < MIN_SCENE_CUT * np.float32(1 / ROOT)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def walk_pixels(shape, x, y, state, lanes, visit, data):
    """Walk over the pixels of a tile in the columns that a splat reaches; `visit` as in `walk_column`."""
    left, right = columns_of(shape, x)
    # Scalars, for LLVM would load an array's numbers again for each column: writing to the state might change them.
    numbers = (shape[0], shape[1], shape[2], shape[3], shape[4], shape[5], shape[6])
    for u in range(left, right):
        walk_column(numbers, u, x, y, state[u], lanes, visit, data)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def walk_column(shape, u, x, y, line, lanes, visit, data):
    """Walk over the pixels of column u of a tile; `line` is its row of the state, (x, y) the center of the first pixel.

    `visit` is called as visit(line, v, dx, dy, falloff, lanes, data) for each row v. (dx, dy) is the pixel's offset
    from the splat's center and line, the brackets in `Splats`; `log_alpha` takes both and `falloff`.
    """
    real = line.dtype.type
    falloff = shape[3], shape[4], shape[5], shape[6]
    dx = real(u) + (x - shape[0])
    start = y - (shape[1] + shape[2] * dx)
    for v in range(TILE):
        visit(line, v, dx, start + real(v), falloff, lanes, data)


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def nothing(state, x0, y0, data):
    """Leave a tile's state as it is."""


@numba.njit(inline="always")
@no_type_check
def gather_rows(rows, members, near):
    """Copy scattered rows next to each other before they are processed, so that cache misses overlap."""
    for j in range(len(members)):
        for i in range(near.shape[1]):
            near[j, i] = rows[members[j], i]


@numba.njit(inline="always")
@no_type_check
def is_finished(state):
    """Return whether all pixels of a tile are finished."""
    for u in range(TILE):
        line = state[u]
        largest = state.dtype.type(0)
        for v in range(TILE):
            largest = max(largest, line[v])
        if largest > 0:
            return False
    return True


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def columns_of(shape, x):
    """First and past-the-last column of a tile that a splat reaches; x is the center of the tile's first pixel."""
    low, high = _reached(shape[0], shape[7], x)
    return int(max(np.float32(0), low)), int(min(np.float32(TILE - 1), high)) + 1


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _reached(center, reach, x):
    """First and last column, unbounded, within `reach` of a center; x is the center of the tile's first pixel."""
    return np.ceil(center - reach - x - np.float32(0.01)), np.floor(center + reach - x + np.float32(0.01))


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def log_alpha(dx, dy, falloff):
    """Logarithm of a fragment's alpha, before its cut (see `Splats`)."""
    sharpness_x, sharpness_y, log_opacity, _ = falloff
    return sharpness_y * dy * dy + (log_opacity + sharpness_x * dx * dx)


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def alpha_at(line, dx, dy, falloff):
    """Alpha of a fragment in the precision of `line`; 0 below the cut."""
    real = line.dtype.type
    sharpness_x, sharpness_y, log_opacity, log_cut = falloff
    # LLVM scales these once a splat, and exactly, by a power of two. Alphas of any number are below the cut.
    share = real(1 / ROOT)
    x = log_alpha(dx, dy, (sharpness_x * share, sharpness_y * share, log_opacity * share, log_cut * share))
    return alpha_of_root(line, x, log_cut * share)


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def alpha_of_root(line, x, cut):
    """Alpha whose logarithm is ROOT x, in the precision of `line`; 0 if x is below the cut."""
    real = line.dtype.type
    alpha = exponential_of_root(x)
    alpha = alpha if alpha < real(MAX_ALPHA) else real(MAX_ALPHA)
    return alpha if x >= cut else real(0)


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def absorb(line, v, alpha):
    """Take a fragment's light from the transmittance of pixel v of a column; returns it, the blending weight."""
    real = line.dtype.type
    weight = line[v] * alpha
    after = line[v] - weight
    line[v] = after if after >= real(MIN_TRANSMITTANCE) else real(0)
    return weight
