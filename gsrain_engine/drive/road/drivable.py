"""Where the road is: the ground that a vehicle may stand on. World frame, metres."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from gsrain_engine.scene.identity import scene_cache
from gsrain_engine.scene.scene import Scene

from .ground import Ground
from .occupied_space import OccupiedSpace, cell_keys, holds_cells
from .planar_box import PlanarBox
from .recorded_places import known_reach
from .solid_pieces import Reach, SolidPieces, solid_pieces

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
def drivable_of(scene: Scene, ground: Ground, occupied: OccupiedSpace) -> Drivable:
    """Find the road of a scene as far beside its drive as the ground is known; keeps the last two scenes'.

    Layers called "road" or "ground" are it. Where there are none it is what lies flat on the ground and has nothing
    standing on it.
    """
    low, high = known_reach(scene)
    low[2], high[2] = ground.grid.heights_m.min() - 1, ground.grid.heights_m.max() + 1
    named = any(layer.name in ROAD_LAYERS and layer.visible for layer in scene.layers)
    pieces = solid_pieces(scene, Reach(low, high), _CELL_M, ROAD_LAYERS if named else None)
    return Drivable(_covered(pieces) if named else _flat(pieces, ground, occupied))


def _flat(pieces: SolidPieces, ground: Ground, occupied: OccupiedSpace) -> Int64[np.ndarray, " n"]:
    above = pieces.places[:, 2] - ground.heights_m(pieces.places[:, :2])
    flat = (np.abs(above) < _FLAT_M) & (pieces.top_m2 > pieces.side_m2) & ~occupied.holds(pieces.places[:, :2])
    return _covered(SolidPieces(pieces.places[flat], pieces.side_m2[flat], pieces.top_m2[flat]))


def _covered(pieces: SolidPieces) -> Int64[np.ndarray, " n"]:
    keys, owner = np.unique(cell_keys(pieces.places[:, :2], _CELL_M), return_inverse=True)
    return keys[np.bincount(owner.ravel(), pieces.top_m2, len(keys)) >= _COVERED * _CELL_M**2]
