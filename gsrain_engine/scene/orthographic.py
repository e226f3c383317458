"""Orthographic cameras: views to scale, from above and aslant.

Their rays are parallel but for a fraction of a pixel: they come from an eye so far away that what rises by as much as
the picture is high is shifted by at most an 8000th of the picture. So all that draws pinholes draws them.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from ..choices import Direction
from .camera import Camera, look_at
from .scene import Scene, SceneCore, ahead_of

_EYE_HEIGHTS = 4000.0  # distance of the eye from the picture plane, in heights of the picture
_BEFORE_CORE = 0.5  # distance of the picture plane from the core, in radii of the core: a sky is farther away
_ASIDE_DEG, _DOWN_DEG = 45.0, 35.264  # of an isometric view
_MARGIN = 1.2  # of a picture around the core, beyond which things still reach
_UP = np.array([0.0, 0.0, 1.0])


def orthographic(camera: Camera, depth_m: float, core: SceneCore) -> Camera:
    """Return the orthographic camera that shows as much as a pinhole does at a depth in meters, in its direction.

    All of a scene's core (world, meters) is behind its picture plane.
    """
    scale = camera.fy / depth_m
    plane_m = _EYE_HEIGHTS * camera.height / scale
    nearest_m = float((core.corners @ camera.world_to_camera[2, :3]).min() + camera.world_to_camera[2, 3])
    pose = camera.world_to_camera.copy()
    pose[2, 3] += plane_m - (nearest_m - _BEFORE_CORE * core.radius_m)
    fx, fy = (plane_m * focal / depth_m for focal in (camera.fx, camera.fy))
    return replace(camera.pinhole, fx=fx, fy=fy, world_to_camera=pose, plane_m=plane_m)


def orientation(scene: Scene, direction: Direction) -> Float64[np.ndarray, "3 3"]:
    """Rotation from the world to a camera that looks in a direction."""
    if direction == "top":
        return np.diag([1.0, -1.0, -1.0])
    x, y, _ = ahead_of(scene)
    aside, down = np.radians([_ASIDE_DEG, _DOWN_DEG])
    level = np.array([x * np.cos(aside) + y * np.sin(aside), y * np.cos(aside) - x * np.sin(aside), 0.0])
    return look_at(np.zeros(3), np.cos(down) * level - np.sin(down) * _UP, _UP)[:3, :3]


def fitted_scale(core: SceneCore, turn: Float64[np.ndarray, "3 3"], width: int, height: int) -> float:
    """Pixels per meter at which a core fits into a picture, seen in an orientation (world to camera)."""
    across_m, down_m = extent_m(core, turn)
    return min(width / across_m, height / down_m)


def extent_m(core: SceneCore, turn: Float64[np.ndarray, "3 3"]) -> tuple[float, float]:
    """Width and height of a core with a margin, seen in an orientation."""
    across_m, down_m, _ = np.ptp(core.corners @ turn.T, axis=0).tolist()
    return _MARGIN * max(across_m, 1e-3), _MARGIN * max(down_m, 1e-3)


def scaled_camera(
    core: SceneCore,
    turn: Float64[np.ndarray, "3 3"],
    middle_m: Float64[np.ndarray, "3"],
    size_px: tuple[int, int],
    pixels_per_m: float,
) -> Camera:
    """Orthographic camera of an orientation (world to camera) and a scale, with a place in its middle."""
    width, height = size_px
    pose = np.eye(4)
    pose[:3, :3] = turn
    pose[:3, 3] = [0.0, 0.0, 1.0] - turn @ middle_m  # a meter in front of a pinhole of this scale at a meter
    pinhole = Camera(width, height, pixels_per_m, pixels_per_m, width / 2, height / 2, pose)
    return orthographic(pinhole, 1.0, core)
