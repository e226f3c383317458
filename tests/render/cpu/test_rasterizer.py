from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.fast_math import harmonics
from gsrain_engine.render.cpu.compositing import color_operator
from gsrain_engine.render.cpu.projection import project, view_directions
from gsrain_engine.render.cpu.splats import FEW, nearest_first
from gsrain_engine.render.cpu.tiles import TILE, bin_into_tiles
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import DrawItem
from oracles.rasterizer import rasterize_slowly, sh_basis_slowly
from rasterized import rasterize

from .raster_scenes import at_each_thread_count, random_gaussians, similarity, small_camera

HERE = np.eye(4)


def moved(gaussians: Gaussians, to_world: np.ndarray) -> DrawItem:
    """Put Gaussians elsewhere in their own frame so that `to_world` brings their means back."""
    rotation = to_world[:3, :3]
    means = np.linalg.solve(rotation, gaussians.means.T - to_world[:3, 3:]).T.astype(np.float32, order="C")
    return DrawItem(replace(gaussians, means=means), to_world)


def assert_like_the_reference(parts, camera, rain=None) -> None:
    frame = rasterize(parts, camera, rain)
    slow = rasterize_slowly(parts, camera, rain)
    difference = np.abs(frame.rgba - slow[..., :4]).max(axis=-1)
    # A fragment at a cut may fall on either side of it in float32: rarely, and by no more than the cut.
    assert difference.max() < 6e-3
    assert (difference > 1e-4).mean() < 0.005
    solid = slow[..., 3] > 0.05
    expected = slow[solid, 4] / slow[solid, 3]
    error = np.abs(frame.depth[solid] - expected) / expected
    assert np.quantile(error, 0.99) < 1e-3
    assert (frame.depth[slow[..., 3] == 0] == 0).all()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_agrees_with_the_reference_at_every_sh_degree_and_where_parts_are_turned_and_scaled(degree):
    elsewhere = moved(random_gaussians(60, 10 + degree, 3), similarity(0.5 + degree, degree))
    assert_like_the_reference([DrawItem(random_gaussians(150, degree, degree), HERE), elsewhere], small_camera())


def test_agrees_with_the_reference_where_pixels_finish_early():
    gaussians = random_gaussians(400, 3)
    gaussians = replace(gaussians, scales=4 * gaussians.scales, opacities=np.full(400, 0.97, np.float32))
    frame = rasterize([DrawItem(gaussians, HERE)], small_camera())
    assert (1 - frame.rgba[..., 3] < 2e-3).mean() > 0.8  # it does finish
    assert_like_the_reference([DrawItem(gaussians, HERE)], small_camera())


def test_rain_is_cut_later_and_keeps_its_integral():
    gaussians = random_gaussians(60, 4)
    faint = replace(gaussians, scales=gaussians.scales * np.float32(0.02), opacities=gaussians.opacities * 0.02)
    parts = [DrawItem(random_gaussians(40, 2), HERE), DrawItem(faint, HERE)]
    rain = [None, np.arange(60) % 3 > 0]
    assert_like_the_reference(parts, small_camera(), rain)
    alone = rasterize(parts[1:], small_camera(), [np.ones(60, bool)]).rgba[..., 3]
    slow = rasterize_slowly(parts[1:], small_camera(), [np.ones(60, bool)])[..., 3]
    np.testing.assert_allclose(alone, slow, rtol=1e-3, atol=2e-5)
    assert 0 < alone.max() < 1 / 255


def test_equal_depths_keep_their_index():
    numbers = [[0, 0, 3]] * 2, [[0.5] * 3] * 2, [[1, 0, 0, 0]] * 2, [0.9] * 2
    colors = sh_from_color(np.eye(3, dtype=np.float32)[[0, 2]])
    pair, camera = Gaussians(*(np.array(each, np.float32) for each in numbers), colors), small_camera()
    for first, other in ((0, 2), (2, 0)):
        gaussians = pair.take(np.array([first // 2, other // 2]))
        center = rasterize([DrawItem(gaussians, HERE)], camera).rgba[int(camera.cy), int(camera.cx)]
        assert center[first] > 0.8 > 0.2 > center[other]


@pytest.mark.parametrize("farthest", [1.0, 3e38])
def test_many_depths_are_sorted_stably_at_any_thread_count(farthest):
    depths = np.random.default_rng(1).integers(0, 5000, 3 * FEW).astype(np.float32) / 5000 * np.float32(farthest)
    drawn = np.flatnonzero(depths)
    expected = drawn[np.argsort(depths[drawn], kind="stable")]
    assert 2 * FEW < len(expected) < len(depths)
    assert at_each_thread_count(lambda: nearest_first(depths).tobytes()) == {expected.astype(np.int32).tobytes()}
    assert len(nearest_first(np.zeros(FEW, np.float32))) == 0
    assert nearest_first(np.full(FEW, farthest, np.float32)).tolist() == list(range(FEW))


def test_reference_harmonics_are_orthonormal_and_signed_as_in_3dgs():
    z, weight = np.polynomial.legendre.leggauss(8)
    phi, height = np.meshgrid((np.arange(16) + 0.5) * np.pi / 8, z)
    across = np.sqrt(1 - height**2)
    basis = sh_basis_slowly(np.stack([across * np.cos(phi), across * np.sin(phi), height], axis=-1))
    np.testing.assert_allclose(np.einsum("zpi,zpj,z->ij", basis, basis, weight) * np.pi / 8, np.eye(16), atol=1e-12)
    assert (sh_basis_slowly(np.eye(3))[[1, 2, 0], [1, 2, 3]] * [-1, 1, -1] > 0).all()


def test_a_limit_draws_the_first_ones_and_indices_count_all():
    parts = [DrawItem(random_gaussians(80, 1, 1), HERE, 30), DrawItem(random_gaussians(50, 2), HERE)]
    cut = [DrawItem(parts[0].gaussians.take(slice(0, 30)), HERE), parts[1]]
    camera = small_camera()
    np.testing.assert_array_equal(rasterize(parts, camera).rgba, rasterize(cut, camera).rgba)
    splats, whole = project(parts, camera), project([DrawItem(part.gaussians, HERE) for part in parts], camera)
    kept = (whole.indices < 30) | (whole.indices >= 80)
    assert 0 < kept.sum() < len(kept)
    np.testing.assert_array_equal(splats.indices, whole.indices[kept])
    np.testing.assert_array_equal(splats.shapes, whole.shapes[kept])
    np.testing.assert_array_equal(splats.colors, whole.colors[kept])


def test_memory_is_taken_for_what_may_be_seen_only():
    behind = random_gaussians(500, 1, depth_m=(-9, 0.1))
    aside = random_gaussians(500, 2)
    aside = replace(aside, means=aside.means + np.float32([200, 0, 0]))
    seen = random_gaussians(20, 3)
    assert len(project([DrawItem(each, HERE) for each in (behind, seen, aside)], small_camera())) == 20


@settings(max_examples=30)
@given(seed=st.integers(0, 1000), size=st.sampled_from([1e-3, 0.5, 20.0]), enlarged=st.sampled_from([0.5, 7.0]))
def test_no_gaussian_that_is_seen_is_left_out(seed, size, enlarged):
    g = random_gaussians(200, seed, depth_m=(-2.0, 9.0))
    wide = np.random.default_rng(seed).uniform(-12, 12, (200, 3)).astype(np.float32)
    g = replace(g, means=g.means + wide, scales=g.scales * np.float32(size))
    part, camera = moved(g, similarity(enlarged, seed)), small_camera()
    splats = project([part], camera)
    found = set(splats.indices[splats.nearest_first()].tolist())
    for i in range(0, 200, 7):
        one = DrawItem(part.gaussians.take(np.array([i])), part.to_world)
        if rasterize_slowly([one], camera).any():
            assert i in found


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
