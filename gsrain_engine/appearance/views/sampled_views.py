"""Views around a scene of which nothing is known but its Gaussians. World frame (metres, z up)."""

import numpy as np
from jaxtyping import Float

from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.scene import Scene

from .placed_camera import PlacedCamera

EYE_HEIGHT_M = 1.6
_FIELD_OF_VIEW_DEG = 60.0
_RING = 2.2
"""Distance of the ring from the middle, in half diagonals of what is seen."""


def around_the_middle(scene: Scene, count: int) -> list[PlacedCamera]:
    """Look outwards from the middle and inwards from a ring, in turn: one of the two suits a street, one an object."""
    middle, reach = _robust_extent(scene)
    placed: list[PlacedCamera] = []
    for i in range(count):
        angle = 2 * np.pi * i / count
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        ring = middle + _RING * reach * outward + np.array([0, 0, 0.3 * reach])
        eye, target = (middle, middle + outward) if i % 2 else (ring, middle)
        pose = look_at(eye, target, np.array([0.0, 0.0, 1.0]))
        placed.append(PlacedCamera(f"around_{i:03d}", Camera.from_fov(960, 640, _FIELD_OF_VIEW_DEG, pose)))
    return placed


def _robust_extent(scene: Scene) -> tuple[Float[np.ndarray, "3"], float]:
    """Middle of the box that holds the visible Gaussians but the outer twentieths, and half its diagonal.

    In metres; sky is left out; the middle is at eye height where the ground is known.
    """
    layers = [layer for layer in scene.layers if layer.visible and layer.kind != "sky"]
    parts = [part for layer in layers if (part := scene.part(layer)) is not None]
    places = [part.remaining.means @ part.to_world[:3, :3].T + part.to_world[:3, 3] for part in parts]
    points = np.concatenate([np.zeros((0, 3)), *places])
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return np.array([0.0, 0.0, EYE_HEIGHT_M]), 1.0
    low, high = np.quantile(points, [0.05, 0.95], axis=0)
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low) / 2)
    if scene.ground_m is not None:
        middle[2] = scene.ground_m + EYE_HEIGHT_M
    return middle, max(reach, 1e-3)
