"""Backdrop: what stands still before a still camera, drawn once, and what moves in front of it, in each picture.

What moves, drops above all, is composited as usual, but meets the backdrop as one surface in each pixel, at its
expected depth. Where the scene's edges are soft or thin this is an approximation, for pictures that must be fast rather
than exact: the cost of a picture no longer depends on the size of the scene.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32

from ...fast_math import FAST
from ...kernels import kernel
from ...rain.medium import RainMedium
from ...scene.camera import Camera
from ...scene.scene import DrawItem
from .block_cache import BlockCaches
from .compositing import (
    FILM,
    NO_ALPHA,
    NO_SKY,
    OPEN,
    RAIN_LINES,
    RAIN_SHARE,
    SCENE_SHARE,
    Film,
    SkyLayer,
    composite_wet,
    dim_by_medium,
    expected,
    film_of_splats,
    open_to_rain,
    sky_layer,
    store_rain,
)
from .projection import project
from .splats import Splats
from .tiles import TILE, TileLists, absorb, bin_into_tiles, is_rain, walk_columns, walk_rows

_MIN_ALPHA = np.float32(1e-3)  # below which a pixel of the backdrop has no depth: nothing is behind it


@dataclass(frozen=True, slots=True, eq=False)
class Backdrop:
    """Picture of a still scene without rain, in its medium."""

    rgba: Float32[np.ndarray, "h w 4"]
    """Premultiplied display color and alpha, without the sky's layer."""
    depth: Float32[np.ndarray, "h w"]
    """Expected depth along the view axis in meters; infinite where the scene is empty."""
    film: Float32[np.ndarray, "h w 2"]
    """Visible shares of films and standing water."""
    sky: SkyLayer
    """Layer of the medium behind the scene."""
    gaussians: int
    """Number of Gaussians that were considered."""


def draw_backdrop(
    parts: Sequence[DrawItem],
    camera: Camera,
    medium: RainMedium | None,
    checkpoint: Callable[[], None] = lambda: None,
    caches: BlockCaches | None = None,
) -> Backdrop:
    """Draw the parts of a scene that stand still, with `film` where they hold water.

    `checkpoint` is called between the stages; `caches` are those of `project`.
    """
    splats = project(parts, camera, caches=caches)
    if medium is not None:
        dim_by_medium(splats, camera, medium, is_linear=True)
    checkpoint()
    tiles = bin_into_tiles(splats.shapes, splats.nearest_first(), camera.width, camera.height)
    checkpoint()
    film = Film.on(film_of_splats(splats, parts), tiles)
    rgba, weighted = composite_wet(splats.shapes, splats.colors, tiles, film)
    depth = expected(weighted, rgba[..., 3], _MIN_ALPHA)
    depth[depth <= 0] = np.inf
    sky = NO_SKY if medium is None else sky_layer(medium, camera)
    return Backdrop(rgba, depth, film.visible, sky, sum(part.drawn_count for part in parts))


def composite_over(
    splats: Splats, tiles: TileLists, light_linear: Float32[np.ndarray, "3"], backdrop: Backdrop
) -> tuple[Float32[np.ndarray, "h w 4"], Float32[np.ndarray, "h w 2"]]:
    """Composite splats of moving parts and of rain, in their own medium, with a backdrop.

    A splat behind the backdrop keeps the share that the backdrop leaves open. Returns the premultiplied picture, rain's
    light being added in linear light as in `composite_in_rain`, and the visible shares of water.
    """
    height, width = tiles.height, tiles.width
    rgba, visible = np.empty((height, width, 4), np.float32), np.empty((height, width, 2), np.float32)
    fourth = np.empty((height, width), np.float32)
    images = rgba, fourth, visible, NO_ALPHA, light_linear, *backdrop.sky
    _composite_over(tiles, splats.shapes, splats.colors, (*images, backdrop.rgba, backdrop.depth, backdrop.film))
    return rgba, visible


# Lines of a tile's column as in rain, and two more: depth and alpha of the backdrop.
_DEPTH, _ALPHA = RAIN_LINES * TILE, (RAIN_LINES + 1) * TILE
_LINES = RAIN_LINES + 2


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _composite_over(portion, tiles, shapes, channels, images):
    walk_columns(portion, tiles, shapes, channels, _LINES, _enter, _visit_over, _store_over, images)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _enter(state, x0, y0, images):
    rgba, depth = images[7], images[8]
    height, width = depth.shape
    open_to_rain(state, x0, y0, images)
    for v in range(min(TILE, height - y0)):
        for u in range(min(TILE, width - x0)):
            state[u, _DEPTH + v] = depth[y0 + v, x0 + u]
            state[u, _ALPHA + v] = rgba[y0 + v, x0 + u, 3]


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _visit_over(line, falloff, channels, j, images):
    if is_rain(falloff):
        walk_rows(line, falloff, _share_rain, (channels[j, 3],))
    else:
        walk_rows(line, falloff, _share_moving, (channels[j, 0], channels[j, 1], channels[j, 2], channels[j, 3]))


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _share_rain(line, v, alpha, data):
    one, none = np.float32(1), np.float32(0)
    left = line[v] * (one - (line[v + _ALPHA] if data[0] > line[v + _DEPTH] else none))
    share = line[v + OPEN] * alpha
    line[v + OPEN] -= share
    line[v + RAIN_SHARE] += share * left
    line[v + SCENE_SHARE] += share * (one - left)


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _share_moving(line, v, alpha, channels):
    one, none = np.float32(1), np.float32(0)
    left = one - (line[v + _ALPHA] if channels[3] > line[v + _DEPTH] else none)
    weight = absorb(line, v, left * alpha)
    line[v + TILE] += weight * channels[0]
    line[v + 2 * TILE] += weight * channels[1]
    line[v + 3 * TILE] += weight * channels[2]
    line[v + 5 * TILE] += weight


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _store_over(state, x0, y0, images):
    back, film = images[7], images[9]
    height, width = film.shape[:2]
    for v in range(min(TILE, height - y0)):
        for u in range(min(TILE, width - x0)):
            left = state[u, v]
            state[u, TILE + v] += left * back[y0 + v, x0 + u, 0]
            state[u, 2 * TILE + v] += left * back[y0 + v, x0 + u, 1]
            state[u, 3 * TILE + v] += left * back[y0 + v, x0 + u, 2]
            state[u, 5 * TILE + v] += left * back[y0 + v, x0 + u, 3]
            state[u, FILM + v] = left * film[y0 + v, x0 + u, 0]
            state[u, FILM + TILE + v] = left * film[y0 + v, x0 + u, 1]
    store_rain(state, x0, y0, images)
