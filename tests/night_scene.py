"""A dark yard with a lantern, whose light is on the ground and a wall: what tests of found lamps share."""

from dataclasses import replace

import numpy as np

from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.geometry import linear_to_srgb
from gsrain_engine.scene.scene import Layer, Scene

LANTERN_M = np.array([3.2, 1.1, 4.0])
INTENSITY_M2, COLOR = 120.0, np.array([1.0, 0.7, 0.4])
ALBEDO, SKY_LIGHT = 0.15, 0.002


def flat(origin, u, v, normal, steps, lamps=((LANTERN_M, INTENSITY_M2),)):
    """Flat Gaussians on a rectangle, lit by lamps in all directions."""
    a, b = np.meshgrid(np.linspace(0, 1, steps), np.linspace(0, 1, steps))
    means = np.array(origin) + a.reshape(-1, 1) * u + b.reshape(-1, 1) * v
    light = np.full((len(means), 3), SKY_LIGHT)
    for place, intensity in lamps:
        away = place - means
        squared = np.sum(away**2, axis=1)
        light += (ALBEDO / np.pi * intensity * np.abs(away @ normal) / squared**1.5)[:, None] * COLOR
    sizes = np.where(np.abs(normal) > 0.5, 0.002, 0.6 * (np.linalg.norm(u) / steps))
    return cluster(means, np.tile(sizes, (len(means), 1)), np.clip(light, 0, 1))


def cluster(means, sizes, light):
    """Gaussians along the axes, of linear light."""
    f = np.float32
    turns = np.tile(np.array([1, 0, 0, 0], f), (len(means), 1))
    color = sh_from_color(linear_to_srgb(np.asarray(light, float)).astype(f))
    return Gaussians(means.astype(f), np.asarray(sizes, f), turns, np.full(len(means), 0.95, f), color)


def bulb(place, light=(1.0, 1.0, 1.0), count=12, radius_m=0.08):
    """A cluster of Gaussians around a point."""
    random = np.random.default_rng(3)
    means = place + radius_m * random.uniform(-1, 1, (count, 3))
    return cluster(means - means.mean(axis=0) + place, np.full((count, 3), 0.05), np.tile(light, (count, 1)))


def night_scene(lamps=((LANTERN_M, INTENSITY_M2),)) -> Scene:
    """A yard of 24 x 24 m with a wall, clipped lamps, a bright wide window, and stars in the sky."""
    ground = flat((-12, -12, 0), np.array([24.0, 0, 0]), np.array([0, 24.0, 0]), np.array([0, 0, 1.0]), 60, lamps)
    wall = flat((-12, 9, 0), np.array([24.0, 0, 0]), np.array([0, 0, 8.0]), np.array([0, 1.0, 0]), 50, lamps)
    x, z = np.meshgrid(np.linspace(-9, -7, 8), np.linspace(1, 2.5, 8))
    window = cluster(
        np.stack([x.ravel(), np.full(64, 8.9), z.ravel()], axis=1), np.full((64, 3), 0.15), np.ones((64, 3))
    )
    layers = [Layer("ground", ground), Layer("wall", wall), Layer("window", window)]
    layers += [Layer(f"lamp {k}", bulb(place)) for k, (place, _) in enumerate(lamps)]
    stars = bulb(np.array([0.0, 0.0, 90.0]), radius_m=0.2)
    return Scene("night", (*layers, Layer("sky", stars, kind="sky")), ground_m=0.0)


def in_half_meters(scene: Scene) -> Scene:
    """The same scene in half meters with y up."""
    to_scene = np.eye(4)
    to_scene[:3, :3] = 2 * np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    layers = tuple(replace(layer, to_scene=to_scene @ layer.to_scene) for layer in scene.layers)
    return replace(scene, layers=layers, metres_per_unit=0.5, up=(0.0, 1.0, 0.0))
