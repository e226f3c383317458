import numpy as np
import pytest

from gsrain_engine.recolor.problem import fit_color_prior
from gsrain_engine.scene.gaussians import SH_C0, sh_from_color

MATRIX = np.array([[0.6, 0.1, 0.0], [0.05, 0.6, 0.0], [0.0, 0.1, 0.7]])
OFFSET = np.array([0.02, 0.05, 0.1])


def pixels(count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    clear = np.random.default_rng(0).uniform(0, 1, (count, 3)).astype(np.float32)
    return clear, (clear @ MATRIX.T + OFFSET).astype(np.float32)


def test_an_affine_change_is_found_again_and_applied_to_harmonics():
    clear, changed = pixels()
    shares = np.tile(np.array([0, 1, 0], np.float32), (len(clear), 1))
    change = fit_color_prior(*([each[:1000], each[1000:]] for each in (clear, changed, shares)))
    colors = np.array([[0.2, 0.5, 0.9], [0.0, 1.0, 0.3]], np.float32)
    sh = np.concatenate([sh_from_color(colors), np.full((2, 3, 3), 0.1, np.float32)], axis=1)
    moved = change.of_sh(sh, shares[:2])
    np.testing.assert_allclose(0.5 + SH_C0 * moved[:, 0], colors @ MATRIX.T + OFFSET, atol=0.01)
    np.testing.assert_allclose(moved[:, 1:], np.broadcast_to(MATRIX.sum(axis=1) * 0.1, (2, 3, 3)), atol=0.01)


def test_each_kind_of_surface_has_its_own_change():
    clear, changed = pixels()
    shares = np.zeros((len(clear), 3), np.float32)
    shares[::2, 0], shares[1::2, 2] = 1, 1
    target = np.where(shares[:, :1] > 0, np.float32(0.7), changed)
    change = fit_color_prior([clear], [target], [shares])
    grey = sh_from_color(np.full((1, 3), 0.4, np.float32))
    sky = 0.5 + SH_C0 * change.of_sh(grey, np.array([[1, 0, 0]], np.float32))[0, 0]
    other = 0.5 + SH_C0 * change.of_sh(grey, np.array([[0, 0, 1]], np.float32))[0, 0]
    half = 0.5 + SH_C0 * change.of_sh(grey, np.array([[0.5, 0, 0.5]], np.float32))[0, 0]
    np.testing.assert_allclose(sky, 0.7, atol=0.02)
    np.testing.assert_allclose(other, MATRIX.sum(axis=1) * 0.4 + OFFSET, atol=0.01)
    np.testing.assert_allclose(half, (sky + other) / 2, atol=1e-5)


def test_a_kind_without_pixels_gets_the_change_of_all():
    clear, changed = pixels()
    shares = np.tile(np.array([0, 0, 1], np.float32), (len(clear), 1))
    change = fit_color_prior([clear], [changed], [shares])
    np.testing.assert_array_equal(change.matrices[0], change.matrices[2])


@pytest.mark.parametrize("color", [0.0, 0.35])
def test_pixels_of_one_color_give_a_tame_map(color):
    clear = np.full((1000, 3), color, np.float32)
    shares = np.tile(np.array([0, 1, 0], np.float32), (1000, 1))
    change = fit_color_prior([clear], [np.full((1000, 3), 0.2, np.float32)], [shares])
    assert np.abs(change.matrices).max() < 1.5
    shown = 0.5 + SH_C0 * change.of_sh(sh_from_color(clear[:1]), shares[:1])[0, 0]
    np.testing.assert_allclose(shown, 0.2, atol=0.02)
