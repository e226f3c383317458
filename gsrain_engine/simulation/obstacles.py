"""What of a scene's background can be driven into: pillars of space that something solid stands in. World, metres."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from ..scene.gaussians import scene_cache
from ..scene.scene import Scene
from .geometry import PlanarBox
from .ground import GaussianPieces, HeightSlab, RoadSurface, WorldRegion, gaussian_pieces, recorded_extent

LOW_M, HIGH_M = 0.3, 1.5
"""Heights above the ground between which a car's body is: kerbs are lower, crowns of trees and signs higher."""

CELL_M = 0.1

POST_M = 0.08
"""Something is in the way if it shows from the side what a post of this width does over the whole height, and does so
within three cells by three: thin posts are found, single Gaussians that float about are not."""

_SHIFT = np.int64(1) << 32


@dataclass(frozen=True, slots=True, eq=False)
class OccupiedSpace:
    """The cells, seen from above, in which something stands at the height of a car's body."""

    keys: Int64[np.ndarray, " n"]
    """Of the cells, rising: the number of the cell along x times 2^32 plus that along y."""

    @property
    def places(self) -> Float64[np.ndarray, "n 2"]:
        y = (self.keys + _SHIFT // 2) % _SHIFT - _SHIFT // 2
        return (np.stack([(self.keys - y) // _SHIFT, y], axis=1) + 0.5) * CELL_M

    def touches(self, box: PlanarBox) -> bool:
        return bool(self.holds(box.lattice(0.7 * CELL_M)).any())

    def holds(self, places: Float64[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Which places lie in one of them."""
        return holds_cells(self.keys, cell_keys(places, CELL_M))


@scene_cache(maxsize=2)
def occupied_space_of(scene: Scene, ground: RoadSurface) -> OccupiedSpace:
    """Find what stands in a scene, its actors aside, as far beside its drive as the ground is known; keeps two scenes'.

    The areas that solid Gaussians between knee and roof show from the side are added up in cells, so it does not matter
    of how many a thing is made (HUGSIM counts Gaussians: more than a hundred of opacity over 0.8).
    """
    low, high = recorded_extent(scene)
    low[2], high[2] = ground.grid.heights_m.min() + LOW_M, ground.grid.heights_m.max() + HIGH_M
    pieces = gaussian_pieces(scene, WorldRegion(low, high, HeightSlab(ground.grid, LOW_M, HIGH_M)), CELL_M)
    keys, owner = np.unique(cell_keys(pieces.places[:, :2], CELL_M), return_inverse=True)
    area = np.bincount(owner.ravel(), pieces.side_m2, len(keys)).astype(np.float64)
    return OccupiedSpace(keys[_around(keys, area) >= POST_M * (HIGH_M - LOW_M)])


def cell_keys(places: Float64[np.ndarray, "n 2"], cell_m: float) -> Int64[np.ndarray, " n"]:
    """Number the square cells of the plane: rising with x, then with y."""
    x, y = np.floor(places / cell_m).astype(np.int64).T
    return x * _SHIFT + y


def holds_cells(keys: Int64[np.ndarray, " n"], wanted: Int64[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Which numbers of cells are among others, which rise."""
    if not len(keys):
        return np.zeros(len(wanted), np.bool_)
    return keys[np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)] == wanted


def _around(keys: Int64[np.ndarray, " n"], values: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Sum what is in each cell and its eight neighbours."""
    total = np.zeros(len(keys))
    for x in (-1, 0, 1):
        for y in (-1, 0, 1):
            wanted = keys + x * _SHIFT + y
            at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            total += np.where(keys[at] == wanted, values[at], 0.0)
    return total


# § Where the road is: the ground that a vehicle may stand on. World frame, metres.

ROAD_LAYERS = frozenset({"road", "ground"})
"""Layers of these names are road, and nothing else is where a scene has one."""

_CELL_M = 0.25

_FLAT_M = 0.08
"""Without such a layer: what lies flat within so much of the ground is taken for road; kerbs are higher."""

_COVERED = 0.3
"""Share of a cell, seen from above, from which it is covered."""

_STEP_M = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Drivable:
    """The cells of the ground that are road."""

    keys: Int64[np.ndarray, " n"]
    """See `cell_keys`; rising."""

    def share_on_road(self, box: PlanarBox) -> Float64[np.ndarray, "2 2"]:
        """Return how much of each quarter of a box is on the road, 0..1: front then rear, left then right.

        HUGSIM's drivable-area compliance counts a quarter as on the road where any of its ground points is.
        """
        return np.array([[self._share(box.part(x, y)) for y in (0, 1)] for x in (0, 1)])

    def _share(self, box: PlanarBox) -> float:
        return float(holds_cells(self.keys, cell_keys(box.lattice(_STEP_M), _CELL_M)).mean())


@scene_cache(maxsize=2)
def drivable_of(scene: Scene, ground: RoadSurface, occupied: OccupiedSpace) -> Drivable:
    """Find the road of a scene as far beside its drive as the ground is known; keeps the last two scenes'.

    Layers called "road" or "ground" are it. Where there are none it is what lies flat on the ground and has nothing
    standing on it.
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
