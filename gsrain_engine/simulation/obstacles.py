"""Obstacles and drivable area: occupied cells of the background and road cells. World frame, meters."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from ..scene.gaussians import scene_cache
from ..scene.scene import Scene
from .geometry import PlanarBox
from .ground import GaussianPieces, HeightSlab, RoadSurface, WorldRegion, gaussian_pieces, recorded_extent

LOW_M, HIGH_M = 0.3, 1.5
"""Height range of a car's body above the ground: curbs are lower, tree crowns and signs higher."""

CELL_M = 0.1
POST_M = 0.08
"""A 3x3 block of cells is occupied if its side area reaches that of a post of this width over the whole height range.

This finds thin posts and ignores single floaters.
"""

_SHIFT = np.int64(1) << 32


@dataclass(frozen=True, slots=True, eq=False)
class OccupiedSpace:
    """Top-down grid cells occupied at the height of a car's body."""

    keys: Int64[np.ndarray, " n"]
    """Sorted cell keys: the cell index along x times 2^32 plus the index along y."""

    @property
    def places(self) -> Float64[np.ndarray, "n 2"]:
        y = (self.keys + _SHIFT // 2) % _SHIFT - _SHIFT // 2
        return (np.stack([(self.keys - y) // _SHIFT, y], axis=1) + 0.5) * CELL_M

    def touches(self, box: PlanarBox) -> bool:
        return bool(self.holds(box.lattice(0.7 * CELL_M)).any())

    def holds(self, places: Float64[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Return the places that lie in occupied cells."""
        return holds_cells(self.keys, cell_keys(places, CELL_M))


@scene_cache(maxsize=2)
def occupied_space_of(scene: Scene, ground: RoadSurface) -> OccupiedSpace:
    """Find the static obstacles of a scene within the known ground around its drive; caches two scenes.

    Cells sum the side areas of solid Gaussians in the height range, so the number of Gaussians per object does not
    matter (HUGSIM counts Gaussians: more than a hundred of opacity over 0.8).
    """
    low, high = recorded_extent(scene)
    low[2], high[2] = ground.grid.heights_m.min() + LOW_M, ground.grid.heights_m.max() + HIGH_M
    pieces = gaussian_pieces(scene, WorldRegion(low, high, HeightSlab(ground.grid, LOW_M, HIGH_M)), CELL_M)
    keys, owner = np.unique(cell_keys(pieces.places[:, :2], CELL_M), return_inverse=True)
    area = np.bincount(owner.ravel(), pieces.side_m2, len(keys)).astype(np.float64)
    return OccupiedSpace(keys[_around(keys, area) >= POST_M * (HIGH_M - LOW_M)])


def cell_keys(places: Float64[np.ndarray, "n 2"], cell_m: float) -> Int64[np.ndarray, " n"]:
    """Return the keys of square cells in the plane, ascending with x, then with y."""
    x, y = np.floor(places / cell_m).astype(np.int64).T
    return x * _SHIFT + y


def holds_cells(keys: Int64[np.ndarray, " n"], wanted: Int64[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Return which of the `wanted` keys occur in the sorted `keys`."""
    if not len(keys):
        return np.zeros(len(wanted), np.bool_)
    return keys[np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)] == wanted


def _around(keys: Int64[np.ndarray, " n"], values: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Sum the values of each cell and its eight neighbors."""
    total = np.zeros(len(keys))
    for x in (-1, 0, 1):
        for y in (-1, 0, 1):
            wanted = keys + x * _SHIFT + y
            at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            total += np.where(keys[at] == wanted, values[at], 0.0)
    return total


# Drivable area

ROAD_LAYERS = frozenset({"road", "ground"})
"""Names of road layers; if a scene has one, nothing else is road."""

_CELL_M = 0.25
_FLAT_M = 0.08  # without a road layer, flat parts within this height of the ground are road; curbs are higher
_COVERED = 0.3  # minimum top-down coverage of a covered cell
_STEP_M = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Drivable:
    """Ground cells that are road."""

    keys: Int64[np.ndarray, " n"]
    """Sorted `cell_keys`."""

    def share_on_road(self, box: PlanarBox) -> Float64[np.ndarray, "2 2"]:
        """Return the share of each quarter of a box on the road, 0..1: rows front and rear, columns left and right.

        HUGSIM's drivable-area compliance counts a quarter as on the road if any of its ground points is.
        """
        return np.array([[self._share(box.part(x, y)) for y in (0, 1)] for x in (0, 1)])

    def _share(self, box: PlanarBox) -> float:
        return float(holds_cells(self.keys, cell_keys(box.lattice(_STEP_M), _CELL_M)).mean())


@scene_cache(maxsize=2)
def drivable_of(scene: Scene, ground: RoadSurface, occupied: OccupiedSpace) -> Drivable:
    """Find the road of a scene within the known ground around its drive; caches two scenes.

    The road is the layers called "road" or "ground". Without them it is the flat, unoccupied part of the ground.
    """
    low, high = recorded_extent(scene)
    low[2], high[2] = ground.grid.heights_m.min() - 1, ground.grid.heights_m.max() + 1
    named = any(layer.name in ROAD_LAYERS and layer.visible for layer in scene.layers)
    pieces = gaussian_pieces(scene, WorldRegion(low, high), _CELL_M, ROAD_LAYERS if named else None)
    return Drivable(_covered(pieces) if named else _flat(pieces, ground, occupied))


def _flat(pieces: GaussianPieces, ground: RoadSurface, occupied: OccupiedSpace) -> Int64[np.ndarray, " n"]:
    above = pieces.places[:, 2] - ground.heights_m(pieces.places[:, :2])
    flat = (np.abs(above) < _FLAT_M) & (pieces.top_m2 > pieces.side_m2) & ~occupied.holds(pieces.places[:, :2])
    return _covered(GaussianPieces(pieces.places[flat], pieces.side_m2[flat], pieces.top_m2[flat]))


def _covered(pieces: GaussianPieces) -> Int64[np.ndarray, " n"]:
    keys, owner = np.unique(cell_keys(pieces.places[:, :2], _CELL_M), return_inverse=True)
    return keys[np.bincount(owner.ravel(), pieces.top_m2, len(keys)) >= _COVERED * _CELL_M**2]
