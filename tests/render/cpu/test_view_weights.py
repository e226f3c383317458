from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.render.cpu.compositing import color_operator
from gsrain_engine.render.cpu.fast_math import harmonics
from gsrain_engine.render.cpu.projection import view_directions
from gsrain_engine.scene.gaussians import sh_from_color
from gsrain_engine.scene.scene import DrawItem
from oracles.rasterizer import rasterize_slowly, sh_basis_slowly
from rasterized import rasterize

from .raster_scenes import at_each_thread_count, random_gaussians, small_camera


def scene(count=2000, seed=0, **fields):
    return [DrawItem(replace(random_gaussians(count, seed, 1), **fields), np.eye(4))]


@pytest.mark.parametrize(("seed", "opacity"), [(0, None), (1, 0.98), (2, 0.01)])
def test_blending_and_accumulating_are_transposes_of_each_other(seed, opacity):
    fields = {} if opacity is None else {"opacities": np.full(2000, opacity, np.float32)}
    parts, camera = scene(2000, seed, **fields), small_camera(200, 130)
    weights = color_operator(parts, camera)
    own = weights.blend(weights.splats.colors)
    np.testing.assert_array_equal(own[..., :3], rasterize(parts, camera).rgba[..., :3])
    np.testing.assert_array_equal(own[..., :3], weights.blend(weights.splats.colors[:, :3]))
    r = np.random.default_rng(seed)
    colors = r.normal(size=(len(weights.splats), 3)).astype(np.float32)
    image = r.normal(size=(130, 200, 3)).astype(np.float32)
    forward = np.vdot(weights.blend(colors).astype(np.float64), image)
    backward = np.vdot(colors.astype(np.float64), weights.accumulate(image))
    scale = np.linalg.norm(weights.blend(colors)) * np.linalg.norm(image)
    assert abs(forward - backward) < 1e-6 * scale
    colors, image = np.abs(colors), np.abs(image)
    forward = np.vdot(weights.blend(colors).astype(np.float64), image)
    assert forward == pytest.approx(np.vdot(colors.astype(np.float64), weights.accumulate(image)), rel=1e-6)
    assert len(at_each_thread_count(lambda: weights.accumulate(image).tobytes())) == 1


def test_squared_sums_are_the_diagonal_of_the_normal_matrix():
    camera = small_camera(40, 30)
    one_by_one = scene(12, 3)
    weights = color_operator(one_by_one, camera)
    for n in range(len(weights.splats)):
        unit = np.zeros((len(weights.splats), 1), np.float32)
        unit[n] = 1
        assert weights.squared_sums()[n] == pytest.approx(float((weights.blend(unit) ** 2).sum()), rel=1e-5)


def test_weights_of_one_splat_are_the_references():
    camera = small_camera(40, 30)
    parts = scene(30, 4)
    gaussians = parts[0].gaussians
    for row in (0, 11, 29):
        colors = np.zeros((30, 3), np.float32)
        colors[row] = 1
        white = gaussians.with_sh(sh_from_color(colors))
        weights = color_operator(parts, camera)
        unit = (weights.splats.indices == row).astype(np.float32)[:, None]
        slow = rasterize_slowly([DrawItem(white, np.eye(4))], camera)[..., 0]
        np.testing.assert_allclose(weights.blend(unit)[..., 0], slow, atol=2e-4)


def test_directions_are_in_each_parts_own_frame():
    turned = np.array([[0, -2, 0, 1], [2, 0, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]], float)
    camera = small_camera()
    parts = [*scene(5), DrawItem(random_gaussians(7, 1, 0), turned)]
    indices = np.array([11, 0, 4, 5], np.int64)
    directions = view_directions(parts, camera, indices)
    world = turned[:3, :3] / 2 @ directions[0]
    mean = turned[:3, :3] @ parts[1].gaussians.means[6] + turned[:3, 3]
    np.testing.assert_allclose(world, mean / np.linalg.norm(mean), atol=1e-6)
    first = parts[0].gaussians.means[4]
    np.testing.assert_allclose(directions[2], first / np.linalg.norm(first), atol=1e-6)


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_harmonics_agree_with_the_reference(coefficients):
    directions = np.random.default_rng(0).normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    fast = harmonics(directions.astype(np.float32), coefficients)
    np.testing.assert_allclose(fast, sh_basis_slowly(directions)[:, :coefficients], atol=2e-6)
