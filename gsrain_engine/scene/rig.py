"""Cameras of a rig as it stands at a time: from the ego frame (x forward, y left, z up) to the world (z up)."""

import numpy as np

from .camera import Camera
from .scene import Scene


def rig_camera(scene: Scene, rig: str, name: str, time_s: float) -> Camera:
    """Return a rig's camera in the world (metres) at a time.

    Raises ValueError where the scene has no such rig or camera, or no ego at that time.
    """
    if rig not in scene.rigs:
        raise ValueError(f"scene {scene.name!r} has no rig {rig!r}, only {', '.join(scene.rigs) or 'none'}")
    for mounted in scene.rigs[rig]:
        if mounted.name == name:
            break
    else:
        names = ", ".join(camera.name for camera in scene.rigs[rig])
        raise ValueError(f"rig {rig!r} has no camera {name!r}, only {names}")
    ego_to_world = scene.ego_to_world(time_s)
    if ego_to_world is None:
        raise ValueError(f"scene {scene.name!r} has no ego vehicle at {time_s} s")
    world_to_camera = np.linalg.inv(ego_to_world @ mounted.camera_to_ego)
    return Camera(
        mounted.width,
        mounted.height,
        mounted.fx,
        mounted.fy,
        mounted.cx,
        mounted.cy,
        world_to_camera,
        mounted.exposure_s,
    )
