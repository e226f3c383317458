"""Cameras of a rig as it stands at a time: from the ego frame (x forward, y left, z up) to the world (z up)."""

import numpy as np

from .camera import Camera
from .camera_path import CameraPath
from .geometry import normalized, quaternions_from_matrices
from .scene import RigCamera, Scene


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


# § The way of a camera that rides on the ego vehicle.


def rig_camera_path(scene: Scene, mounted: RigCamera, width: int, height: int) -> CameraPath:
    """Path in the world of a rig camera that rides on the ego vehicle; in an image of this shape it sees as much.

    Raises `ValueError` where the scene has no ego track.
    """
    if scene.ego is None or not len(scene.ego.times):
        raise ValueError(f"scene {scene.name!r} has no ego track to drive along")
    poses = [
        (t, pose @ mounted.camera_to_ego) for t in scene.ego.times if (pose := scene.ego_to_world(float(t))) is not None
    ]
    # The mounted camera's focal length in relation to the image's width: what is seen to the sides stays.
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
