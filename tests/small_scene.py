"""A scene that is small enough to drive a window with: a road, a wall, a sky, an ego vehicle with a camera."""

import numpy as np

from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import Layer, PoseTrack, RigCamera, Scene

AHEAD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""Axes of a camera that looks along +x, z up."""


def patch(origin, u, v, steps, color):
    """Flat Gaussians on a rectangle along two axes."""
    f = np.float32
    a, b = np.meshgrid(np.linspace(0, 1, steps), np.linspace(0, 1, steps))
    means = np.array(origin) + a.ravel()[:, None] * u + b.ravel()[:, None] * v
    n = len(means)
    size = np.maximum(0.7 * (np.abs(u) + np.abs(v)) / steps, 0.02)
    return Gaussians(
        means.astype(f),
        np.tile(size.astype(f), (n, 1)),
        np.tile(np.array([1, 0, 0, 0], f), (n, 1)),
        np.full(n, 0.95, f),
        sh_from_color(np.tile(np.array(color, f), (n, 1))),
    )


def small_scene(name="small"):
    """About 1,000 Gaussians, z up, meters; the ego drives 2 m/s for 5 s."""
    times = np.arange(6.0)
    ego = PoseTrack(times, np.stack([2 * times, np.zeros(6), np.full(6, 1.5)], axis=1),
                np.tile([1.0, 0, 0, 0], (6, 1)), np.ones(6, bool))  # fmt: skip
    mount = np.eye(4)
    mount[:3, :3] = AHEAD
    front = RigCamera("FRONT", 960, 640, 800.0, 800.0, 480.0, 320.0, mount, 0.004)
    road = patch((0, -6, 0), np.array([40.0, 0, 0]), np.array([0, 12.0, 0]), 20, (0.35, 0.33, 0.30))
    wall = patch((40, -12, 0), np.array([0, 24.0, 0]), np.array([0, 0, 9.0]), 20, (0.7, 0.45, 0.3))
    sky = patch((120, -150, 0), np.array([0, 300.0, 0]), np.array([0, 0, 150.0]), 12, (0.4, 0.6, 0.9))
    layers = (Layer("road", road), Layer("wall", wall), Layer("sky", sky, kind="sky"))
    return Scene(name, layers, ground_m=0.0, rigs={"one": (front,)}, ego=ego)
