"""Where a lidar would stand on a rig: stacks that only see still reckon from there."""

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.scene import RigCamera

FROM_FRONT_CAMERA_M = (-0.76, -0.02, 0.33)
"""Place of nuScenes' LIDAR_TOP as seen from its CAM_FRONT, in vehicle axes (x forward, y left, z up). Sample log of
2018-07-24, to a centimetre; HUGSIM's `l2c` of its CAM_FRONT says the same to two centimetres."""
_AXES = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Lidar axes (x right, y forward, z up) in rig axes (x forward, y left, z up), as columns' images."""


def front_camera(cameras: tuple[RigCamera, ...]) -> RigCamera:
    """Return the camera that looks most straight ahead."""
    return max(cameras, key=lambda each: each.camera_to_ego[0, 2])


def lidar_to_rig(front: RigCamera) -> Float64[np.ndarray, "4 4"]:
    """Return the pose of the lidar (x right, y forward, z up) in the rig frame (x forward, y left, z up), metres."""
    matrix = np.eye(4)
    matrix[:3, :3] = _AXES
    matrix[:3, 3] = front.camera_to_ego[:3, 3] + FROM_FRONT_CAMERA_M
    return matrix
