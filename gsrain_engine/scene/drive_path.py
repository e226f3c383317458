"""The way of a camera that rides on the ego vehicle."""

import numpy as np

from .paths.camera_path import CameraPath
from .rotations import normalized, quaternions_from_matrices
from .scene import RigCamera, Scene


def drive_path(scene: Scene, mounted: RigCamera, width: int, height: int) -> CameraPath:
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
