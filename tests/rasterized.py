"""Parts drawn by the engine's own kernels, also with a part of their Gaussians flagged as rain."""

from collections.abc import Sequence

import numpy as np

from gsrain_engine.render.cpu.compositing import composite, expected
from gsrain_engine.render.cpu.projection import project
from gsrain_engine.render.cpu.tiles import bin_into_tiles
from gsrain_engine.render.renderer import Frame
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import DrawItem


def rasterize(parts: Sequence[DrawItem], camera: Camera, rain: Sequence[np.ndarray | None] | None = None) -> Frame:
    """Premultiplied display color over nothing, and the expected depth (m), where alpha is over 1e-3."""
    splats = project(parts, camera, rain)
    tiles = bin_into_tiles(splats.shapes, splats.nearest_first(), camera.width, camera.height)
    rgba, weighted_depth = composite(splats.shapes, splats.colors, tiles)
    return Frame(rgba, expected(weighted_depth, rgba[..., 3]))
