"""Shelter map: areas that rain doesn't reach, as the height of the roof over each cell of a grid."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float32, Float64, Int32

from ..scene.flags import BitMask
from ..scene.gaussians import Gaussians, scene_cache
from ..scene.geometry import matrices_from_quaternions
from ..scene.scene import DrawItem, Scene, robust_bounds

CELL_M = 0.5  # edge of a cell: about the spacing of Gaussians of a captured surface, and less than any canopy
CLEARANCE_M = 2.0  # minimum height of a roof above the lowest solid surface; a road surface fails it at any slope
_SOLID = np.log(2)  # optical depth from above at which a surface counts as solid: floaters alone don't reach it
_MAX_CELLS = 2048  # maximum number of cells per side; a larger scene is covered in its middle only
_MAX_GAUSSIANS = 1_000_000  # number of Gaussians above which every n-th is used, with n-fold weight
_CHUNK = 1 << 16
_DRAWS = np.random.default_rng(0).standard_normal((64, 3))


@dataclass(frozen=True, slots=True, eq=False)
class ShelterMap:
    """Heights of roofs over the world's x and y. World frame, meters, z up."""

    heights_m: Float32[np.ndarray, "rows columns"]
    """Rows along y, columns along x; -inf in the open."""
    corner_m: tuple[float, float]
    """x and y of the outer corner of the first cell."""
    cell_m: float = CELL_M

    def shelter(self, positions_m: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return the mask of positions under a roof."""
        column, row = np.floor((positions_m[:, :2] - self.corner_m) / self.cell_m).astype(np.int64).T
        rows, columns = self.heights_m.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        sheltered = np.zeros(len(positions_m), np.bool_)
        sheltered[inside] = positions_m[inside, 2] < self.heights_m[row[inside], column[inside]]
        return sheltered

    def around(self, x_m: float, y_m: float, reach_m: float) -> "ShelterMap | None":
        """Return the piece that covers a circle; None if all of it is in the open."""
        low = np.floor((np.array([x_m, y_m]) - reach_m - self.corner_m) / self.cell_m).astype(int)
        high = np.ceil((np.array([x_m, y_m]) + reach_m - self.corner_m) / self.cell_m).astype(int)
        low, high = np.maximum(low, 0), np.maximum(high, 0)
        piece = self.heights_m[low[1] : high[1], low[0] : high[0]]
        if not np.any(np.isfinite(piece)):
            return None
        corner = np.array(self.corner_m) + low * self.cell_m
        return ShelterMap(np.ascontiguousarray(piece), (float(corner[0]), float(corner[1])), self.cell_m)


class _HeightGrid(NamedTuple):
    corner_m: Float64[np.ndarray, "2"]
    columns: int
    rows: int


class _GaussianPieces(NamedTuple):
    cells: Int32[np.ndarray, " n"]
    heights_m: Float32[np.ndarray, " n"]
    depths: Float32[np.ndarray, " n"]
    """Optical depth that a piece adds to its cell, from above."""


class _SolidLayer(NamedTuple):
    """The part of a layer that determines roofs: selection, grading and name don't matter."""

    gaussians: Gaussians
    to_world: bytes
    left_out: BitMask | None
    opacity: float


def shelter_map_of(scene: Scene) -> ShelterMap | None:
    """Find the roofs of a scene's visible background layers; None without any.

    The maps of the last two scenes are cached, for split views.
    """
    layers = [layer for layer in scene.layers if layer.visible and layer.kind == "background"]
    to_world = scene.scene_to_world
    poses = [np.ascontiguousarray(to_world @ layer.to_scene).tobytes() for layer in layers]
    solids = zip(layers, poses, strict=True)
    return _roofs_of_solids(
        tuple(_SolidLayer(each.gaussians, pose, each.marks.left_out, each.opacity) for each, pose in solids)
    )


@scene_cache(maxsize=2)
def _roofs_of_solids(solids: tuple[_SolidLayer, ...]) -> ShelterMap | None:
    poses = [np.frombuffer(each.to_world).reshape(4, 4) for each in solids]
    layers = zip(solids, poses, strict=True)
    return build_shelter_map(
        [DrawItem(each.gaussians, pose, left_out=each.left_out, opacity=each.opacity) for each, pose in layers]
    )


def build_shelter_map(parts: Sequence[DrawItem]) -> ShelterMap | None:
    """Find roofs among Gaussians; None without any.

    In each cell, the optical depth of the Gaussians is accumulated from above and from below; the highest and the
    lowest surface are where it reaches ln 2. The highest is a roof if it is `CLEARANCE_M` above the lowest and belongs
    to a patch: seven of nine cells around it or around a neighbor. This rejects walls, lamp posts and lone floaters.
    """
    parts = [part._replace(gaussians=part.remaining, left_out=None) for part in parts]
    parts = [part for part in parts if len(part.gaussians)]
    if not parts:
        return None
    grid = _grid(parts)
    pieces = [points for part in parts for points in _points(part, grid)]
    highest = _roof_candidates(_GaussianPieces(*map(np.concatenate, zip(*pieces, strict=True))), grid)
    core = scipy.ndimage.rank_filter(highest, rank=2, size=3, mode="constant", cval=-np.inf)
    neighbor = scipy.ndimage.maximum_filter(core, size=3, mode="constant", cval=-np.inf)
    roofs = np.maximum(core, np.minimum(highest, neighbor))
    if not np.any(np.isfinite(roofs)):
        return None
    return ShelterMap(roofs, (float(grid.corner_m[0]), float(grid.corner_m[1])))


def _grid(parts: Sequence[DrawItem]) -> _HeightGrid:
    """Grid over the area that contains most Gaussians."""
    corners: list[Float64[np.ndarray, "8 2"]] = []
    for part in parts:
        box = np.stack(robust_bounds(part.gaussians, share=0.999))
        local = np.stack([each.ravel() for each in np.meshgrid(*box.T)], axis=1)
        corners.append((local @ part.to_world[:3, :3].T + part.to_world[:3, 3])[:, :2])
    low, high = np.min(corners, axis=(0, 1)) - CELL_M, np.max(corners, axis=(0, 1)) + CELL_M
    size = np.minimum(np.ceil((high - low) / CELL_M), _MAX_CELLS).astype(int)
    return _HeightGrid((low + high) / 2 - size * CELL_M / 2, int(size[0]), int(size[1]))


def _points(part: DrawItem, grid: _HeightGrid) -> Iterator[_GaussianPieces]:
    """Split Gaussians into points: small ones into one, large ones into many with the same distribution."""
    g, to_world = part.gaussians, part.to_world
    step = -(-len(g) // _MAX_GAUSSIANS)
    for first in range(0, len(g), _CHUNK * step):
        chunk = g.take(slice(first, first + _CHUNK * step, step))
        means = chunk.means @ to_world[:3, :3].T + to_world[:3, 3]
        turn = matrices_from_quaternions(chunk.quaternions.astype(np.float64))
        axes = to_world[:3, :3] @ (turn * chunk.scales[:, None, :])  # columns: standard deviations in meters
        flat = axes[:, :2] @ axes[:, :2].transpose(0, 2, 1)
        shadow_m2 = 2 * np.pi * np.sqrt(np.maximum(np.linalg.det(flat), 0))
        depth = step * chunk.opacities * shadow_m2 / CELL_M**2
        longest = np.sqrt(np.maximum(flat[:, 0, 0], flat[:, 1, 1]))
        for count, low, high in ((1, 0.0, 0.3), (8, 0.3, 0.8), (64, 0.8, np.inf)):
            own = np.flatnonzero((longest >= low * CELL_M) & (longest < high * CELL_M))
            draws = _DRAWS[:count] - _DRAWS[:count].mean(axis=0)
            places = (means[own, None] + np.einsum("kj,nij->nki", draws, axes[own])).reshape(-1, 3)
            cells = np.clip(np.floor((places[:, :2] - grid.corner_m) / CELL_M), -1, _MAX_CELLS).astype(np.int64)
            inside = np.all((cells >= 0) & (cells < [grid.columns, grid.rows]), axis=1)
            numbers = (cells[inside, 1] * grid.columns + cells[inside, 0]).astype(np.int32)
            depths = np.repeat(depth[own] / count, count)[inside].astype(np.float32)
            yield _GaussianPieces(numbers, places[inside, 2].astype(np.float32), depths)


def _roof_candidates(points: _GaussianPieces, grid: _HeightGrid) -> Float32[np.ndarray, "rows columns"]:
    """Height of the highest solid surface of each cell that has room below it; -inf elsewhere."""
    order = np.lexsort((-points.heights_m, points.cells))
    cells, heights, depths = (column[order] for column in points)
    first = np.searchsorted(cells, np.arange(grid.rows * grid.columns + 1))
    total = np.concatenate([[0.0], np.cumsum(depths, dtype=np.float64)])
    above = total[:-1] - total[first[cells]]  # optical depth above a point in its own cell
    below = total[first[cells + 1]] - total[1:]
    highest, lowest = (np.full(grid.rows * grid.columns, -np.inf) for _ in range(2))
    for surface, beyond in ((highest, above), (lowest, below)):
        reached = (beyond < _SOLID) & (beyond + depths >= _SOLID)
        surface[cells[reached]] = heights[reached]
    with np.errstate(invalid="ignore"):
        is_roof = highest - lowest >= CLEARANCE_M
    return np.where(is_roof, highest, -np.inf).astype(np.float32).reshape(grid.rows, grid.columns)
