"""Skies as cubemaps, sampled as OpenGL and nvdiffrast do."""

from typing import Any

import numpy as np
from jaxtyping import Float32, Float64

from gsrain_engine.scene.formats.tensors import array_of
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Layer
from gsrain_engine.scene.sky_dome import dome_directions, dome_gaussians, dome_radius

_DOME_GAUSSIANS = 60_000
"""Of the dome that shows a cubemap, half a degree apart."""


def cubemap_layer(base: Any, turn: Float64[np.ndarray, "3 3"], surroundings: Gaussians) -> Layer:
    """Layer of a dome in the colors of a cubemap (6, size, size, 3), into whose axes `turn` leads directions."""
    cubemap = array_of(base)
    if cubemap.ndim != 4 or cubemap.shape[0] != 6 or cubemap.shape[3] != 3 or not cubemap.shape[1] == cubemap.shape[2]:
        raise ValueError(f"a cubemap has 6 square faces of 3 colors, not {'x'.join(map(str, cubemap.shape))}")
    if not np.isfinite(cubemap).all():
        raise ValueError("its cubemap has colors that are not finite numbers")
    directions = dome_directions(_DOME_GAUSSIANS)
    colors = np.clip(sample_cubemap(cubemap, directions @ turn.T), 0, 1)
    means = surroundings.means.astype(np.float64)
    center = np.median(means, axis=0) if len(means) else np.zeros(3)
    radius = dome_radius(surroundings, center, is_metric=True)
    return Layer("sky", dome_gaussians(directions, colors, center, radius), "sky")


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
