"""What of a scene's background can be driven into: cells of space that hold solid Gaussians. World frame, metres."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from gsrain_engine.scene.scene import Scene

from .ground import Ground
from .planar_box import PlanarBox

_SOLID = 0.8
_LOW_M, _HIGH_M = 0.3, 1.5
_MANY = 100


@dataclass(frozen=True, slots=True, eq=False)
class OccupiedSpace:
    """Places of solid Gaussians at the height of a car's body."""

    places: Float64[np.ndarray, "n 2"]
    _tree: KDTree

    def touches(self, box: PlanarBox) -> bool:
        """Whether a box on the ground holds more than a hundred of them (HUGSIM's rule)."""
        near = self._tree.query_ball_point((box.x_m, box.y_m), np.hypot(box.length_m, box.width_m) / 2)
        away = self.places[near] - (box.x_m, box.y_m)
        cosine, sine = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
        along, across = away @ (cosine, sine), away @ (-sine, cosine)
        inside = (np.abs(along) <= box.length_m / 2) & (np.abs(across) <= box.width_m / 2)
        return int(inside.sum()) > _MANY


def occupied_space_of(scene: Scene, ground: Ground) -> OccupiedSpace:
    """Find what stands in a scene, its actors aside."""
    found = [np.zeros((0, 2))]
    for layer in scene.layers:
        if layer.kind == "sky" or not layer.visible:
            continue
        part = scene.part(layer)
        assert part is not None
        solid = part.remaining
        means = solid.means[solid.opacities > _SOLID] @ part.to_world[:3, :3].T + part.to_world[:3, 3]
        height = means[:, 2] - ground.height_m(0.0, 0.0)
        found.append(means[(height > _LOW_M) & (height < _HIGH_M), :2].astype(np.float64))
    places = np.concatenate(found)
    return OccupiedSpace(places, KDTree(places))
