"""Where a scene is first looked at from. World frame (metres, z up)."""

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.bounds import Core, core_bounds
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.drive_path import drive_path
from gsrain_engine.scene.paths.camera_path import CameraPath, orbit_path
from gsrain_engine.scene.scene import RigCamera, Scene

from .navigation import Navigation, is_in_view

_FOV_DEG = 50.0
_LOOKING_DOWN_DEG = 8.0
_LOOKING_DOWN_ON_FLAT_DEG = 25.0
"""On what is wide and low, such as a street, which hides itself behind its first houses otherwise."""
_MARGIN = 1.12
"""Around the box, which leaves out 2 % along each axis."""
ORBIT_S = 8.0
"""How long the swing around a scene takes that has no drive."""
ORBIT_DEG = 40.0
"""Angle of that swing."""


def home_camera(scene: Scene, width: int, height: int) -> Camera:
    """Through the windscreen where the scene has an ego vehicle with a rig; else in front of the scene's middle."""
    core, front = scene_core(scene), front_camera(scene)
    if front is not None:
        camera = drive_path(scene, front, width, height).camera(0.0, width, height)
        if is_in_view(core, camera.position, camera.world_to_camera[2, :3], camera.vertical_fov_deg):
            return camera
    # Captures look along their +z when up is -y (COLMAP's axes), along +x when up is +z.
    ahead = scene.scene_to_world[:3, 0 if scene.up == (0.0, 0.0, 1.0) else 2]
    ahead = ahead - [0, 0, ahead[2]]
    ahead = ahead / np.linalg.norm(ahead) if np.linalg.norm(ahead) > 1e-6 else np.array([1.0, 0, 0])
    length, width_m, height_m = core.high - core.low
    flat = 1.0 - min(2 * height_m / max(length, width_m, 1e-9), 1.0)
    down = np.radians(_LOOKING_DOWN_DEG + flat * (_LOOKING_DOWN_ON_FLAT_DEG - _LOOKING_DOWN_DEG))
    sight = np.cos(down) * ahead - np.sin(down) * np.array([0, 0, 1.0])
    turn = look_at(np.zeros(3), sight, np.array([0.0, 0, 1]))[:3, :3]
    eye = core.middle - sight * min(_fitting_distance(core, turn, width / height), max(core.farthest_m, 1e-3))
    return Camera.from_fov(width, height, _FOV_DEG, look_at(eye, core.middle, np.array([0.0, 0, 1])))


def _fitting_distance(core: Core, world_to_camera: Float64[np.ndarray, "3 3"], aspect: float) -> float:
    """Distance from the middle at which a core fills the picture: its box with a margin, or the sphere around it."""
    upright = np.tan(np.radians(_FOV_DEG) / 2)
    sphere = max(core.radius_m, 1e-3) / np.sin(np.arctan(upright * min(aspect, 1.0)))
    corners = np.stack(np.meshgrid(*zip(core.low, core.high, strict=True)), axis=-1).reshape(-1, 3) - core.middle
    x, y, z = world_to_camera @ corners.T
    box = np.max(np.maximum(np.abs(x) / (upright * aspect), np.abs(y) / upright) - z)
    return float(min(sphere, _MARGIN * box + 1e-3))


def default_path(scene: Scene, width: int, height: int) -> CameraPath:
    """Drive with the ego vehicle where there is one; else swing around the middle. World frame."""
    front = front_camera(scene)
    if front is not None:
        return drive_path(scene, front, width, height)
    return orbit_around(scene, width, height)


def orbit_around(
    scene: Scene, width: int, height: int, duration_s: float = ORBIT_S, sweep_deg: float = ORBIT_DEG
) -> CameraPath:
    """Swing around a scene's middle, from one side of its home camera to the other, in so many seconds. World frame.

    Raises `ValueError` where the time is not above 0.
    """
    if not duration_s > 0:
        raise ValueError(f"an orbit of {duration_s:g} s: its time must be above 0 s")
    return orbit_path(scene_core(scene).middle, home_camera(scene, width, height), duration_s, sweep_deg)


def front_camera(scene: Scene) -> RigCamera | None:
    """The rig camera that looks straight ahead; None where no vehicle drives or it has no cameras."""
    if scene.ego is None or not len(scene.ego.times):
        return None
    mounted = [camera for rig in scene.rigs.values() for camera in rig]
    return max(mounted, key=lambda each: each.camera_to_ego[0, 2], default=None)


def scene_core(scene: Scene) -> Core:
    """Find the dense core of what can be seen, and the sky around it; where no layer is shown, of the actors."""
    layers = [each for each in scene.layers if each.visible]
    shown = [each for each in layers if each.kind != "sky"] or [each for each in scene.actors if each.visible]
    parts, sky = (
        [part for each in members if (part := scene.part(each)) is not None]
        for members in (shown, [each for each in layers if each.kind == "sky"])
    )
    return core_bounds(parts, sky)


def home_navigation(scene: Scene, width: int, height: int, speed_m_s: float) -> Navigation:
    """Stand at the home camera; turning goes around the middle, inside of the scene around what is 1 to 20 m ahead."""
    camera, core = home_camera(scene, width, height), scene_core(scene)
    navigation = Navigation(speed_m_s=speed_m_s)
    navigation.look_like(camera)
    in_front = float(camera.world_to_camera[2, :3] @ core.middle + camera.world_to_camera[2, 3])
    is_outside = float(np.linalg.norm(core.middle - camera.position)) > core.radius_m
    navigation.distance_m = max(in_front, 1e-3) if is_outside else float(np.clip(in_front, 1.0, 20.0))
    return navigation
