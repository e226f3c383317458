"""Tile lists: the splats that touch each tile of the image, nearest first."""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Int32, Int64

TILE = 16  # side of a tile in pixels: a column of it is one 512-bit or two 256-bit vectors of float32
BATCH = 32  # splats gathered from memory before they are processed, so that their cache misses overlap
_CHUNKS = 32  # parts of the splat list that are processed in parallel; the result does not depend on it
_MAX_PAIRS = 1 << 30
_SLACK_PX = 1e-2  # margin for float32 rounding, so that an ellipse's edge never loses a pixel


@dataclass(frozen=True, slots=True, eq=False)
class TileLists:
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
    boxes, masks = np.empty((len(order), 4), np.int16), np.empty(len(order), np.uint64)
    _count(shapes, order, columns, rows, counts, boxes, masks)
    by_tile = counts.T.ravel()
    ends = np.cumsum(by_tile)
    pairs = int(ends[-1])
    if pairs > _MAX_PAIRS:
        raise MemoryError(f"{len(order)} splats touch {pairs} tiles in all, expected at most {_MAX_PAIRS}")
    places = np.ascontiguousarray((ends - by_tile).reshape(-1, _CHUNKS).T)
    starts = np.append(places[0], pairs)
    members = np.empty(pairs, np.int32)
    _write(shapes, order, columns, rows, boxes, masks, places, members)
    return TileLists(width, height, starts, members)


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _count(shapes, order, columns, rows, counts, boxes, masks):
    """Count each tile's splats. For each splat store the box of tiles around it, and a mask of the touched ones.

    The mask has one bit per tile, column by column; it is 0 if the box has more than 64. Each chunk of the splats has
    its own counts, since chunks are processed in parallel.
    """
    size = (len(order) + _CHUNKS - 1) // _CHUNKS
    for chunk in numba.prange(_CHUNKS):
        count = counts[chunk]
        near_shapes = np.empty((BATCH, 8), np.float32)
        for first in range(chunk * size, min(len(order), (chunk + 1) * size), BATCH):
            last = min(first + BATCH, len(order), (chunk + 1) * size)
            for k in range(first, last):
                for i in range(8):
                    near_shapes[k - first, i] = shapes[order[k], i]
            for k in range(first, last):
                ellipse = _ellipse(near_shapes[k - first])
                left, right, top, bottom, is_exact = _box(ellipse, columns, rows)
                boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3] = left, right, top, bottom
                has_bits = (right - left) * (bottom - top) <= 64
                bit, mask = 0, np.uint64(0)
                for column in range(left, right):
                    highest, lowest = (top, bottom) if is_exact else _rows_of_column(ellipse, column, rows)
                    for row in range(highest, lowest):
                        count[row * columns + column] += 1
                        if has_bits:
                            mask |= np.uint64(1) << np.uint64(bit + row - top)
                    bit += bottom - top
                masks[k] = mask


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _write(shapes, order, columns, rows, boxes, masks, places, members):
    """Write each splat to the places of the tiles that it touches, and advance those by one."""
    size = (len(order) + _CHUNKS - 1) // _CHUNKS
    for chunk in numba.prange(_CHUNKS):
        place = places[chunk]
        for k in range(chunk * size, min(len(order), (chunk + 1) * size)):
            left, right, top, bottom = boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3]
            mask = masks[k]
            if mask != 0:
                for column in range(left, right):
                    for row in range(top, bottom):
                        if mask & np.uint64(1):
                            tile = row * columns + column
                            members[place[tile]] = order[k]
                            place[tile] += 1
                        mask >>= np.uint64(1)
            else:
                ellipse = _ellipse(shapes[order[k]])
                for column in range(left, right):
                    highest, lowest = _rows_of_column(ellipse, column, rows)
                    for row in range(highest, lowest):
                        tile = row * columns + column
                        members[place[tile]] = order[k]
                        place[tile] += 1


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
    in_column = x - reach_x >= left * TILE + 0.5 and x + reach_x <= (left + 1) * TILE - 0.5
    in_row = y - reach_y >= top * TILE + 0.5 and y + reach_y <= (top + 1) * TILE - 0.5
    return left, right, top, bottom, (right - left == 1 and in_column) or (bottom - top == 1 and in_row)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _tiles_between(low, high, count):
    """First and past-the-last of `count` tiles with a pixel center in [low, high] px, clamped before it becomes int."""
    first = np.ceil((low - (TILE - 0.5) - _SLACK_PX) / TILE)
    last = np.floor((high - 0.5 + _SLACK_PX) / TILE)
    return int(min(max(first, 0.0), count)), int(min(max(last + 1, 0.0), count))


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
