import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.render.cpu.projection import project
from gsrain_engine.render.cpu.tiles import TILE, bin_into_tiles
from gsrain_engine.scene.scene import DrawItem

from .raster_scenes import random_gaussians, small_camera


def power_above_the_cut(shape: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """ln(alpha / cut) of one splat at places u across and v down, float64."""
    x, y, shear, sharpness_x, sharpness_y, log_opacity, log_cut, _ = shape.astype(np.float64)
    dx = u - x
    return log_opacity - log_cut + sharpness_x * dx**2 + sharpness_y * (v[:, None] - y - shear * dx) ** 2


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), stretch=st.sampled_from([1.0, 8.0]))
def test_a_tile_is_listed_exactly_where_the_ellipse_touches_it(seed, stretch):
    gaussians = random_gaussians(12, seed)
    gaussians.scales[:, 0] *= stretch
    camera = small_camera(90, 70)
    splats = project([DrawItem(gaussians, np.eye(4))], camera)
    tiles = bin_into_tiles(splats.shapes, splats.nearest_first(), 90, 70)
    listed = [set(tiles.members[a:b].tolist()) for a, b in zip(tiles.starts[:-1], tiles.starts[1:], strict=True)]
    for n in splats.nearest_first():
        for tile, members in enumerate(listed):
            row, column = divmod(tile, tiles.columns)
            pixels, dense = np.arange(TILE) + 0.5, np.linspace(0.48, TILE - 0.48, 400)
            if power_above_the_cut(splats.shapes[n], column * TILE + pixels, row * TILE + pixels).max() > 1e-4:
                assert n in members
            if n in members:  # the ellipse meets the rectangle of the pixel centers (0.02 px of slack)
                power = power_above_the_cut(splats.shapes[n], column * TILE + dense, row * TILE + dense)
                assert power.max() > -1e-2


def test_lists_keep_the_order_of_the_splats():
    splats = project([DrawItem(random_gaussians(4000, 1), np.eye(4))], small_camera(300, 200))
    order = splats.nearest_first()
    tiles = bin_into_tiles(splats.shapes, order, 300, 200)
    places = np.empty(len(splats), int)
    places[order] = np.arange(len(order))
    assert tiles.starts[-1] == len(tiles.members) > 4000
    assert (np.diff(splats.colors[order, 3]) >= 0).all()
    assert (np.diff(splats.indices) > 0).all()
    for a, b in zip(tiles.starts[:-1], tiles.starts[1:], strict=True):
        assert (np.diff(places[tiles.members[a:b]]) > 0).all()
