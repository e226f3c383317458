"""Boxes around Gaussians."""

import numpy as np

from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import bounds, robust_bounds


def gaussians_at(means: np.ndarray, opacities: np.ndarray) -> Gaussians:
    n, f = len(means), np.float32
    quaternions = np.tile(np.array([1, 0, 0, 0], f), (n, 1))
    return Gaussians(means.astype(f), np.ones((n, 3), f), quaternions, opacities.astype(f), np.zeros((n, 1, 3), f))


def test_all_centres() -> None:
    low, high = bounds(gaussians_at(np.array([[1, 2, 3], [-4, 5, 0.5]]), np.ones(2)))
    np.testing.assert_array_equal([low, high], [[-4, 2, 0.5], [1, 5, 3]])


def test_strays_and_faint_ones_are_left_out() -> None:
    rng = np.random.default_rng(0)
    cube = rng.uniform(-1, 1, (10_000, 3))
    strays = rng.uniform(500, 900, (20, 3))
    fog = rng.uniform(-90, 90, (5_000, 3))
    opacities = np.concatenate([np.full(10_020, 0.9), np.full(5_000, 0.001)])
    low, high = robust_bounds(gaussians_at(np.concatenate([cube, strays, fog]), opacities))
    np.testing.assert_allclose(low, -0.98, atol=0.01)
    np.testing.assert_allclose(high, 0.985, atol=0.01)


def test_half_of_the_opacity() -> None:
    line = np.arange(101.0)[:, None] * [1, -1, 2]
    low, high = robust_bounds(gaussians_at(line, np.ones(101)), share=0.5)
    np.testing.assert_allclose([low, high], [[25, -75, 50], [75, -25, 150]], atol=2)


def test_of_millions_an_even_share_is_looked_at() -> None:
    line = np.arange(2_500_000, dtype=np.float32)[:, None] * np.array([1, -2, 0], np.float32)
    everything = gaussians_at(line, np.ones(len(line)))
    np.testing.assert_allclose(robust_bounds(everything), [[25e3, -4.95e6, 0], [2.475e6, -5e4, 0]], atol=20)
    np.testing.assert_allclose(bounds(everything), [line.min(axis=0), line.max(axis=0)])


def test_transparent_and_missing_gaussians_have_bounds_too() -> None:
    low, high = robust_bounds(gaussians_at(np.array([[1.0, 2, 3], [3, 4, 5]]), np.zeros(2)))
    np.testing.assert_array_equal([low, high], [[1, 2, 3], [3, 4, 5]])
    for box in (bounds, robust_bounds):
        np.testing.assert_array_equal(box(Gaussians.empty(2)), np.zeros((2, 3)))
