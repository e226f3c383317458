"""Selection in the image: shapes, and the Gaussians in them."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.editor.selection.screen import (
    DepthMode,
    polygon,
    rectangle,
    select_in_screen_shape,
    stroke,
)

from .selection_scenes import HEIGHT, WIDTH, cloud, pixels_of, shot_at, two_walls, world_means

W, H = 40, 30
places = st.tuples(st.integers(-1300, 3900), st.integers(-1300, 3300)).map(lambda xy: (xy[0] / 65, xy[1] / 65))


X, Y = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)


def distance_to_line(points):
    """From the centers of pixels."""
    nearest = np.full((H, W), np.inf)
    for (x0, y0), (x1, y1) in pairwise(points):
        length = max((x1 - x0) ** 2 + (y1 - y0) ** 2, 1e-12)
        t = np.clip(((X - x0) * (x1 - x0) + (Y - y0) * (y1 - y0)) / length, 0, 1)
        nearest = np.minimum(nearest, np.hypot(X - x0 - t * (x1 - x0), Y - y0 - t * (y1 - y0)))
    return nearest


@given(st.lists(places, min_size=3, max_size=12))
def test_polygon_is_even_odd_at_the_centers_of_pixels(corners):
    closed, inside = [*corners, corners[0]], np.zeros((H, W), bool)
    for (x0, y0), (x1, y1) in pairwise(closed):
        if y0 != y1:
            crosses = (y0 <= Y) != (y1 <= Y)
            inside ^= crosses & (x0 + (Y - y0) / (y1 - y0) * (x1 - x0) > X)
    clear = distance_to_line(closed) > 1e-6
    assert np.array_equal(polygon(corners, W, H)[clear], inside[clear])


@given(st.lists(places, min_size=1, max_size=6), st.floats(2, 15))
def test_stroke_is_what_is_near_the_line(points, radius):
    distance = distance_to_line([*points, points[-1]])
    drawn = stroke(points, radius, W, H)
    assert drawn[distance < radius - 1].all()
    assert not drawn[distance > radius + 1].any()


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.sampled_from([(0.0, -12, 3), (1.0, 1, 0.5), (5.0, 2, -3)]), st.floats(0.3, 30))
def test_centers_as_the_slow_way_finds_them(seed, eye, depth_m):
    scene, shot = cloud(seed=seed % 7), shot_at(eye)
    pixels = np.random.default_rng(seed).random((HEIGHT, WIDTH)) < 0.5
    found = select_in_screen_shape(scene, shot, pixels, DepthMode("to a depth", depth_m))
    assert set(found) == {"layers/plain", "layers/turned"}
    for key, mask in found.items():
        u, v, z = pixels_of(world_means(scene, key), shot.camera).T
        ok = (z > 0.2) & (z <= depth_m) & (u >= 0) & (u < WIDTH) & (v >= 0) & (v < HEIGHT)
        expected = np.zeros(len(u), bool)
        expected[ok] = pixels[v[ok].astype(int), u[ok].astype(int)]
        # A pixel's edge, or the limits of depth, may round either way.
        near = (np.abs(u - np.round(u)) < 1e-3) | (np.abs(v - np.round(v)) < 1e-3)
        clear = ~near & (np.abs(z - depth_m) > 1e-4) & (np.abs(z - 0.2) > 1e-4)
        assert np.array_equal(mask.flags[clear], expected[clear])


def test_touching_takes_more_than_centers_and_nothing_far_away():
    scene, shot = two_walls(6), shot_at((0.0, -8, 0))
    strip = rectangle((40, 30), (44, 34), WIDTH, HEIGHT)
    centers = select_in_screen_shape(scene, shot, strip)["layers/front"]
    touched = select_in_screen_shape(scene, shot, strip, DepthMode(touching=True))["layers/front"]
    assert touched.size > centers.size
    assert not (centers - touched)
    u, v, z = pixels_of(world_means(scene, "layers/front")[touched.indices], shot.camera).T
    largest_px = scene.layers[0].gaussians.scales.max() * shot.camera.fx / z.min() + 1
    assert np.all((u > 40 - largest_px) & (u < 44 + largest_px) & (v > 30 - largest_px) & (v < 34 + largest_px))


def test_front_most_leaves_what_is_behind_a_wall_alone():
    scene, shot = two_walls(), shot_at((0.0, -8, 0))
    middle = rectangle((34, 22), (62, 42), WIDTH, HEIGHT)  # well inside the front wall
    through, front = (
        select_in_screen_shape(scene, shot, middle, DepthMode(depths)) for depths in ("all through", "front-most")
    )
    assert through["layers/back"].size > 10
    assert front["layers/back"].size == 0
    assert front["layers/front"].size > 0.9 * through["layers/front"].size > 10
