"""Small scenes to select in."""

import numpy as np

from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import Layer, Scene
from small_scene import patch

WIDTH, HEIGHT = 96, 64


def scattered(count, seed=0, spread=4.0):
    """Gaussians of every size and color around the origin."""
    r, f = np.random.default_rng(seed), np.float32
    quaternions = r.normal(size=(count, 4))
    return Gaussians(
        r.uniform(-spread, spread, (count, 3)).astype(f),
        np.exp(r.normal(-2, 0.5, (count, 3))).astype(f),
        (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).astype(f),
        r.uniform(0.05, 1, count).astype(f),
        sh_from_color(r.uniform(0, 1, (count, 3)).astype(f)),
    )


def cloud(count=300, seed=0):
    """Two layers in a scene whose unit is 2 m and whose y points down; the second one is turned and grown."""
    turned = np.eye(4)
    turned[:3, :3] = 1.5 * np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned[:3, 3] = 0.3, -0.2, 0.5
    layers = (Layer("plain", scattered(count, seed)), Layer("turned", scattered(count, seed + 1), to_scene=turned))
    return Scene("cloud", layers, metres_per_unit=2.0, up=(0.0, -1.0, 0.0))


def shot_at(eye=(0.0, -12, 3), target=(0.0, 0, 0)):
    """A small picture of what is around the origin."""
    matrix = look_at(np.array(eye, float), np.array(target, float), np.array([0.0, 0, 1]))
    return RenderView(Camera.from_fov(WIDTH, HEIGHT, 60.0, matrix))


def two_walls(steps=16):
    """A red wall at y = 0, a green one 3 m behind it, seen from -y."""
    u, v = np.array([6.0, 0, 0]), np.array([0, 0, 4.0])
    front = patch((-3, 0, -2), u, v, steps, (0.9, 0.1, 0.1))
    back = patch((-3, 3, -2), u, v, steps, (0.1, 0.9, 0.1))
    return Scene("walls", (Layer("front", front), Layer("back", back)))


def world_means(scene, key):
    """Centres of a member in the world."""
    part = scene.part(scene.member(key))
    return part.gaussians.means @ part.to_world[:3, :3].T + part.to_world[:3, 3]


def pixels_of(points_m, camera):
    """Pixels and depths of points, the slow way."""
    seen = points_m @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    return np.stack([camera.fx * seen[:, 0] / seen[:, 2] + camera.cx,
                     camera.fy * seen[:, 1] / seen[:, 2] + camera.cy, seen[:, 2]], axis=1)  # fmt: skip
