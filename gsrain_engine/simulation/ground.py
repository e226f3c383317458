"""How high the ground is. World frame, metres."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float64, Int64

from ..scene.gaussians import Gaussians, scene_cache
from ..scene.geometry import matrices_from_quaternions
from ..scene.scene import Scene

SENSOR_HEIGHT_M = 1.5
"""Height of the rig frame's origin above the road where nothing tells it (paper, sec. on rain regions)."""

_LOWEST_RIG_M, _HIGHEST_RIG_M = -0.5, 4.0
"""A stated ground is believed where the rig frame's origin is so far above it."""

# § Heights over a grid of the world's x and y, asked for one place at a time or for many.


@dataclass(frozen=True, slots=True, eq=False)
class HeightGrid:
    """Heights at the middles of cells, blended between them; beyond the grid the nearest cell's."""

    corner_m: tuple[float, float]
    """x and y of the middle of the first cell."""
    cell_m: float
    heights_m: Float64[np.ndarray, "rows columns"]
    """Rows along y."""

    @staticmethod
    def level(height_m: float) -> "HeightGrid":
        return HeightGrid((0.0, 0.0), 1.0, np.full((1, 1), float(height_m)))

    def at(self, x_m: float, y_m: float) -> float:
        """Height at a place, without the cost of arrays."""
        rows, columns = self.heights_m.shape
        u = min(max((x_m - self.corner_m[0]) / self.cell_m, 0.0), columns - 1.0)
        v = min(max((y_m - self.corner_m[1]) / self.cell_m, 0.0), rows - 1.0)
        i, j = int(u), int(v)
        right, up = min(i + 1, columns - 1), min(j + 1, rows - 1)
        s, t = u - i, v - j
        near = (1 - s) * self.heights_m[j, i] + s * self.heights_m[j, right]
        far = (1 - s) * self.heights_m[up, i] + s * self.heights_m[up, right]
        return float((1 - t) * near + t * far)

    def at_all(self, places: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        rows, columns = self.heights_m.shape
        u, v = np.clip((places - self.corner_m) / self.cell_m, 0.0, (columns - 1.0, rows - 1.0)).T
        i, j = u.astype(np.int64), v.astype(np.int64)
        right, up = np.minimum(i + 1, columns - 1), np.minimum(j + 1, rows - 1)
        s, t = u - i, v - j
        near = (1 - s) * self.heights_m[j, i] + s * self.heights_m[j, right]
        far = (1 - s) * self.heights_m[up, i] + s * self.heights_m[up, right]
        return (1 - t) * near + t * far


@dataclass(frozen=True, slots=True, eq=False)
class RoadSurface:
    """The ground as a height over each place; a vehicle on it stands upright, whatever the slope."""

    grid: HeightGrid
    rig_height_m: float = SENSOR_HEIGHT_M
    """Of the rig frame's origin above it, along the recorded drive."""

    def height_m(self, x_m: float, y_m: float) -> float:
        """Height at a place; beyond what is known that of the nearest place."""
        return self.grid.at(x_m, y_m)

    def heights_m(self, places: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        return self.grid.at_all(places)


@scene_cache(maxsize=2)
def road_surface_of(scene: Scene) -> RoadSurface:
    """Find the ground of a scene; the last two scenes' are kept.

    It lies below the recorded drive: as far as the scene states for where the drive begins, else as far as most of what
    lies flat under it; and it follows what lies flat beside it. Without a drive it is level, at the stated height or
    that of the origin.
    """
    drive = recorded_ego_positions(scene)
    if not len(drive):
        return RoadSurface(HeightGrid.level(scene.ground_m or 0.0))
    below = None if scene.ground_m is None else float(drive[0, 2]) - scene.ground_m
    if below is not None and not _LOWEST_RIG_M < below < _HIGHEST_RIG_M:
        below = None
    return RoadSurface(*find_road_surface(scene, drive, below, SENSOR_HEIGHT_M))


# § Finds the ground along a recorded drive in the scene itself. World frame, metres.

_UNDER_M = 2.5
"""How far beside the drive something lies under it."""

_CELL_M, _MAX_CELLS = 0.5, 1500
"""Cells, and how many there are at most on a side: of a larger scene they are larger."""

_DEEPEST_M, _HIGHEST_M = 4.0, 0.5
"""The rig frame's origin is at most so far above the ground, and so far below."""

_BIN_M = 0.05

_MIN_M2 = 2.0
"""What lies flat under the drive must cover so much to tell how far below it the ground is."""

_PASSES = ((8.0, 0.8, 4), (4.0, 0.4, 4), (2.0, 0.2, 3), (1.0, 0.12, 2))
"""Smoothing, band around the surface (both in metres), and how often: from the lie of the land to the lane."""

_ABOVE_COUNTS = 0.25
"""Weight of what is over the surface, relative to what is under it: all sorts of things stand on the ground."""

_ENOUGH = 0.05
"""Share of a cell that must be covered for half of what is found in it to be believed."""


def find_road_surface(
    scene: Scene, drive: Float64[np.ndarray, "n 3"], below_m: float | None, else_m: float
) -> tuple[HeightGrid, float]:
    """Find the ground around a drive, and how far it lies below the rig frame's origin.

    `below_m` is how far, where that is known; `else_m` where nothing lies under the drive. The surface starts parallel
    to the drive and moves, again and again, to the smoothed mean of what lies in a band around it, while smoothing and
    band narrow: so it follows slopes and passes under cars and bushes. Where nothing lies it keeps what was found at
    the larger scales.
    """
    spot = np.array([LATERAL_EXTENT_M, LATERAL_EXTENT_M, 0.0])
    reach = WorldRegion(
        drive.min(axis=0) - spot - [0, 0, _DEEPEST_M + 2], drive.max(axis=0) + spot + [0, 0, _HIGHEST_M + 2]
    )
    grid = _followed(drive, reach)
    pieces = gaussian_pieces(scene, reach, _CELL_M)
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


# § A scene's solid background in small pieces, each with the area that it shows from the side and from above.


class HeightSlab(NamedTuple):
    """What is between two heights above the ground."""

    ground: HeightGrid
    low_m: float
    high_m: float

    def above_m(self, places: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
        return places[:, 2] - self.ground.at_all(places[:, :2])


class WorldRegion(NamedTuple):
    """The part of the world that matters: a box, and in it, where there is one, a slab over the ground."""

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]
    slab: HeightSlab | None = None


def _followed(drive: Float64[np.ndarray, "n 3"], reach: WorldRegion) -> HeightGrid:
    """Return a surface as high as the drive beside it, smooth where the drive bends or ends."""
    low, high = reach.low[:2], reach.high[:2]
    cell = max(_CELL_M, float((high - low).max()) / _MAX_CELLS)
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
    if histogram[best] < _MIN_M2:
        return else_m
    near = np.abs(depth - (edges[best] + _BIN_M / 2)) < 2 * _BIN_M
    return float(np.average(depth[near], weights=area[near]))


def _summed(
    cells: Int64[np.ndarray, " n"], values: Float64[np.ndarray, " n"], shape: tuple[int, int]
) -> Float64[np.ndarray, "rows columns"]:
    return np.bincount(cells, values, shape[0] * shape[1]).astype(np.float64).reshape(shape)  # of no values: integers


def _smoothed(grid: Float64[np.ndarray, "rows columns"], sigma: float) -> Float64[np.ndarray, "rows columns"]:
    return scipy.ndimage.gaussian_filter(grid, sigma, mode="nearest", truncate=2.5)


# § Where the recorded drive went. World frame, metres.

LATERAL_EXTENT_M = 40.0
"""How far beside the recorded drive the ground, the road and what stands there are known."""


def recorded_ego_positions(scene: Scene) -> Float64[np.ndarray, "n 3"]:
    """Return the places of the rig frame's origin, sample by sample; none where the scene has no ego vehicle."""
    poses = [] if scene.ego is None else [scene.ego_to_world(float(t)) for t in scene.ego.times]
    return np.array([pose[:3, 3] for pose in poses if pose is not None]).reshape(-1, 3)


def recorded_extent(scene: Scene) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Return the corners of the box around the recorded drive, and around what is known beside it.

    Without a drive it is that around the origin. Heights are the drive's own.
    """
    drive = recorded_ego_positions(scene)
    if not len(drive):
        drive = np.zeros((1, 3))
    spot = np.array([LATERAL_EXTENT_M, LATERAL_EXTENT_M, 0.0])
    return drive.min(axis=0) - spot, drive.max(axis=0) + spot


SOLID = 0.5
"""Opacity from which a Gaussian can be driven into or upon: haze and most floaters of a capture have less."""

_CHUNK = 1 << 15

_COUNTS = ((1, 0.0, 0.5), (16, 0.5, 1.5), (64, 1.5, 4.0), (256, 4.0, np.inf))
"""How many pieces a Gaussian falls into whose largest standard deviation is from so many cells to so many."""

_DRAWS = np.clip(np.random.default_rng(0).standard_normal((256, 3)), -2, 2)
"""Places in a Gaussian, in standard deviations; beyond two there is hardly anything to be seen."""


class GaussianPieces(NamedTuple):
    """Pieces of Gaussians. World frame: metres, z up."""

    places: Float64[np.ndarray, "n 3"]
    side_m2: Float64[np.ndarray, " n"]
    """What each covers of a view from the side: from where it shows most."""
    top_m2: Float64[np.ndarray, " n"]
    """What each covers of a view from above."""


def gaussian_pieces(
    scene: Scene, reach: WorldRegion, cell_m: float, names: frozenset[str] | None = None
) -> GaussianPieces:
    """Take apart what stands still and can be seen of a scene, sky aside, so that no piece is much larger than a cell.

    What is hidden or deleted does not count. `names` takes these layers only.
    """
    pieces = [GaussianPieces(np.zeros((0, 3)), np.zeros(0), np.zeros(0))]
    for layer in scene.layers:
        if layer.kind == "sky" or not layer.visible or (names is not None and layer.name not in names):
            continue
        part = scene.part(layer)
        assert part is not None
        pieces += _pieces(part.remaining, part.opacity, part.to_world, reach, cell_m)
    places, side, top = (np.concatenate(column) for column in zip(*pieces, strict=True))
    return GaussianPieces(places, side, top)


def _pieces(
    gaussians: Gaussians, opacity: float, to_world: Float64[np.ndarray, "4 4"], reach: WorldRegion, cell_m: float
) -> Iterator[GaussianPieces]:
    centers = gaussians.means @ to_world[:3, :3].T + to_world[:3, 3]
    far = 2.0 * gaussians.scales.max(axis=1, initial=0.0)[:, None] * np.cbrt(np.linalg.det(to_world[:3, :3]))
    near = ((centers + far >= reach.low) & (centers - far <= reach.high)).all(axis=1)
    chosen = np.flatnonzero(near & (gaussians.opacities * opacity >= SOLID))
    for first in range(0, len(chosen), _CHUNK):
        rows = chosen[first : first + _CHUNK]
        part = gaussians.take(rows)
        turn = matrices_from_quaternions(part.quaternions.astype(np.float64))
        axes = to_world[:3, :3] @ (turn * part.scales[:, None, :])
        middles, opacities = centers[rows].astype(np.float64), part.opacities * opacity
        if reach.slab is not None:
            above, tall = reach.slab.above_m(middles), 2.0 * np.linalg.norm(axes[:, 2], axis=1)
            inside = (above + tall > reach.slab.low_m) & (above - tall < reach.slab.high_m)
            middles, axes, opacities = middles[inside], axes[inside], opacities[inside]
        yield from _strewn(middles, axes, opacities, reach, cell_m)


def _strewn(
    centers: Float64[np.ndarray, "n 3"],
    axes: Float64[np.ndarray, "n 3 3"],
    opacities: np.ndarray,
    reach: WorldRegion,
    cell_m: float,
) -> Iterator[GaussianPieces]:
    """Strew pieces over each Gaussian. A flat one's shadows along the axes are its area times its normal."""
    spread = axes @ axes.transpose(0, 2, 1)
    shadow = [
        2 * np.pi * opacities * np.sqrt(np.maximum(_minor(spread, *pair), 0)) for pair in ((1, 2), (0, 2), (0, 1))
    ]
    side, top = np.hypot(shadow[0], shadow[1]), shadow[2]
    longest = np.sqrt(np.einsum("nii->ni", spread).max(axis=1, initial=0.0))
    for count, least, most in _COUNTS:
        own = np.flatnonzero((longest >= least * cell_m) & (longest < most * cell_m))
        draws = _DRAWS[:count] - _DRAWS[:count].mean(axis=0)
        places = (centers[own, None] + np.einsum("kj,nij->nki", draws, axes[own])).reshape(-1, 3)
        inside = ((places >= reach.low) & (places <= reach.high)).all(axis=1)
        if reach.slab is not None:
            above = reach.slab.above_m(places)
            inside &= (above > reach.slab.low_m) & (above < reach.slab.high_m)
        sides, tops = (np.repeat(each[own] / count, count)[inside] for each in (side, top))
        yield GaussianPieces(places[inside], sides, tops)


def _minor(spread: Float64[np.ndarray, "n 3 3"], i: int, j: int) -> Float64[np.ndarray, " n"]:
    return spread[:, i, i] * spread[:, j, j] - spread[:, i, j] ** 2
