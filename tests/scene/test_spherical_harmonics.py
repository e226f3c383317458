"""Spherical harmonics against the compiled version, and turns against what they must leave as it is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gsrain_engine.render.cpu.fast_math import harmonics
from gsrain_engine.scene.gaussians import COEFFICIENTS_OF_DEGREE, evaluate_sh, rotate_sh, sh_basis, sh_from_color
from gsrain_engine.scene.geometry import matrices_from_quaternions, normalized


def directions(n: int, seed: int = 0) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(n, 3))
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


def coefficients(n: int, degree: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, COEFFICIENTS_OF_DEGREE[degree], 3)).astype(np.float32)


@pytest.mark.parametrize("k", COEFFICIENTS_OF_DEGREE)
def test_basis_is_that_of_the_rasterizer(k: int) -> None:
    d = directions(500)
    np.testing.assert_allclose(sh_basis(d, k), harmonics(d, k), atol=1e-6)


def test_basis_is_orthonormal() -> None:
    # Gauss-Legendre in z and even steps in azimuth integrate products of degree 6 exactly.
    z, weights = np.polynomial.legendre.leggauss(8)
    azimuth = np.arange(16) * (2 * np.pi / 16)
    r = np.sqrt(1 - z**2)[:, None]
    d = np.stack(np.broadcast_arrays(r * np.cos(azimuth), r * np.sin(azimuth), z[:, None]), axis=-1).reshape(-1, 3)
    basis = sh_basis(d, 16)
    products = np.einsum("ni,nj,n->ij", basis, basis, np.repeat(weights, 16) * (2 * np.pi / 16))
    np.testing.assert_allclose(products, np.eye(16), atol=1e-6)


def test_degree_0_shows_its_color_from_everywhere() -> None:
    colors = np.random.default_rng(1).random((50, 3)).astype(np.float32)
    np.testing.assert_allclose(evaluate_sh(sh_from_color(colors), directions(50)), colors, atol=1e-6)


@pytest.mark.parametrize("degree", range(4))
@given(quaternion=arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 0.1))
@settings(max_examples=30, deadline=None)
def test_a_turn_moves_colors_with_the_object(degree: int, quaternion: np.ndarray) -> None:
    rotation = matrices_from_quaternions(normalized(quaternion))
    sh, d = coefficients(40, degree), directions(40)
    turned = evaluate_sh(rotate_sh(sh, rotation), (d @ rotation.T).astype(np.float32))
    np.testing.assert_allclose(turned, evaluate_sh(sh, d), atol=2e-5)


def test_no_turn_changes_nothing_and_turns_compose() -> None:
    a = matrices_from_quaternions(normalized(np.array([0.9, 0.1, -0.4, 0.2])))
    b = matrices_from_quaternions(normalized(np.array([0.2, -0.7, 0.3, 0.5])))
    sh = coefficients(20, 3)
    np.testing.assert_allclose(rotate_sh(sh, np.eye(3)), sh, atol=1e-5)
    np.testing.assert_allclose(rotate_sh(rotate_sh(sh, a), b), rotate_sh(sh, b @ a), atol=1e-4)


def test_a_turn_leaves_its_argument_alone_and_accepts_none() -> None:
    sh = coefficients(5, 2)
    before = sh.copy()
    rotate_sh(sh, np.diag([1.0, -1.0, -1.0]))
    assert (sh == before).all()
    assert rotate_sh(sh[:0], np.eye(3)).shape == (0, 9, 3)
