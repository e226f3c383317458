"""Domes of flat Gaussians that show a sky, and skies as pictures that they get their colors from."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Float64

from .gaussians import Gaussians, sh_from_color
from .scene import Layer

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


# Skies as pictures

_PICTURE_GAUSSIANS = 150_000
"""Of the dome that shows a picture, 0.3 degrees apart: 39 dB of a picture beside one sampled pixel by pixel."""


def dome_layer(
    colors: Callable[[Float64[np.ndarray, "n 3"]], Float32[np.ndarray, "n 3"]], surroundings: Sequence[Layer]
) -> Layer:
    """Layer of a dome around layers, in meters, with display colors by direction."""
    around = Gaussians.concatenate([each.gaussians for each in surroundings])
    center = np.median(around.means.astype(np.float64), axis=0) if len(around) else np.zeros(3)
    directions = dome_directions(_PICTURE_GAUSSIANS)
    radius = dome_radius(around, center, is_metric=True)
    shown = np.clip(colors(directions), 0, 1)
    name = "sky dome" if any(each.name == "sky" for each in surroundings) else "sky"
    return Layer(name, dome_gaussians(directions, shown, center, radius), "sky")


def checked_cubemap(values: Any) -> Float32[np.ndarray, "6 s s 3"]:
    """Six square faces of finite colors. Raises `ValueError` for anything else."""
    cubemap: Any = np.asarray(values, np.float32).reshape(np.shape(values)[-4:])
    if cubemap.ndim != 4 or cubemap.shape != (6, cubemap.shape[1], cubemap.shape[1], 3) or not cubemap.size:
        raise ValueError(f"a cubemap has 6 square faces of 3 colors, not {'x'.join(map(str, np.shape(values)))}")
    if not np.isfinite(cubemap).all():
        raise ValueError("its cubemap has colors that are not finite numbers")
    return cubemap


def sample_cubemap(
    cubemap: Float32[np.ndarray, "6 s s 3"], directions: Float64[np.ndarray, "n 3"]
) -> Float32[np.ndarray, "n 3"]:
    """Colors in directions of any length, bilinear within a face: faces +x, -x, +y, -y, +z, -z (OpenGL 4.6, 8.13)."""
    axis = np.abs(directions).argmax(axis=1)
    major = np.take_along_axis(directions, axis[:, None], axis=1)[:, 0]
    face = 2 * axis + (major < 0)
    x, y, z = directions.T
    s = np.choose(face, [-z, z, x, x, x, -x])
    t = np.choose(face, [-y, -y, z, -z, -y, -y])
    size = cubemap.shape[1]
    column, row = (np.clip((each / np.abs(major) + 1) / 2 * size - 0.5, 0, size - 1) for each in (s, t))
    left, top = np.floor(column).astype(np.int64), np.floor(row).astype(np.int64)
    right, bottom = np.minimum(left + 1, size - 1), np.minimum(top + 1, size - 1)
    across, down = (column - left)[:, None].astype(np.float32), (row - top)[:, None].astype(np.float32)
    upper = cubemap[face, top, left] * (1 - across) + cubemap[face, top, right] * across
    lower = cubemap[face, bottom, left] * (1 - across) + cubemap[face, bottom, right] * across
    return upper * (1 - down) + lower * down


def sample_panorama(
    picture: Float32[np.ndarray, "h w 3"], directions: Float64[np.ndarray, "n 3"]
) -> Float32[np.ndarray, "n 3"]:
    """Colors of an equirectangular picture in directions with z up, bilinear.

    Its top is overhead, its middle column ahead (+x), and what is on the left of it is to the left (+y).
    """
    height, width = picture.shape[:2]
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    column = (0.5 - np.arctan2(unit[:, 1], unit[:, 0]) / (2 * np.pi)) * width - 0.5
    row = np.clip(np.arccos(np.clip(unit[:, 2], -1, 1)) / np.pi * height - 0.5, 0, height - 1)
    left, top = np.floor(column).astype(np.int64), np.floor(row).astype(np.int64)
    across, down = (column - left)[:, None].astype(np.float32), (row - top)[:, None].astype(np.float32)
    bottom = np.minimum(top + 1, height - 1)
    columns = left % width, (left + 1) % width
    upper, lower = ((1 - across) * picture[r, columns[0]] + across * picture[r, columns[1]] for r in (top, bottom))
    return upper * (1 - down) + lower * down
