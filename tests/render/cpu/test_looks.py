from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from given_rain import given_rain
from gsrain_engine.choices import RenderMode
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.images import turbo_colors
from gsrain_engine.render.renderer import FARTHEST_M, MAX_FRAGMENTS, NEAREST_M, Frame
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import DrawItem
from oracles.rasterizer import rasterize_slowly

from .raster_scenes import drawn, random_gaussians, small_camera

HERE = np.eye(4)
LOOKS: tuple[RenderMode, ...] = get_args(RenderMode)


def one(
    depth: float = 4.0, opacity: float = 0.8, scales: tuple = (0.5, 0.5, 0.5), color: tuple = (0.2, 0.4, 0.9),
    quaternion: tuple = (1, 0, 0, 0),
) -> Gaussians:  # fmt: skip
    numbers = ([[0, 0, depth]], [scales], [quaternion], [opacity])
    means, scale, turn, alpha = (np.array(each, np.float32) for each in numbers)
    return Gaussians(means, scale, turn, alpha, sh_from_color(np.array([color], np.float32)))


def seen(parts, look: RenderMode, camera: Camera | None = None, **more) -> Frame:
    return drawn(CpuRenderer(), parts, camera=camera or square_camera(), mode=look, **more)


def square_camera() -> Camera:
    """Its principal point is the center of the pixel (20, 20)."""
    return Camera(41, 41, 50.0, 50.0, 20.5, 20.5)


def straight(frame: Frame, row: int = 20, column: int = 20) -> np.ndarray:
    """Color without its alpha."""
    return frame.rgba[row, column, :3] / frame.rgba[row, column, 3]


@pytest.mark.parametrize("look", [look for look in LOOKS if look != "splats"])
def test_looks_show_the_scene_without_rain_and_are_finite(look):
    parts = [DrawItem(random_gaussians(300, 1, 1), HERE), DrawItem(random_gaussians(100, 2), HERE)]
    rain = given_rain(random_gaussians(50, 3), np.ones(3, np.float32), "physical")
    frame = seen(parts, look, small_camera())
    assert np.isfinite(frame.rgba).all()
    assert frame.rgba.max() > 0.3
    assert frame.rgba.tobytes() == seen(parts, look, small_camera(), rain=rain).rgba.tobytes()
    assert frame.rgba.tobytes() == seen(parts, look, small_camera(), with_depth=True).rgba.tobytes()
    assert frame.rgba.tobytes() != seen(parts, "splats", small_camera()).rgba.tobytes()
    assert not seen([], look, small_camera()).rgba.any()


def test_points_are_opaque_dots_of_one_pixel():
    gaussians = one(opacity=0.01, scales=(0.9, 1e-4, 0.3))
    alpha = seen(gaussians, "points").rgba[..., 3]
    v, u = np.mgrid[:41, :41] - 20
    dot = np.minimum(np.exp(-0.5 * (u**2 + v**2)), 0.999)
    np.testing.assert_allclose(alpha, np.where(dot >= 1 / 255, dot, 0), atol=1e-5)
    np.testing.assert_allclose(straight(seen(gaussians, "points")), [0.2, 0.4, 0.9], atol=1e-5)


@pytest.mark.parametrize("opacity", [0.3, 0.8, 1.0])
def test_an_ellipsoid_is_where_alpha_is_a_quarter_and_shaded_like_a_ball(opacity):
    gaussians = one(opacity=opacity, scales=(0.7, 0.3, 0.2))
    rgba = seen(gaussians, "ellipsoids").rgba
    alpha = rasterize_slowly([DrawItem(gaussians, HERE)], square_camera())[..., 3]
    inside = np.abs(alpha - 0.25) > 1e-4
    np.testing.assert_array_equal(rgba[inside, 3], (alpha >= 0.25)[inside])
    shade = 0.5 + 0.5 * np.sqrt(np.clip(1 - np.log(opacity / np.maximum(alpha, 1e-9)) / np.log(4 * opacity), 0, 1))
    body = (rgba[..., 3] > 0) & (alpha < 0.99)
    expected = shade[..., None] * np.array([0.2, 0.4, 0.9])
    np.testing.assert_allclose(rgba[body, :3], expected[body], atol=2e-3)
    assert not rgba[rgba[..., 3] == 0].any()
    assert body.sum() > 5


def test_the_nearest_ellipsoid_covers_and_faint_gaussians_have_none():
    red, blue = one(3.0, 0.5, (0.2, 0.2, 0.2), (1, 0, 0)), one(5.0, 1.0, (2, 2, 2), (0, 0, 1))
    veil = one(2.0, 0.24, (3, 3, 3), (1, 1, 1))
    rgba = seen(Gaussians.concatenate([blue, veil, red]), "ellipsoids").rgba
    assert rgba[20, 20, 0] > 0.9
    assert rgba[20, 20, 2] == 0
    assert rgba[8, 8, 2] > 0.5
    alone = seen(Gaussians.concatenate([veil, red]), "ellipsoids").rgba[..., 3]
    assert set(np.unique(alone)) == {0, 1}


def test_normals_are_the_shortest_axes_turned_to_the_camera():
    half = np.sqrt(0.5)
    flat = {"scales": (0.5, 0.5, 0.01)}
    np.testing.assert_allclose(straight(seen(one(**flat), "normals")), [0.5, 0.5, 0], atol=1e-5)
    # A quarter turn about y, then an eighth: the normal leans by 45 degrees in the x-z plane.
    leaning = one(**flat, quaternion=(np.cos(np.pi / 8), 0, np.sin(np.pi / 8), 0))
    expected = 0.5 + 0.5 * np.array([-half, 0, -half])
    np.testing.assert_allclose(straight(seen(leaning, "normals")), expected, atol=1e-5)
    # The same in a turned and enlarged part, from another place: normals are those of the world.
    turned = np.array([[0, -2, 0, 0], [2, 0, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]], float)
    camera = replace(
        square_camera(), world_to_camera=look_at(np.array([3.0, 0, 5]), np.array([0.0, 0, 8]), np.array([0, 1.0, 0]))
    )
    expected = 0.5 + 0.5 * np.array([0, -half, -half])
    np.testing.assert_allclose(straight(seen([DrawItem(leaning, turned)], "normals", camera)), expected, atol=1e-5)
    splats = seen(leaning, "splats").rgba[..., 3]
    np.testing.assert_array_equal(seen(leaning, "normals").rgba[..., 3], splats)


@pytest.mark.parametrize("depth", [0.5, 3.0, 200.0, 900.0])
def test_depth_is_the_heat_of_its_logarithm(depth):
    frame = seen(one(depth, 1.0, (depth, depth, 0.1)), "depth")
    t = np.float32(np.clip(np.log(depth / NEAREST_M) / np.log(FARTHEST_M / NEAREST_M), 0, 1))
    np.testing.assert_allclose(frame.rgba[20, 20], [*turbo_colors(np.array([t]))[0], 1], atol=1e-4)
    assert frame.depth is not None
    assert frame.depth[20, 20] == pytest.approx(depth, rel=1e-4)
    thin = seen(one(depth, 0.4, (depth, depth, 0.1)), "depth")
    assert not thin.rgba.any()


def test_overdraw_counts_fragments_also_behind_what_is_opaque():
    walls = Gaussians.concatenate([one(2.0 + i, 1.0, (9, 9, 9)) for i in range(40)])
    dot = one(1.0, 1.0, (0.02, 0.02, 0.02))
    rgba = seen(Gaussians.concatenate([walls, dot]), "overdraw").rgba
    colors = turbo_colors(np.array([40, 41], np.float32) / np.float32(MAX_FRAGMENTS))
    np.testing.assert_allclose(rgba[0, 0], [*colors[0], 1], atol=1e-6)
    np.testing.assert_allclose(rgba[20, 20], [*colors[1], 1], atol=1e-6)
    alpha = rasterize_slowly([DrawItem(dot, HERE)], square_camera())[..., 3]
    alone = seen(dot, "overdraw").rgba[..., 3]
    np.testing.assert_array_equal(alone, alpha > 0)
