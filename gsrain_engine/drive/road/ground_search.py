"""Finds the ground along a recorded drive in the scene itself. World frame, metres."""

import numpy as np
import scipy
from jaxtyping import Float64, Int64

from gsrain_engine.scene.scene import Scene

from .height_grid import HeightGrid
from .recorded_places import BESIDE_M
from .solid_pieces import Reach, solid_pieces

_UNDER_M = 2.5
"""How far beside the drive something lies under it."""
_CELL_M, _MOST_CELLS = 0.5, 1500
"""Cells, and how many there are at most on a side: of a larger scene they are larger."""
_DEEPEST_M, _HIGHEST_M = 4.0, 0.5
"""The rig frame's origin is at most so far above the ground, and so far below."""
_BIN_M = 0.05
_LEAST_M2 = 2.0
"""What lies flat under the drive must cover so much to tell how far below it the ground is."""
_PASSES = ((8.0, 0.8, 4), (4.0, 0.4, 4), (2.0, 0.2, 3), (1.0, 0.12, 2))
"""Smoothing, band around the surface (both in metres), and how often: from the lie of the land to the lane."""
_ABOVE_COUNTS = 0.25
"""Weight of what is over the surface, relative to what is under it: all sorts of things stand on the ground."""
_ENOUGH = 0.05
"""Share of a cell that must be covered for half of what is found in it to be believed."""


def found_ground(
    scene: Scene, drive: Float64[np.ndarray, "n 3"], below_m: float | None, else_m: float
) -> tuple[HeightGrid, float]:
    """Find the ground around a drive, and how far it lies below the rig frame's origin.

    `below_m` is how far, where that is known; `else_m` where nothing lies under the drive. The surface starts parallel
    to the drive and moves, again and again, to the smoothed mean of what lies in a band around it, while smoothing and
    band narrow: so it follows slopes and passes under cars and bushes. Where nothing lies it keeps what was found at
    the larger scales.
    """
    spot = np.array([BESIDE_M, BESIDE_M, 0.0])
    reach = Reach(drive.min(axis=0) - spot - [0, 0, _DEEPEST_M + 2], drive.max(axis=0) + spot + [0, 0, _HIGHEST_M + 2])
    grid = _followed(drive, reach)
    pieces = solid_pieces(scene, reach, _CELL_M)
    if below_m is None:
        below_m = _depth_below(drive, pieces.places, pieces.top_m2, else_m)
    heights = grid.heights_m - below_m
    rows, columns = heights.shape
    place = np.rint((pieces.places[:, :2] - grid.corner_m) / grid.cell_m).astype(np.int64)
    inside = ((place >= 0) & (place < [columns, rows])).all(axis=1)
    cells, z = place[inside, 1] * columns + place[inside, 0], pieces.places[inside, 2]
    share = np.minimum(pieces.top_m2[inside] / grid.cell_m**2, 1.0)
    level = heights.ravel()
    for scale_m, band_m, times in _PASSES:
        for _ in range(times):
            above = z - level[cells]
            weight = share * np.exp(-0.5 * (above / band_m) ** 2) * np.where(above > 0.5 * band_m, _ABOVE_COUNTS, 1.0)
            moved, known = (
                _smoothed(_summed(cells, each, (rows, columns)), scale_m / grid.cell_m)
                for each in (weight * above, weight)
            )
            level = level + (moved / (known + _ENOUGH)).ravel()
    return HeightGrid(grid.corner_m, grid.cell_m, level.reshape(rows, columns)), below_m


def _followed(drive: Float64[np.ndarray, "n 3"], reach: Reach) -> HeightGrid:
    """Return a surface as high as the drive beside it, smooth where the drive bends or ends."""
    low, high = reach.low[:2], reach.high[:2]
    cell = max(_CELL_M, float((high - low).max()) / _MOST_CELLS)
    columns, rows = (np.ceil((high - low) / cell).astype(int) + 1).tolist()
    y, x = np.mgrid[:rows, :columns] * cell
    way = _dense(drive)
    nearest = scipy.spatial.KDTree(way[:, :2]).query(np.stack([x.ravel() + low[0], y.ravel() + low[1]], axis=1))[1]
    heights = way[np.asarray(nearest), 2].reshape(rows, columns)
    return HeightGrid((float(low[0]), float(low[1])), cell, _smoothed(heights, 2.0 / cell))


def _dense(drive: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "m 3"]:
    """Return the drive with a place at least every half a metre."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(drive[:, :2], axis=0), axis=1))])
    steps = np.linspace(0.0, along[-1], int(along[-1] / _CELL_M) + 2)
    return np.stack([np.interp(steps, along, drive[:, axis]) for axis in range(3)], axis=1)


def _depth_below(
    drive: Float64[np.ndarray, "n 3"],
    places: Float64[np.ndarray, "m 3"],
    top_m2: Float64[np.ndarray, " m"],
    else_m: float,
) -> float:
    """How far below the drive most of what lies flat under it is."""
    way = _dense(drive)
    away, nearest = scipy.spatial.KDTree(way[:, :2]).query(places[:, :2])
    under = np.asarray(away) < _UNDER_M
    depth, area = way[np.asarray(nearest)[under], 2] - places[under, 2], top_m2[under]
    edges = np.arange(-_HIGHEST_M, _DEEPEST_M + _BIN_M / 2, _BIN_M)
    histogram = np.convolve(np.histogram(depth, edges, weights=area)[0], np.ones(3), mode="same")
    best = int(np.argmax(histogram))
    if histogram[best] < _LEAST_M2:
        return else_m
    near = np.abs(depth - (edges[best] + _BIN_M / 2)) < 2 * _BIN_M
    return float(np.average(depth[near], weights=area[near]))


def _summed(
    cells: Int64[np.ndarray, " n"], values: Float64[np.ndarray, " n"], shape: tuple[int, int]
) -> Float64[np.ndarray, "rows columns"]:
    return np.bincount(cells, values, shape[0] * shape[1]).astype(np.float64).reshape(shape)  # of no values: integers


def _smoothed(grid: Float64[np.ndarray, "rows columns"], sigma: float) -> Float64[np.ndarray, "rows columns"]:
    return scipy.ndimage.gaussian_filter(grid, sigma, mode="nearest", truncate=2.5)
