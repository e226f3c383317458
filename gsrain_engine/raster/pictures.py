"""Splats in tiles -> a picture: of the scene, of scene and rain, or of what the scene is made of."""

import numpy as np
from jaxtyping import Float32, Int32

from gsrain_engine.rain.falling_rain import FallingRain
from gsrain_engine.render.frame import Frame
from gsrain_engine.render.heat_colors import heat_colors
from gsrain_engine.render.look import FARTHEST_M, MOST_FRAGMENTS, NEAREST_M, Look

from .compositing import composite, composite_in_rain, composite_with_veil
from .overdraw import count_fragments
from .splats import Splats
from .surfaces import nearest_surfaces
from .tiles import TileLists, bin_into_tiles

_LEAST_WEIGHT = np.float32(0.5)
"""Pixels that the scene covers less than this have no depth, as in the OpenGL renderer."""


def draw_look(look: Look, splats: Splats, tiles: TileLists, *, with_depth: bool) -> Frame:
    """Draw a scene without rain; depth is that of all splats' blending, whatever the look."""
    if look == "ellipsoids" and not with_depth:
        return Frame(nearest_surfaces(splats.shapes, splats.colors, tiles))
    if look == "overdraw" and not with_depth:
        return Frame(_heat_of_counts(count_fragments(splats.shapes, tiles)))
    rgba, weighted = composite(splats.shapes, splats.colors, tiles)
    depth = _expected_depth(weighted, rgba[..., 3]) if with_depth or look == "depth" else None
    if look == "ellipsoids":
        rgba = nearest_surfaces(splats.shapes, splats.colors, tiles)
    elif look == "overdraw":
        rgba = _heat_of_counts(count_fragments(splats.shapes, tiles))
    elif look == "depth" and depth is not None:
        rgba = _heat_of_depth(depth)
    return Frame(rgba, depth)


def draw_in_rain(
    splats: Splats, order: Int32[np.ndarray, " drawn"], tiles: TileLists, rain: FallingRain, *, with_depth: bool
) -> Frame:
    """Draw scene and rain through each other; `tiles` hold the splats in that order."""
    if rain.mixing == "linear":
        rgba, weighted, weight = composite_in_rain(splats.shapes, splats.colors, rain.light_linear, tiles)
    else:  # one more colour (the paper's form)
        rgba = composite_with_veil(splats.shapes, splats.colors, rain.color.astype(np.float32), tiles)
        if not with_depth:
            return Frame(rgba)
        alone = bin_into_tiles(splats.shapes, order[~splats.is_rain[order]], tiles.width, tiles.height)
        clear, weighted = composite(splats.shapes, splats.colors, alone)
        weight = clear[..., 3]
    return Frame(rgba, _expected_depth(weighted, weight) if with_depth else None)


def _expected_depth(
    weighted: Float32[np.ndarray, "h w"], weight: Float32[np.ndarray, "h w"]
) -> Float32[np.ndarray, "h w"]:
    return np.where(weight > _LEAST_WEIGHT, weighted / np.maximum(weight, _LEAST_WEIGHT), np.float32(0))


def _heat_of_depth(depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w 4"]:
    t = np.log(np.maximum(depth, np.float32(1e-9)) / NEAREST_M) / np.log(FARTHEST_M / NEAREST_M)
    return _heat_where(t.astype(np.float32), depth > 0)


def _heat_of_counts(counts: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w 4"]:
    return _heat_where(counts / np.float32(MOST_FRAGMENTS), counts > 0)


def _heat_where(numbers: Float32[np.ndarray, "h w"], there: np.ndarray) -> Float32[np.ndarray, "h w 4"]:
    return np.where(there[..., None], np.dstack([heat_colors(numbers), np.ones_like(numbers)]), np.float32(0))
