"""Domes of flat Gaussians that show a sky."""

import numpy as np
from jaxtyping import Float, Float64

from .gaussians import Gaussians, sh_from_color

_SPREAD, _THICKNESS, _OPACITY = 0.75, 0.02, 0.98
"""Sigma along and across a dome over the spacing of its Gaussians, and their opacity."""

_BEYOND = 3.0  # radius of a dome over the distance of the scene's far parts
_MIN_RADIUS_M = 400.0
_FAR_SHARE = 0.995  # of the Gaussians that are nearer than the far parts


def dome_radius(surface: Gaussians, center: Float64[np.ndarray, "3"], is_metric: bool) -> float:
    """Radius of a dome around a scene: well beyond everything in it."""
    distances = np.linalg.norm(surface.means - center, axis=1)
    far = float(np.quantile(distances, _FAR_SHARE)) if len(surface) else 1.0
    return max(_BEYOND * far, _MIN_RADIUS_M) if is_metric else _BEYOND * far


def dome_directions(count: int, lowest: float = -1.0) -> Float64[np.ndarray, "n 3"]:
    """Evenly spread unit vectors, z up, that rise at least by `lowest` (-1..1): a Fibonacci lattice."""
    rise = lowest + (1 - lowest) * (np.arange(count) + 0.5) / count
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    level = np.sqrt(1 - rise**2)
    return np.stack([level * np.cos(turn), level * np.sin(turn), rise], axis=1)


def dome_gaussians(
    directions: Float64[np.ndarray, "n 3"],
    colors: Float[np.ndarray, "n 3"],
    center: Float64[np.ndarray, "3"],
    radius: float,
    lowest: float = -1.0,
) -> Gaussians:
    """Flat Gaussians in the directions of `dome_directions`, turned to any axes, with display colors."""
    n = len(directions)
    spacing = radius * np.sqrt(2 * np.pi * (1 - lowest) / n)
    # Rotation from x to the direction: halfway quaternion (1 + cos, axis * sin).
    turns = np.stack([1 + directions[:, 0], np.zeros(n), -directions[:, 2], directions[:, 1]], axis=1)
    turns[turns[:, 0] < 1e-6] = [0, 0, 0, 1]
    return Gaussians(
        (center + radius * directions).astype(np.float32),
        np.tile(np.array([_THICKNESS, 1, 1]) * _SPREAD * spacing, (n, 1)).astype(np.float32),
        (turns / np.linalg.norm(turns, axis=1, keepdims=True)).astype(np.float32),
        np.full(n, _OPACITY, np.float32),
        sh_from_color(colors.astype(np.float32)),
    )
