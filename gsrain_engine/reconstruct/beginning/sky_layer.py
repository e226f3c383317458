"""The sky as a dome of Gaussians far around a scene, in the colours that the views show above it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.spatial import KDTree

from gsrain_engine.datasets.capture import Capture, View
from gsrain_engine.datasets.pixels.measured_depth import measured_depths
from gsrain_engine.datasets.pixels.sky_pixels import sky_masks
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.rotations import normalized

from .point_colors import projected

SKY_GAUSSIANS = 8000
"""On the upper half of the dome they are 1.6 degrees apart: clouds, not leaves."""
_LOWEST = float(np.sin(np.radians(-3.0)))
"""The dome reaches a little below the horizon: streets end before it."""
_SPREAD, _THICKNESS, _OPACITY = 0.75, 0.02, 0.98
"""Sigma along the dome over the spacing of directions, and across it over the same."""
_BEYOND = 3.0
"""Radius of the dome over the distance of what is far in the scene."""
_LEAST_RADIUS = 400.0
"""In metres, where lengths are metres."""
_SAMPLES = 3
"""Window of pixels, in each direction, whose mean is a direction's colour in one view."""


def initial_sky(
    capture: Capture,
    views: Sequence[View],
    surface: Gaussians,
    skies: Sequence[Bool[np.ndarray, "_ _"]] | None = None,
    count: int = SKY_GAUSSIANS,
) -> Gaussians:
    """Make a dome around the scene, of about `count` Gaussians; none where no view shows any sky.

    Where views show sky, a direction has their median colour; elsewhere that of its neighbours, smoother the farther
    away they are, so that someone who looks up or back sees a sky too.

    Args:
        capture: Tells which way is up, and whether lengths are metres.
        views: Without distortion.
        surface: The scene under the dome, in the capture's world.
        skies: Pixels of each view that show the sky; found by `sky_masks` where not given.
        count: How many Gaussians cover the dome.
    """
    if skies is None:
        skies = sky_masks(views, measured_depths(capture, views), capture.up)
    if not any(sky.any() for sky in skies):
        return Gaussians.empty()
    center = np.mean([view.camera.position for view in views], axis=0)
    radius = dome_radius(surface, center, capture.is_metric)
    directions = dome_directions(count, capture.up)
    colors = _colors(directions, center + radius * directions, views, skies)
    return _dome(directions, center, radius, colors)


def dome_radius(surface: Gaussians, center: Float64[np.ndarray, "3"], is_metric: bool) -> float:
    """How far away the sky stands: well beyond everything else, so that nothing of the scene is behind it."""
    far = float(np.quantile(np.linalg.norm(surface.means - center, axis=1), 0.995)) if len(surface) else 1.0
    return max(_BEYOND * far, _LEAST_RADIUS) if is_metric else _BEYOND * far


def dome_directions(count: int, up: tuple[float, float, float]) -> Float64[np.ndarray, "n 3"]:
    """Evenly spread unit vectors above the lowest elevation: a Fibonacci lattice on the sphere's upper part."""
    height = _LOWEST + (1 - _LOWEST) * (np.arange(count) + 0.5) / count
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - height**2)
    axis = np.array(up, np.float64) / np.linalg.norm(up)
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(axis, side), axis])
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1) @ frame


def _colors(
    directions: Float64[np.ndarray, "n 3"],
    places: Float64[np.ndarray, "n 3"],
    views: Sequence[View],
    skies: Sequence[Bool[np.ndarray, "_ _"]],
) -> Float32[np.ndarray, "n 3"]:
    """Median over the views that show a direction's sky; elsewhere the mean of known ones, weighted by nearness."""
    samples: list[list[np.ndarray]] = [[] for _ in directions]
    reach = range(-(_SAMPLES // 2), _SAMPLES // 2 + 1)
    for view, sky in zip(views, skies, strict=True):
        index, row, column, _ = projected(places, view.camera)
        image, weight, total = view.image, np.zeros(len(index)), np.zeros((len(index), 3))
        for down in reach:
            for right in reach:
                r = np.clip(row + down, 0, sky.shape[0] - 1)
                c = np.clip(column + right, 0, sky.shape[1] - 1)
                weight += sky[r, c]
                total += sky[r, c, None] * image[r, c]
        for k in np.flatnonzero(weight >= _SAMPLES**2 / 2):
            samples[index[k]].append(total[k] / weight[k])
    known = np.array([bool(each) for each in samples])
    colors = np.zeros((len(directions), 3), np.float32)
    if not known.any():  # specks of sky between the directions
        all_sky = np.concatenate([view.image[sky] for view, sky in zip(views, skies, strict=True)])
        return np.broadcast_to(np.median(all_sky, axis=0).astype(np.float32) / 255, colors.shape).copy()
    colors[known] = [np.median(each, axis=0) / 255 for each in samples if each]
    colors[~known] = _spread_out(directions[known], colors[known], directions[~known])
    return colors


def _spread_out(
    known: Float64[np.ndarray, "k 3"], colors: Float32[np.ndarray, "k 3"], wanted: Float64[np.ndarray, "m 3"]
) -> Float32[np.ndarray, "m 3"]:
    if not len(wanted):
        return np.zeros((0, 3), np.float32)
    distance, index = KDTree(known).query(wanted, min(64, len(known)))
    distance, index = distance.reshape(len(wanted), -1), index.reshape(len(wanted), -1)
    weight = 1 / np.maximum(distance, 1e-6) ** 2
    return ((weight[..., None] * colors[index]).sum(axis=1) / weight.sum(axis=1)[:, None]).astype(np.float32)


def _dome(
    directions: Float64[np.ndarray, "n 3"],
    center: Float64[np.ndarray, "3"],
    radius: float,
    colors: Float32[np.ndarray, "n 3"],
) -> Gaussians:
    n = len(directions)
    spacing = radius * np.sqrt(2 * np.pi * (1 - _LOWEST) / n)
    # The turn that takes x to the direction: half way between both (1 + cos, axis * sin).
    turns = np.stack([1 + directions[:, 0], np.zeros(n), -directions[:, 2], directions[:, 1]], axis=1)
    turns[turns[:, 0] < 1e-6] = [0, 0, 0, 1]
    return Gaussians(
        (center + radius * directions).astype(np.float32),
        np.tile(np.array([_THICKNESS, 1, 1]) * _SPREAD * spacing, (n, 1)).astype(np.float32),
        normalized(turns).astype(np.float32),
        np.full(n, _OPACITY, np.float32),
        sh_from_color(colors),
    )
