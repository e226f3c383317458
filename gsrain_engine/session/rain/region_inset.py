"""A look at a rain region from outside: cameras carry it along, so that most of its faces are out of their sight."""

from itertools import product

import numpy as np
from jaxtyping import Float64

from gsrain_engine.rain.rain import Box
from gsrain_engine.render.scene_view import Shot
from gsrain_engine.scene.camera import Camera, look_at

_FROM = np.array([-0.75, 0.8, 0.62])
"""From behind, left and above: x runs to the upper right, y to the upper left."""
_FOV_DEG = 24.0
_FILLED = 0.74
"""Share of the picture that the region fills."""


def inset_shot(box: Box, anchor_to_world: Float64[np.ndarray, "4 4"], width: int, height: int) -> Shot:
    """Look at a whole region, whose frame stands in the world, from outside."""
    turn = anchor_to_world[:3, :3]
    middle = turn @ np.array(box.center_m) + anchor_to_world[:3, 3]
    direction = turn @ (_FROM / np.linalg.norm(_FROM))
    pose = look_at(middle + direction, middle, np.array([0.0, 0.0, 1.0]))
    sides = np.array(list(product((-0.5, 0.5), repeat=3))) * np.array(box.size_m)
    x, y, z = (sides @ turn.T @ pose[:3, :3].T).T
    high = np.tan(np.radians(_FOV_DEG) / 2) * _FILLED
    away = float(np.max(np.maximum(np.abs(x) * height / width, np.abs(y)) / high - z))
    pose = look_at(middle + away * direction, middle, np.array([0.0, 0.0, 1.0]))
    return Shot(Camera.from_fov(width, height, _FOV_DEG, pose))


def frustum_lines(camera: Camera, length_m: float) -> Float64[np.ndarray, "8 2 3"]:
    """Edges of what a camera sees up to a depth, as lines in the world."""
    x0, x1 = -camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx
    y0, y1 = -camera.cy / camera.fy, (camera.height - camera.cy) / camera.fy
    corners = length_m * np.array([[x0, y0, 1.0], [x1, y0, 1.0], [x1, y1, 1.0], [x0, y1, 1.0]])
    corners = corners @ camera.world_to_camera[:3, :3] + camera.position
    eye = np.broadcast_to(camera.position, (4, 3))
    return np.concatenate([np.stack([eye, corners], axis=1), np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)])
