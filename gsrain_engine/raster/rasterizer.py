"""Draws Gaussians on the CPU: project each once, sort by depth, bin into tiles, composite."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32

from gsrain_engine.render.frame import Frame
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.members import Part

from .compositing import composite
from .projection import project
from .tiles import bin_into_tiles

ALPHA_OF_NOTHING = 1e-3
"""Where alpha is below this there is nothing whose depth could be told."""


def rasterize(
    parts: Sequence[Part], camera: Camera, rain: Sequence[Bool[np.ndarray, " _"] | None] | None = None
) -> Frame:
    """Render parts as `camera` (in the world, metres) sees them.

    Premultiplied display colour over nothing, and the expected depth in metres (mean over alpha, 0 where there is
    nothing). `rain` flags the rain among each part's Gaussians, see `project`. The same inputs give the same bytes at
    any number of threads.
    """
    splats = project(parts, camera, rain)
    tiles = bin_into_tiles(splats.shapes, splats.nearest_first(), camera.width, camera.height)
    rgba, weighted_depth = composite(splats.shapes, splats.colors, tiles)
    return Frame(rgba, expected(weighted_depth, rgba[..., 3]))


def expected(weighted: Float32[np.ndarray, "h w"], weight: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Mean of a blended channel over what was blended; 0 where there is nothing."""
    nothing = np.float32(ALPHA_OF_NOTHING)
    return np.where(weight > nothing, weighted / np.maximum(weight, nothing), np.float32(0))
