"""Image metrics against values calculated by hand and by loops; intervals against the literature."""

import math

import numpy as np
import pytest

from gsrain_engine.evaluation.image_metrics import (
    check_pair,
    fitted_affine,
    psnr,
    ssim,
    ssim_map,
    window,
    with_affine,
)


def _pictures(height: int = 24, width: int = 31) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(5)
    truth = generator.random((height, width, 3))
    return np.clip(truth + generator.normal(0, 0.1, truth.shape), 0, 1), truth


def _ssim_at(x: np.ndarray, y: np.ndarray, row: int, column: int, mask: np.ndarray | None = None) -> float:
    """Wang et al.'s formula written out for one window of one channel."""
    weights = np.outer(window(), window())
    if mask is not None:
        weights = weights * mask[row : row + 11, column : column + 11]
    weights = weights / weights.sum()
    a, b = x[row : row + 11, column : column + 11], y[row : row + 11, column : column + 11]
    mean_a, mean_b = (weights * a).sum(), (weights * b).sum()
    variance_a, variance_b = (weights * (a - mean_a) ** 2).sum(), (weights * (b - mean_b) ** 2).sum()
    covariance = (weights * (a - mean_a) * (b - mean_b)).sum()
    luminance = (2 * mean_a * mean_b + 1e-4) / (mean_a**2 + mean_b**2 + 1e-4)
    return luminance * (2 * covariance + 9e-4) / (variance_a + variance_b + 9e-4)


def test_psnr_of_known_differences():
    truth = np.full((4, 5, 3), 0.5)
    rendered, mask = truth + 0.1, np.zeros((4, 5), bool)
    mask[:, :2] = True
    assert psnr(rendered, truth) == pytest.approx(20.0)
    assert psnr(truth + 0.01, truth) == pytest.approx(40.0)
    assert psnr(truth, truth) == math.inf
    rendered[:, 2:] += 0.3
    assert psnr(rendered, truth, mask) == pytest.approx(20.0)


def test_ssim_equals_the_formula_of_the_paper_in_every_window():
    half = [0.0010284, 0.0075988, 0.0360008, 0.1093607, 0.2130055]  # exp(-n^2 / 4.5) for n = 5..1, over the sum
    assert window() == pytest.approx([*half, 0.2660117, *half[::-1]], rel=1e-4)
    x, y = _pictures(80)
    found = ssim_map(x, y)
    assert found.shape == (70, 21, 3)
    for row, column, channel in [(0, 0, 0), (31, 20, 2), (32, 9, 1), (69, 20, 0)]:
        expected = _ssim_at(x[..., channel], y[..., channel], row, column)
        assert found[row, column, channel] == pytest.approx(expected, rel=1e-9)
    assert ssim(x, y) == pytest.approx(found.mean(), rel=1e-12)
    smallest = ssim_map(x[:11, :11], y[:11, :11])
    assert smallest.shape == (1, 1, 3) and smallest[0, 0] == pytest.approx(found[0, 0], rel=1e-9)


def test_masked_pixels_have_no_weight():
    x, y = _pictures()
    mask = np.ones(x.shape[:2], bool)
    mask[5:12, 20:] = False
    black = np.where(mask[..., None], x, 0.0)
    assert ssim(black, y, mask) == pytest.approx(ssim(x, y, mask), rel=1e-12)
    assert ssim(black, y) < ssim(x, y) - 0.01
    expected = _ssim_at(x[..., 0], y[..., 0], 3, 15, mask)
    assert ssim_map(x, y, mask)[3, 15, 0] == pytest.approx(expected, rel=1e-9)
    mask[:] = False
    mask[8, 9] = mask[12, 20] = True
    similarity = ssim_map(x, y, mask)
    assert ssim(x, y, mask) == pytest.approx((similarity[3, 4] + similarity[7, 15]).mean() / 2, rel=1e-12)
    assert np.isfinite(similarity).all()  # also where no pixel of a window is left


def test_a_single_pixel_at_the_edge_of_a_window_counts_fully():
    """Without others there is neither variance nor covariance, only the luminance term."""
    x, y = _pictures(11, 11)
    mask = np.zeros((11, 11), bool)
    mask[0, 5] = True  # weight 0.0010 x 0.266
    expected = (2 * x[0, 5] * y[0, 5] + 1e-4) / (x[0, 5] ** 2 + y[0, 5] ** 2 + 1e-4)
    assert ssim_map(x, y, mask)[0, 0] == pytest.approx(expected, rel=1e-9)


EDGES = np.zeros((24, 31), bool)
EDGES[4, :] = EDGES[:, 4] = True  # no window is centered there


@pytest.mark.parametrize(
    ("metric", "arguments", "names"),
    [
        (psnr, (*_pictures(), np.zeros((24, 31), bool)), "no pixel"),
        (ssim, (*_pictures(), EDGES), "no pixel"),
        (ssim, (*_pictures(10),), "at least 11"),
        (ssim, (*_pictures(24, 10),), "at least 11"),
        (check_pair, ((24, 31, 3), (23, 31, 3), None), "31x23"),
        (check_pair, ((24, 31), (24, 31), None), "31x24"),
        (check_pair, ((24, 31, 3), (24, 31, 3), (31, 24)), "24x31"),
    ],
)
def test_other_shapes_and_masks_are_refused(metric, arguments, names):
    with pytest.raises(ValueError, match=names):
        metric(*arguments)


def test_affine_color_map_is_fitted():
    x, _ = _pictures()
    affine, mask = np.array([[0.5, 0.1, 0, 0.1], [0, 0.6, 0.1, 0], [0.1, 0, 0.7, 0.05]]), np.ones(x.shape[:2], bool)
    assert fitted_affine(x, with_affine(x, affine), mask) == pytest.approx(affine, abs=0.02)
    assert (fitted_affine(x, x, ~mask) == np.eye(3, 4)).all()
    assert with_affine(np.full((1, 1, 3), 0.9), np.eye(3, 4) * 2).max() == 1
