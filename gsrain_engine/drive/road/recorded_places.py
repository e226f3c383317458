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


def known_reach(scene: Scene) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Return the corners of the box around the recorded drive, and around what is known beside it.

    Without a drive it is that around the origin. Heights are the drive's own.
    """
    drive = recorded_places(scene)
    if not len(drive):
        drive = np.zeros((1, 3))
    spot = np.array([BESIDE_M, BESIDE_M, 0.0])
    return drive.min(axis=0) - spot, drive.max(axis=0) + spot
