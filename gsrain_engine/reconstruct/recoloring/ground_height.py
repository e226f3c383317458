"""How high the ground of a scene is, in the world (metres, z up)."""

import numpy as np

from gsrain_engine.scene.scene import Scene

from .scene_members import scene_members, world_heights

_LOW_SHARE = 0.05
"""A street's scene is mostly ground at its lowest; stray Gaussians below it are fewer than this share."""


def ground_height_m(scene: Scene) -> float:
    """World height of the ground: what the scene says, else the lowest twentieth of its half-opaque Gaussians.

    0 for a scene that holds none.
    """
    if scene.ground_m is not None:
        return scene.ground_m
    heights = [np.zeros(0, np.float32)]
    for member in scene_members(scene):
        if member.key.startswith("layers/") and not member.is_sky:
            heights.append(world_heights(scene, member)[member.gaussians.opacities > 0.5])
    found = np.concatenate(heights)
    found = found[np.isfinite(found)]
    return float(np.quantile(found, _LOW_SHARE)) if len(found) else 0.0
