"""Gaussians as arrays: quaternions, spherical harmonics, grading, masks, bounds, moves and drawing order."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from gsrain_engine.fast_math import harmonics
from gsrain_engine.scene.flags import BitMask, mask_union
from gsrain_engine.scene.gaussians import (
    COEFFICIENTS_OF_DEGREE,
    Gaussians,
    evaluate_sh,
    rotate_sh,
    sh_basis,
    sh_from_color,
)
from gsrain_engine.scene.geometry import (
    matrices_from_quaternions,
    normalized,
    quaternion_product,
    quaternions_from_matrices,
)
from gsrain_engine.scene.lod_order import lod_growth, lod_level_ends, lod_order, sort_into_lod_order
from gsrain_engine.scene.scene import UNCHANGED, ColorGrading, bounds, grade_sh, robust_bounds, rotation_to_z_up
from gsrain_engine.scene.transforms import transform_gaussians

from .formats.sample_files import sample_gaussians

QUATERNIONS = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.1)


def directions(n: int, seed: int = 0) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(n, 3))
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


# Rotations


@given(QUATERNIONS, QUATERNIONS)
def test_quaternions_and_matrices_are_scipys_and_products_compose(a: np.ndarray, b: np.ndarray) -> None:
    a, b = normalized(a), normalized(b)
    matrix = matrices_from_quaternions(a)
    assert np.allclose(matrix, Rotation.from_quat(a[[1, 2, 3, 0]]).as_matrix(), atol=1e-12)
    assert np.allclose(matrices_from_quaternions(quaternions_from_matrices(matrix)), matrix, atol=1e-9)
    both = matrices_from_quaternions(quaternion_product(a, b))
    assert np.allclose(both, matrix @ matrices_from_quaternions(b), atol=1e-12)


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda u: np.linalg.norm(u) > 0.1))
@example((0.0, 5.96e-8, -0.5))
@example((1e-9, 1e-3, -1.0))
def test_up_becomes_z(up: tuple[float, float, float]) -> None:
    turn = rotation_to_z_up(up)
    assert np.allclose(turn @ (np.array(up) / np.linalg.norm(up)), [0, 0, 1], atol=1e-9)
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-9) and np.linalg.det(turn) == pytest.approx(1)
    for axis in (*np.eye(3), *-np.eye(3)):
        assert set(np.abs(rotation_to_z_up(tuple(axis))).ravel()) == {0.0, 1.0}  # exactly


# Spherical harmonics


def test_the_basis_is_orthonormal_and_that_of_the_rasterizer() -> None:
    # Gauss-Legendre in z and even steps in azimuth integrate products of degree 6 exactly.
    z, weights = np.polynomial.legendre.leggauss(8)
    azimuth = np.arange(16) * (2 * np.pi / 16)
    r = np.sqrt(1 - z**2)[:, None]
    d = np.stack(np.broadcast_arrays(r * np.cos(azimuth), r * np.sin(azimuth), z[:, None]), axis=-1).reshape(-1, 3)
    basis = sh_basis(d, 16)
    products = np.einsum("ni,nj,n->ij", basis, basis, np.repeat(weights, 16) * (2 * np.pi / 16))
    np.testing.assert_allclose(products, np.eye(16), atol=1e-6)
    for k in COEFFICIENTS_OF_DEGREE:
        np.testing.assert_allclose(sh_basis(directions(500), k), harmonics(directions(500), k), atol=1e-6)
    colors = np.random.default_rng(1).random((50, 3)).astype(np.float32)
    np.testing.assert_allclose(evaluate_sh(sh_from_color(colors), directions(50)), colors, atol=1e-6)


@pytest.mark.parametrize("degree", range(4))
@given(a=QUATERNIONS, b=QUATERNIONS)
@settings(max_examples=30, deadline=None)
def test_a_turn_moves_colors_with_the_object_and_turns_compose(degree: int, a: np.ndarray, b: np.ndarray) -> None:
    first, second = (matrices_from_quaternions(normalized(each)) for each in (a, b))
    sh, d = np.random.default_rng(0).normal(size=(40, (degree + 1) ** 2, 3)).astype(np.float32), directions(40)
    before = sh.copy()
    turned = rotate_sh(sh, first)
    np.testing.assert_allclose(evaluate_sh(turned, (d @ first.T).astype(np.float32)), evaluate_sh(sh, d), atol=2e-5)
    np.testing.assert_allclose(rotate_sh(turned, second), rotate_sh(sh, second @ first), atol=1e-4)
    assert (sh == before).all() and rotate_sh(sh[:0], first).shape == (0, (degree + 1) ** 2, 3)


def test_grading_changes_light_contrast_and_hue_and_harmonics_like_colors() -> None:
    assert np.allclose(UNCHANGED.matrix, np.eye(3, 4))
    gray = np.array([0.5, 0.5, 0.5, 1])
    brighter = ColorGrading(exposure_ev=1, saturation=0.3).matrix @ [0.2, 0.2, 0.2, 1]
    assert brighter == pytest.approx(np.full(3, 0.2 * 2 ** (1 / 2.2)))
    assert ColorGrading(contrast=1.7).matrix @ gray == pytest.approx([0.5] * 3)
    assert np.ptp(ColorGrading(saturation=0).matrix @ [0.9, 0.2, 0.1, 1]) < 1e-12
    warm, green = ColorGrading(temperature=0.4).matrix @ gray, ColorGrading(tint=-0.4).matrix @ gray
    assert warm[0] > warm[1] > warm[2] and green[1] > green[0] == pytest.approx(green[2])
    sh, d = sample_gaussians(20).sh, directions(20)
    matrix = ColorGrading(exposure_ev=0.7, temperature=0.3, tint=-0.2, contrast=1.4, saturation=0.6).matrix
    expected = evaluate_sh(sh, d) @ matrix[:, :3].T + matrix[:, 3]
    assert evaluate_sh(grade_sh(sh, matrix), d) == pytest.approx(expected, abs=1e-5)


# Sets of Gaussians


def test_joined_harmonics_are_padded_and_shapes_that_do_not_fit_refused() -> None:
    joined = Gaussians.concatenate([sample_gaussians(2, 0), sample_gaussians(3, 2)])
    assert joined.sh.shape == (5, 9, 3) and joined.sh_degree == 2 and not joined.sh[:2, 1:].any()
    assert len(Gaussians.concatenate([])) == 0
    with pytest.raises(ValueError, match="2 coefficients a color"):
        joined.with_sh(np.zeros((5, 2, 3), np.float32))


def covariances(g: Gaussians) -> np.ndarray:
    m = matrices_from_quaternions(g.quaternions.astype(np.float64)) * g.scales[:, None, :]
    return m @ m.swapaxes(1, 2)


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.01, 100), turn=QUATERNIONS)
@settings(max_examples=25, deadline=None)
def test_moved_gaussians_have_the_moved_ellipsoids_and_colors(seed: int, scale: float, turn: np.ndarray) -> None:
    g, matrix = sample_gaussians(20, seed=seed % 7), np.eye(4)
    a = matrix[:3, :3] = scale * matrices_from_quaternions(normalized(turn))
    matrix[:3, 3] = np.random.default_rng(seed).normal(0, 10, 3)
    m = transform_gaussians(g, matrix)
    np.testing.assert_allclose(m.means, g.means @ a.T + matrix[:3, 3], rtol=1e-5, atol=1e-4 * max(scale, 1))
    np.testing.assert_allclose(covariances(m), a @ covariances(g) @ a.T, atol=1e-5 * scale**2)
    np.testing.assert_allclose(np.linalg.norm(m.quaternions, axis=1), 1, atol=1e-6)
    d = directions(20, seed)
    turned = (d @ (a / scale).T).astype(np.float32)
    np.testing.assert_allclose(evaluate_sh(m.sh, turned), evaluate_sh(g.sh, d), atol=2e-5)
    assert transform_gaussians(g, np.eye(4)) is g


def gaussians_at(means: np.ndarray, opacities: np.ndarray) -> Gaussians:
    n, f = len(means), np.float32
    turns = np.tile(np.array([1, 0, 0, 0], f), (n, 1))
    return Gaussians(means.astype(f), np.ones((n, 3), f), turns, opacities.astype(f), np.zeros((n, 1, 3), f))


def test_bounds_hold_all_or_leave_strays_and_faint_ones_out() -> None:
    few = gaussians_at(np.array([[1, 2, 3], [-4, 5, 0.5]]), np.ones(2))
    np.testing.assert_array_equal(bounds(few), [[-4, 2, 0.5], [1, 5, 3]])
    rng = np.random.default_rng(0)
    parts = rng.uniform(-1, 1, (10_000, 3)), rng.uniform(500, 900, (20, 3)), rng.uniform(-90, 90, (5_000, 3))
    opacities = np.concatenate([np.full(10_020, 0.9), np.full(5_000, 0.001)])
    low, high = robust_bounds(gaussians_at(np.concatenate(parts), opacities))
    np.testing.assert_allclose(low, -0.98, atol=0.01)
    np.testing.assert_allclose(high, 0.985, atol=0.01)
    line = gaussians_at(np.arange(101.0)[:, None] * [1, -1, 2], np.ones(101))
    np.testing.assert_allclose(robust_bounds(line, share=0.5), [[25, -75, 50], [75, -25, 150]], atol=2)
    transparent = gaussians_at(np.array([[1.0, 2, 3], [3, 4, 5]]), np.zeros(2))
    np.testing.assert_array_equal(robust_bounds(transparent), [[1, 2, 3], [3, 4, 5]])
    many = np.arange(2_500_000, dtype=np.float32)[:, None] * np.array([1, -2, 0], np.float32)  # of which some are read
    found = robust_bounds(gaussians_at(many, np.ones(len(many))))
    np.testing.assert_allclose(found, [[25e3, -4.95e6, 0], [2.475e6, -5e4, 0]], atol=20)
    for box in (bounds, robust_bounds):
        np.testing.assert_array_equal(box(Gaussians.empty(2)), np.zeros((2, 3)))


# Masks


@given(st.integers(0, 100).flatmap(lambda n: st.tuples(*[st.lists(st.booleans(), min_size=n, max_size=n)] * 2)))
def test_masks_combine_as_sets(pair: tuple[list[bool], list[bool]]) -> None:
    a, b = (np.array(each, np.bool_) for each in pair)
    x, y = BitMask.of(a), BitMask.of(b)
    for mask, flags in ((x, a), (x & y, a & b), (x | y, a | b), (x - y, a & ~b), (~x, ~a)):
        assert np.array_equal(mask.flags, flags) and mask.size == flags.sum() and bool(mask) == flags.any()
        assert np.array_equal(mask.indices, np.flatnonzero(flags))
    assert x.same_as(y) == np.array_equal(a, b)
    backwards = np.arange(len(a))[::-1]
    assert np.array_equal(x.take(backwards).flags, a[::-1]) and mask_union(x, y) is mask_union(x, y)


# Drawing order: a permutation in levels of falling contribution, neighbors side by side

NUMBERS = st.one_of(st.sampled_from([0.0, 1e-30, 1e30, 1.0]), st.floats(0, 10, width=32))


@st.composite
def odd_gaussians(draw: st.DrawFn) -> Gaussians:
    """Up to 40 Gaussians, many of them equal, flat, transparent or huge."""
    n = draw(st.integers(0, 40))
    scales = draw(arrays(np.float32, (n, 3), elements=NUMBERS.map(np.float32)))
    opacities = draw(arrays(np.float32, n, elements=st.sampled_from([0.0, 0.5, 1.0])))
    means = draw(arrays(np.float32, (n, 3), elements=st.floats(-(2.0**100), 2.0**100, width=32)))
    turns = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
    return Gaussians(means, scales, turns, opacities, np.arange(12 * n, dtype=np.float32).reshape(n, 4, 3))


def contributions(gaussians: Gaussians) -> np.ndarray:
    a, b, c = gaussians.scales.astype(np.float64).T
    with np.errstate(over="ignore"):
        values = (gaussians.opacities * (a * b + b * c + c * a)).astype(np.float32)
    return np.where(np.isfinite(values), values, 0)


@given(odd_gaussians())
def test_levels_hold_everything_once_and_what_contributes_nothing_last(gaussians: Gaussians) -> None:
    values, order, n = contributions(gaussians), lod_order(gaussians), len(gaussians)
    assert sorted(order) == list(range(n))
    np.testing.assert_array_equal(order, lod_order(gaussians))
    assert lod_level_ends(n)[-1] == n
    for end in lod_level_ends(n):
        if (values[order[:end]] == 0).any():
            assert (values[order[end:]] == 0).all()
    own = gaussians.take(slice(None)).take(np.arange(n))
    sort_into_lod_order(own)
    for array, expected in zip(own.arrays, gaussians.take(lod_order(gaussians)).arrays, strict=True):
        np.testing.assert_array_equal(array, expected)


@given(odd_gaussians(), st.sampled_from([1 / 8, 1 / 4, 1 / 2, 1.0]))
def test_a_share_grows_to_cover_as_much_as_all(gaussians: Gaussians, share: float) -> None:
    ordered = gaussians.take(lod_order(gaussians))
    values = contributions(ordered).astype(np.float64)
    drawn = values[: int(np.ceil(share * len(ordered)))].sum()
    growth = lod_growth(ordered, share)
    assert growth >= 1
    if drawn > 0:
        np.testing.assert_allclose(growth**2 * drawn, values.sum(), rtol=1e-6)


def test_large_gaussians_come_first_equal_ones_evenly_and_neighbors_together() -> None:
    """Of 8000 equal Gaussians and 100 of a hundred times their area: a binomial bound of 5 standard deviations."""
    g = sample_gaussians(8100, 0)
    g.scales[:], g.opacities[:] = 0.1, 1
    g.scales[:100] = 1.0
    g.means[:] = np.random.default_rng(1).uniform(0, 1, (8100, 3))
    first = lod_order(g)[: lod_level_ends(8100)[0]]
    assert np.sum(first < 100) == 100  # a chance of 1 in e^10 each to come later
    equal = first[first >= 100]
    assert abs(np.mean(g.means[equal, 0] < 0.5) - 0.5) < 5 * 0.5 / np.sqrt(len(equal))
    steps = [np.linalg.norm(np.diff(g.means[rows], axis=0), axis=1).mean() for rows in (first, np.sort(first))]
    assert steps[0] < 0.35 * steps[1]


@pytest.mark.parametrize("field", ["means", "scales", "opacities"])
def test_numbers_that_are_not_finite_are_ordered_too_and_read_only_arrays_refused(field: str) -> None:
    for value in (np.nan, np.inf, -np.inf):
        gaussians = sample_gaussians(100)
        getattr(gaussians, field)[3] = value
        order = lod_order(gaussians)
        assert sorted(order) == list(range(100))
        assert field == "means" or 3 in order[lod_level_ends(100)[-2] :]
    getattr(gaussians, field).flags.writeable = False
    with pytest.raises(ValueError, match=field):
        sort_into_lod_order(gaussians)
