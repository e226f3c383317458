"""Where a scene is first looked at from. World frame (metres, z up)."""

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.bounds import robust_bounds
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.drive_path import drive_path
from gsrain_engine.scene.paths.camera_path import CameraPath, orbit_path
from gsrain_engine.scene.scene import RigCamera, Scene

from .navigation import Navigation

_FOV_DEG = 50.0
_LOOKING_DOWN_DEG = 8.0
ORBIT_S = 8.0
"""How long the swing around a scene takes that has no drive."""


def home_camera(scene: Scene, width: int, height: int) -> Camera:
    """Through the windscreen where the scene has an ego vehicle with a rig; else in front of the scene's middle."""
    front = front_camera(scene)
    if front is not None:
        return drive_path(scene, front, width, height).camera(0.0, width, height)
    low, high = scene_bounds(scene)
    center, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-3)
    # Captures look along their +z when up is -y (COLMAP's axes), along +x when up is +z.
    ahead = scene.scene_to_world[:3, 0 if scene.up == (0.0, 0.0, 1.0) else 2]
    ahead = ahead - [0, 0, ahead[2]]
    ahead = ahead / np.linalg.norm(ahead) if np.linalg.norm(ahead) > 1e-6 else np.array([1.0, 0, 0])
    down = np.radians(_LOOKING_DOWN_DEG)
    sight = np.cos(down) * ahead - np.sin(down) * np.array([0, 0, 1.0])
    eye = center - sight * radius / np.sin(np.radians(_FOV_DEG) / 2)
    return Camera.from_fov(width, height, _FOV_DEG, look_at(eye, center, np.array([0.0, 0, 1])))


def default_path(scene: Scene, width: int, height: int) -> CameraPath:
    """Drive with the ego vehicle where there is one; else swing around the middle. World frame."""
    front = front_camera(scene)
    if front is not None:
        return drive_path(scene, front, width, height)
    low, high = scene_bounds(scene)
    return orbit_path((low + high) / 2, home_camera(scene, width, height), ORBIT_S)


def front_camera(scene: Scene) -> RigCamera | None:
    """The rig camera that looks straight ahead; None where no vehicle drives or it has no cameras."""
    if scene.ego is None or not len(scene.ego.times):
        return None
    mounted = [camera for rig in scene.rigs.values() for camera in rig]
    return max(mounted, key=lambda each: each.camera_to_ego[0, 2], default=None)


def scene_bounds(scene: Scene) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Box in the world around most of what can be seen, without the sky and stray Gaussians."""
    shown = [each for each in scene.layers if each.visible and each.kind != "sky"] or [
        each for each in scene.actors if each.visible
    ]
    parts = [part for each in shown if (part := scene.part(each)) is not None and len(part.remaining)]
    corners = [
        _corners(*robust_bounds(part.remaining)) @ part.to_world[:3, :3].T + part.to_world[:3, 3] for part in parts
    ]
    every = np.concatenate(corners) if corners else np.zeros((1, 3))
    return every.min(axis=0), every.max(axis=0)


def _corners(low: Float64[np.ndarray, "3"], high: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "8 3"]:
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])


def home_navigation(scene: Scene, width: int, height: int, speed_m_s: float) -> Navigation:
    """Stand at the home camera; turning goes around what is in front, 1 to 20 m away."""
    camera = home_camera(scene, width, height)
    navigation = Navigation(speed_m_s=speed_m_s)
    navigation.look_like(camera)
    low, high = scene_bounds(scene)
    in_front = float(camera.world_to_camera[2, :3] @ ((low + high) / 2) + camera.world_to_camera[2, 3])
    navigation.distance_m = float(np.clip(in_front, 1.0, 20.0))
    return navigation
