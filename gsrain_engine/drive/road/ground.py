"""How high the ground is. World frame, metres."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from gsrain_engine.scene.scene import Scene

SENSOR_HEIGHT_M = 1.5
"""Height of the rig frame's origin above the road (paper, sec. on rain regions)."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """The ground as the recorded drive knows it: level with the road below the nearest place of the vehicle."""

    places: Float64[np.ndarray, "n 2"]
    heights_m: Float64[np.ndarray, " n"]

    def height_m(self, x_m: float, y_m: float) -> float:
        """Height at a place."""
        return float(self.heights_m[KDTree(self.places).query((x_m, y_m))[1]])


def ground_of(scene: Scene) -> Ground:
    """Return the ground of a scene: at the height that it says, else that of its drive, else that of the origin."""
    if scene.ground_m is not None:
        return Ground(np.zeros((1, 2)), np.array([scene.ground_m]))
    poses = [] if scene.ego is None else [scene.ego_to_world(float(t)) for t in scene.ego.times]
    places = np.array([pose[:3, 3] for pose in poses if pose is not None]).reshape(-1, 3)
    if not len(places):
        return Ground(np.zeros((1, 2)), np.zeros(1))
    return Ground(places[:, :2], places[:, 2] - SENSOR_HEIGHT_M)
