"""Where the pixels of a view look, and where their surfaces are."""

import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.camera import Camera


def pixel_rays(camera: Camera) -> Float32[np.ndarray, "h w 3"]:
    """Directions through pixel centres in the world, with length 1 along the view axis: place = eye + depth * ray."""
    u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rotation = camera.world_to_camera[:3, :3]
    rays = u[None, :, None] * rotation[0] + v[:, None, None] * rotation[1] + rotation[2]
    return rays.astype(np.float32)


def elevations(camera: Camera, up: tuple[float, float, float]) -> Float32[np.ndarray, "h w"]:
    """Sine of the angle of each pixel's direction above the horizon."""
    rays = pixel_rays(camera)
    axis = np.array(up, np.float32) / np.linalg.norm(up)
    return ((rays @ axis) / np.linalg.norm(rays, axis=-1)).astype(np.float32)
