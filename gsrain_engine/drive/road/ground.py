"""How high the ground is. World frame, metres."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.identity import scene_cache
from gsrain_engine.scene.scene import Scene

from .ground_search import found_ground
from .height_grid import HeightGrid
from .recorded_places import recorded_places

SENSOR_HEIGHT_M = 1.5
"""Height of the rig frame's origin above the road where nothing tells it (paper, sec. on rain regions)."""
_LOWEST_RIG_M, _HIGHEST_RIG_M = -0.5, 4.0
"""A stated ground is believed where the rig frame's origin is so far above it."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
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
def ground_of(scene: Scene) -> Ground:
    """Find the ground of a scene; the last two scenes' are kept.

    It lies below the recorded drive: as far as the scene states for where the drive begins, else as far as most of what
    lies flat under it; and it follows what lies flat beside it. Without a drive it is level, at the stated height or
    that of the origin.
    """
    drive = recorded_places(scene)
    if not len(drive):
        return Ground(HeightGrid.level(scene.ground_m or 0.0))
    below = None if scene.ground_m is None else float(drive[0, 2]) - scene.ground_m
    if below is not None and not _LOWEST_RIG_M < below < _HIGHEST_RIG_M:
        below = None
    return Ground(*found_ground(scene, drive, below, SENSOR_HEIGHT_M))
