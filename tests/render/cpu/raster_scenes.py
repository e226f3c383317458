"""Small random scenes for the rasterizer's tests."""

import numpy as np

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians


def random_gaussians(
    count: int, seed: int = 0, degree: int = 0, depth_m: tuple[float, float] = (1.0, 9.0)
) -> Gaussians:
    """Make Gaussians in front of an eye at the origin that looks along +z."""
    r = np.random.default_rng(seed)
    z = r.uniform(*depth_m, count)
    means = np.stack([r.uniform(-0.6, 0.6, count) * z, r.uniform(-0.5, 0.5, count) * z, z], axis=1)
    scales = np.exp(r.normal(np.log(0.15), 0.8, (count, 3)))
    quaternions = r.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    sh = r.normal(0, 0.5, (count, (degree + 1) ** 2, 3))
    numbers = (means, scales, quaternions, r.uniform(0.02, 1, count), sh)
    return Gaussians(*(np.ascontiguousarray(each, np.float32) for each in numbers))


def small_camera(width: int = 75, height: int = 53) -> Camera:
    """Look along +z with an off-center principal point; the size is no multiple of a tile."""
    return Camera(width, height, 60.0, 64.0, 0.42 * width, 0.55 * height)
