"""Where the recorded drive went. World frame, metres."""

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.scene import Scene

BESIDE_M = 40.0
"""How far beside the recorded drive the ground, the road and what stands there are known."""


def recorded_places(scene: Scene) -> Float64[np.ndarray, "n 3"]:
    """Return the places of the rig frame's origin, sample by sample; none where the scene has no ego vehicle."""
    poses = [] if scene.ego is None else [scene.ego_to_world(float(t)) for t in scene.ego.times]
    return np.array([pose[:3, 3] for pose in poses if pose is not None]).reshape(-1, 3)
