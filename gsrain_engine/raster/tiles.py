"""Which splats touch which tile of the image, nearest first."""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Int32, Int64

TILE = 16
"""Side of a tile in pixels: a row of it is one 512-bit or two 256-bit vectors of float32."""

_CHUNKS = 32
"""Parts of the splat list that are counted and written side by side; the result does not depend on it."""

_MAX_PAIRS = 1 << 30
_SLACK_PX = 1e-2
"""Float32 rounding of an ellipse's edge must never leave out a pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class TileLists:
    """For each tile of an image, row by row, the splats whose ellipse touches it, in the order of the splats."""

    width: int
    height: int
    starts: Int64[np.ndarray, " tiles_and_one"]
    """Where each tile's list starts in `members`; the last entry is its length."""
    members: Int32[np.ndarray, " pairs"]

    @property
    def columns(self) -> int:
        """Tiles side by side."""
        return -(-self.width // TILE)

    @property
    def rows(self) -> int:
        """Tiles one above the other."""
        return -(-self.height // TILE)


def bin_into_tiles(shapes: Float32[np.ndarray, "m 8"], width: int, height: int) -> TileLists:
    """List the splats of each tile; `shapes` as in `Splats`, nearest first.

    The test is exact: a tile is listed if and only if a pixel centre's rectangle of it meets the ellipse on which alpha
    is the splat's cut (the idea of Speedy-Splat, Hanson et al. 2025, row by row).

    Raises:
        MemoryError: When the lists would hold more than 2^30 entries.
    """
    columns, rows = -(-width // TILE), -(-height // TILE)
    counts = np.zeros((_CHUNKS, columns * rows), np.int64)
    _count(shapes, columns, rows, counts)
    by_tile = counts.T.ravel()
    ends = np.cumsum(by_tile)
    pairs = int(ends[-1])
    if pairs > _MAX_PAIRS:
        raise MemoryError(f"{len(shapes)} splats touch {pairs} tiles in all, expected at most {_MAX_PAIRS}")
    places = np.ascontiguousarray((ends - by_tile).reshape(-1, _CHUNKS).T)
    starts = np.append(places[0], pairs)
    members = np.empty(pairs, np.int32)
    _write(shapes, columns, rows, places, members)
    return TileLists(width, height, starts, members)


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _count(shapes, columns, rows, counts):
    size = (len(shapes) + _CHUNKS - 1) // _CHUNKS
    for chunk in numba.prange(_CHUNKS):
        tally = counts[chunk]
        for n in range(chunk * size, min(len(shapes), (chunk + 1) * size)):
            top, bottom = _tile_rows(shapes[n], rows)
            for row in range(top, bottom):
                left, right = _tile_columns(shapes[n], row, columns)
                for tile in range(row * columns + left, row * columns + right):
                    tally[tile] += 1


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _write(shapes, columns, rows, places, members):
    size = (len(shapes) + _CHUNKS - 1) // _CHUNKS
    for chunk in numba.prange(_CHUNKS):
        place = places[chunk]
        for n in range(chunk * size, min(len(shapes), (chunk + 1) * size)):
            top, bottom = _tile_rows(shapes[n], rows)
            for row in range(top, bottom):
                left, right = _tile_columns(shapes[n], row, columns)
                for tile in range(row * columns + left, row * columns + right):
                    members[place[tile]] = n
                    place[tile] += 1


@numba.njit(error_model="numpy")
@no_type_check
def _tiles_between(low, high, count):
    """First and past-the-last of `count` tiles with a pixel centre in [low, high] px, clamped before it becomes int."""
    first = np.ceil((low - (TILE - 0.5) - _SLACK_PX) / TILE)
    last = np.floor((high - 0.5 + _SLACK_PX) / TILE)
    return int(min(max(first, 0.0), count)), int(min(max(last + 1, 0.0), count))


@numba.njit(error_model="numpy")
@no_type_check
def _tile_rows(shape, rows):
    return _tiles_between(shape[1] - shape[7], shape[1] + shape[7], rows)


@numba.njit(error_model="numpy")
@no_type_check
def _tile_columns(shape, row, columns):
    """Tiles of one row that the ellipse touches: its extent in x within the band of the row's pixel centres."""
    x, shear, sharpness_x, sharpness_y = np.float64(shape[0]), shape[2], np.float64(shape[3]), shape[4]
    depth = np.float64(shape[5]) - shape[6]  # ln(alpha / cut) at the centre
    reach = np.float64(shape[7])
    top = min(max(row * TILE + 0.5 - _SLACK_PX - shape[1], -reach), reach)
    bottom = max(min((row + 1) * TILE - 0.5 + _SLACK_PX - shape[1], reach), -reach)
    # The ellipse's rightmost point: cov_xy / sqrt(cov_xx) times its extent; its leftmost is opposite.
    cov_yy = -0.5 / sharpness_y
    cov_xx = -0.5 / sharpness_x + shear * shear * cov_yy
    turn = np.sqrt(2 * depth / cov_xx) * shear * cov_yy
    at_right, at_left = min(max(turn, top), bottom), min(max(-turn, top), bottom)
    right = x + shear * at_right + np.sqrt(max(depth + sharpness_y * at_right * at_right, 0.0) / -sharpness_x)
    left = x + shear * at_left - np.sqrt(max(depth + sharpness_y * at_left * at_left, 0.0) / -sharpness_x)
    return _tiles_between(left, right, columns)
