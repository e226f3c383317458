"""Scenes of random Gaussians in any number: what renderers are timed with."""

import re

import numpy as np

from .camera import Camera
from .drawing_order import put_into_drawing_order
from .errors import SceneFormatError
from .gaussians import COEFFICIENTS_OF_DEGREE, Gaussians
from .members import Layer
from .scene import Scene

_NAME = re.compile(r"random-([1-9]\d*)(k|m|)")
_MOST = 20_000_000
_FOV_DEG = 60.0
_UP = (0.0, -1.0, 0.0)


def is_random_scene(name: str) -> bool:
    """Whether this names a scene that `random_scene` makes."""
    return name.startswith("random-")


def random_scene(name: str) -> Scene:
    """Make "random-200k", "random-3m": so many Gaussians, of SH degree 0 in thousands and 3 in millions.

    In front of an eye at the origin that looks along +z with y downwards: x within 8 m, y within 5 m, z 4 to 24 m;
    log-normal scales with median 0.03 m, any direction, opacity 0.05 to 1. The same name is the same scene; it lies in
    its drawing order.

    Raises `SceneFormatError` for any other name.
    """
    match = _NAME.fullmatch(name)
    count = int(match[1]) * {"": 1, "k": 1000, "m": 1_000_000}[match[2]] if match else 0
    if match is None or count > _MOST:
        raise SceneFormatError(name, "random scenes are named by their size, at most 20m: random-200k, random-3m")
    gaussians = _random_gaussians(count, 3 if match[2] == "m" else 0)
    put_into_drawing_order(gaussians)
    return Scene(name, (Layer(name, gaussians),), up=_UP)


def random_scene_camera(scene: Scene, width: int, height: int) -> Camera:
    """Look into a random scene from its front, 60 degrees high. World frame, metres."""
    return Camera.from_fov(width, height, _FOV_DEG, np.eye(4)).moved(scene.scene_to_world)


def _random_gaussians(count: int, sh_degree: int) -> Gaussians:
    r, f = np.random.default_rng(7), np.float32
    means = np.stack([r.uniform(-8, 8, count), r.uniform(-5, 5, count), r.uniform(4, 24, count)], axis=1).astype(f)
    scales = np.exp(r.normal(np.log(0.03), 0.5, (count, 3))).astype(f)
    quaternions = r.normal(size=(count, 4)).astype(f)
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    opacities = r.uniform(0.05, 1, count).astype(f)
    sh = r.standard_normal((count, COEFFICIENTS_OF_DEGREE[sh_degree], 3), f)
    sh[:, 0] *= f(0.5)
    sh[:, 1:] *= f(0.1)
    return Gaussians(means, scales, quaternions, opacities, sh)
