"""Small made-up clear views: a level road with a wall behind it, under a blue sky."""

import numpy as np

from gsrain_engine.appearance.base import ClearView
from gsrain_engine.appearance.normals import view_rays
from gsrain_engine.scene.camera import Camera, look_at

WIDTH, HEIGHT = 96, 64
ROAD, WALL, SKY = (0.5, 0.48, 0.45), (0.6, 0.5, 0.4), (0.3, 0.5, 0.9)
WALL_AT_M, WALL_TOP_M, EYE_M = 20.0, 6.0, 1.5


def camera(eye=(0.0, 0.0, EYE_M), ahead=(1.0, 0.0, 0.0), width=WIDTH, height=HEIGHT):
    """Look along x of the world, from over the road z = 0."""
    eye = np.array(eye, float)
    return Camera.from_fov(width, height, 55, look_at(eye, eye + np.array(ahead), np.array([0, 0, 1.0])))


def dry_view(*, shadow=0.0, texture=0.0, noise=0.0, seen_from=None, vehicles=None, name="made"):
    """Return the view; the left half of the road lies in a shadow that takes a share of its light.

    `texture` is painted on road and wall; `noise` is the camera's, display, by the length of the view's name.
    """
    seen_from = seen_from or camera()
    rays = view_rays(seen_from)
    eye = seen_from.position
    to_road = np.where(rays[..., 2] < -1e-6, -eye[2] / np.minimum(rays[..., 2], -1e-6), np.inf)
    to_wall = (WALL_AT_M - eye[0]) / rays[..., 0]
    is_road = to_road < to_wall
    depth = np.where(is_road, to_road, to_wall)
    points = eye + depth[..., None] * rays
    is_sky = ~is_road & (points[..., 2] > WALL_TOP_M)
    image = np.where(is_road[..., None], ROAD, WALL)
    shade = (1 - shadow) ** (1 / 2.2)
    image = np.where((is_road & (points[..., 1] > 0))[..., None], shade * image, image)
    pattern = np.sin(1.7 * points[..., 0]) * np.sin(2.3 * points[..., 1] + 0.4) * np.cos(1.1 * points[..., 2])
    image = image * (1 + texture * pattern)[..., None]
    image = np.where(is_sky[..., None], SKY, image)
    image = np.clip(image + np.random.default_rng(len(name)).normal(0, noise, image.shape), 0, 1)
    normals = np.where(is_road[..., None], (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)) * ~is_sky[..., None]
    maps = (np.where(is_sky, 0, depth), normals, is_sky, np.zeros(depth.shape) if vehicles is None else vehicles)
    return ClearView(name, seen_from, 0.0, *(each.astype(np.float32) for each in (image, *maps)))
