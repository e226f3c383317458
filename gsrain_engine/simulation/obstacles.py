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
"""A 3x3 block of cells is occupied if its side area reaches that of a post of this width over the whole height range:
thin posts are found and single floaters ignored."""

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
    low[2], high[2] = ground.heights_m.min() + LOW_M, ground.heights_m.max() + HIGH_M
    pieces = gaussian_pieces(scene, WorldRegion(low, high, HeightSlab(ground, LOW_M, HIGH_M)), CELL_M)
    keys, area = _areas(pieces, pieces.side_m2, CELL_M)
    return OccupiedSpace(keys[_around(keys, area) >= POST_M * (HIGH_M - LOW_M)])


def cell_keys(places: Float64[np.ndarray, "n 2"], cell_m: float) -> Int64[np.ndarray, " n"]:
    """Return the keys of square cells in the plane, ascending with x, then with y."""
    x, y = np.floor(places / cell_m).astype(np.int64).T
    return x * _SHIFT + y


def holds_cells(keys: Int64[np.ndarray, " n"], searched: Int64[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Return which of the `searched` keys occur in the sorted `keys`."""
    if not len(keys):
        return np.zeros(len(searched), np.bool_)
    return keys[np.minimum(np.searchsorted(keys, searched), len(keys) - 1)] == searched


def _around(keys: Int64[np.ndarray, " n"], values: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Sum the values of each cell and its eight neighbors."""
    total = np.zeros(len(keys))
    for x in (-1, 0, 1):
        for y in (-1, 0, 1):
            searched = keys + x * _SHIFT + y
            at = np.minimum(np.searchsorted(keys, searched), len(keys) - 1)
            total += np.where(keys[at] == searched, values[at], 0.0)
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
        quarters = [[cell_keys(box.part(x, y).lattice(_STEP_M), _CELL_M) for y in (0, 1)] for x in (0, 1)]
        return np.array([[holds_cells(self.keys, each).mean() for each in row] for row in quarters])


@scene_cache(maxsize=2)
def drivable_of(scene: Scene, ground: RoadSurface, occupied: OccupiedSpace) -> Drivable:
    """Find the road of a scene within the known ground around its drive; caches two scenes.

    The road is the layers called "road" or "ground". Without them it is the flat, unoccupied part of the ground.
    """
    low, high = recorded_extent(scene)
    low[2], high[2] = ground.heights_m.min() - 1, ground.heights_m.max() + 1
    named = any(layer.name in ROAD_LAYERS and layer.visible for layer in scene.layers)
    pieces = gaussian_pieces(scene, WorldRegion(low, high), _CELL_M, ROAD_LAYERS if named else None)
    if not named:
        places = pieces.places[:, :2]
        above = pieces.places[:, 2] - ground.heights_at(places)
        flat = (np.abs(above) < _FLAT_M) & (pieces.top_m2 > pieces.side_m2) & ~occupied.holds(places)
        pieces = GaussianPieces(*(column[flat] for column in pieces))
    keys, area = _areas(pieces, pieces.top_m2, _CELL_M)
    return Drivable(keys[area >= _COVERED * _CELL_M**2])


def _areas(
    pieces: GaussianPieces, area_m2: Float64[np.ndarray, " n"], cell_m: float
) -> tuple[Int64[np.ndarray, " cells"], Float64[np.ndarray, " cells"]]:
    """Return the sorted keys of cells with pieces, and the sums of their areas."""
    keys, owner = np.unique(cell_keys(pieces.places[:, :2], cell_m), return_inverse=True)
    return keys, np.bincount(owner.ravel(), area_m2, len(keys)).astype(np.float64)
