"""Cameras of a rig in the world at a time, and the camera path of a camera mounted on the ego vehicle.

The ego frame has x forward, y left, z up; the world z up.
"""

import numpy as np

from .camera import Camera
from .camera_path import CameraPath
from .geometry import normalized, quaternions_from_matrices
from .scene import RigCamera, Scene


def rig_camera(scene: Scene, rig: str, name: str, time_s: float) -> Camera:
    """Camera of a rig in the world (meters) at a time.

    Raises ValueError if the scene has no such rig or camera, or no ego at that time.
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
    ends = (scene.ego_to_world(time_s + side * mounted.readout_s / 2) for side in (-1, 1))
    return mounted.camera(ego_to_world, mounted.rolling(*ends))


# Camera path of the ego vehicle


def rig_camera_path(scene: Scene, mounted: RigCamera, width: int, height: int) -> CameraPath:
    """Camera path in the world of a camera mounted on the ego vehicle.

    Keeps the horizontal field of view for this aspect ratio. Raises `ValueError` if the scene has no ego track.
    """
    if scene.ego is None or not len(scene.ego.times):
        raise ValueError(f"scene {scene.name!r} has no ego track to drive along")
    poses = [
        (t, pose @ mounted.camera_to_ego) for t in scene.ego.times if (pose := scene.ego_to_world(float(t))) is not None
    ]
    # The focal length scales with the image's width: the horizontal field of view stays.
    focal = mounted.fx * width / mounted.width
    fov = np.degrees(2 * np.arctan(0.5 * height / focal))
    matrices = np.stack([pose for _, pose in poses])
    return CameraPath(
        np.array([t for t, _ in poses]),
        matrices[:, :3, 3],
        normalized(quaternions_from_matrices(matrices[:, :3, :3])),
        np.full(len(poses), fov),
        mounted.exposure_s,
    )
