"""Image metrics against values worked out by hand and by loops, and intervals against the literature."""

import math

import numpy as np
import pytest

from gsrain_engine.evaluation.image_metrics import (
    check_pair,
    fitted_affine,
    mean_interval,
    psnr,
    ssim,
    ssim_map,
    wilson_interval,
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


def test_the_window_is_a_gaussian_of_sigma_1_5():
    half = [0.0010284, 0.0075988, 0.0360008, 0.1093607, 0.2130055]  # exp(-n^2 / 4.5) for n = 5..1, over the sum
    assert window() == pytest.approx([*half, 0.2660117, *half[::-1]], rel=1e-4)


def test_psnr_of_known_differences_inside_the_mask():
    truth = np.full((4, 5, 3), 0.5)
    rendered, mask = truth + 0.1, np.zeros((4, 5), bool)
    mask[:, :2] = True
    assert psnr(rendered, truth) == pytest.approx(20.0)
    assert psnr(truth + 0.01, truth) == pytest.approx(40.0)
    assert psnr(truth, truth) == float("inf")
    rendered[:, 2:] += 0.3
    assert psnr(rendered, truth, mask) == pytest.approx(20.0)
    with pytest.raises(ValueError, match="no pixel"):
        psnr(rendered, truth, np.zeros((4, 5), bool))


def test_ssim_is_the_formula_of_the_paper_in_every_window():
    x, y = _pictures(80)
    got = ssim_map(x, y)
    assert got.shape == (70, 21, 3)
    for row, column, channel in [(0, 0, 0), (31, 20, 2), (32, 9, 1), (69, 20, 0)]:
        expected = _ssim_at(x[..., channel], y[..., channel], row, column)
        assert got[row, column, channel] == pytest.approx(expected, rel=1e-9)


def test_ssim_of_two_flat_pictures_is_their_luminance_term():
    first, second = np.full((20, 20, 3), 0.4), np.full((20, 20, 3), 0.6)
    assert ssim(first, second) == pytest.approx((2 * 0.24 + 1e-4) / (0.16 + 0.36 + 1e-4))
    assert ssim(first, first) == pytest.approx(1.0)


def test_what_the_mask_leaves_out_changes_nothing():
    x, y = _pictures()
    mask = np.ones(x.shape[:2], bool)
    mask[5:12, 20:] = False
    spoilt = x.copy()
    spoilt[~mask] = 0.0
    assert ssim(spoilt, y, mask) == pytest.approx(ssim(x, y, mask), rel=1e-12)
    assert ssim(spoilt, y) < ssim(x, y) - 0.01
    expected = _ssim_at(x[..., 0], y[..., 0], 3, 15, mask)
    assert ssim_map(x, y, mask)[3, 15, 0] == pytest.approx(expected, rel=1e-9)


def test_ssim_is_the_mean_over_the_middles_that_the_mask_leaves():
    x, y = _pictures()
    mask = np.zeros(x.shape[:2], bool)
    mask[8, 9] = mask[12, 20] = True
    similarity = ssim_map(x, y, mask)
    assert ssim(x, y, mask) == pytest.approx((similarity[3, 4] + similarity[7, 15]).mean() / 2, rel=1e-12)
    assert ssim(x, y) == pytest.approx(ssim_map(x, y).mean(), rel=1e-12)
    assert np.isfinite(similarity).all()  # also far from the mask, where nothing is left of a window
    mask[:] = False
    mask[4, :] = mask[:, 4] = True  # no window has its middle so near the edge
    with pytest.raises(ValueError, match="no pixel"):
        ssim(x, y, mask)


def test_a_speck_at_the_rim_of_a_window_counts_fully():
    """Without others there is neither variance nor covariance: what is left is the luminance term."""
    x, y = _pictures(11, 11)
    mask = np.zeros((11, 11), bool)
    mask[0, 5] = True  # weight 0.0010 x 0.266
    expected = (2 * x[0, 5] * y[0, 5] + 1e-4) / (x[0, 5] ** 2 + y[0, 5] ** 2 + 1e-4)
    assert ssim_map(x, y, mask)[0, 0] == pytest.approx(expected, rel=1e-9)


def test_the_smallest_picture_has_one_window_and_others_are_refused():
    x, y = _pictures(11, 11)
    assert ssim_map(x, y).shape == (1, 1, 3)
    assert ssim_map(x, y)[0, 0, 1] == pytest.approx(_ssim_at(x[..., 1], y[..., 1], 0, 0), rel=1e-9)
    for short in (np.s_[:10], np.s_[:, :10]):
        with pytest.raises(ValueError, match="at least 11"):
            ssim(x[short], y[short])
    for shapes in (((24, 31, 3), (23, 31, 3), None), ((24, 31), (24, 31), None), ((24, 31, 3), (24, 31, 3), (31, 24))):
        with pytest.raises(ValueError, match="31"):
            check_pair(*shapes)


def test_an_affine_map_of_colors_comes_back():
    x, _ = _pictures()
    affine, mask = np.array([[0.5, 0.1, 0, 0.1], [0, 0.6, 0.1, 0], [0.1, 0, 0.7, 0.05]]), np.ones(x.shape[:2], bool)
    assert fitted_affine(x, with_affine(x, affine), mask) == pytest.approx(affine, abs=0.02)
    assert (fitted_affine(x, x, ~mask) == np.eye(3, 4)).all()
    assert with_affine(np.full((1, 1, 3), 0.9), np.eye(3, 4) * 2).max() == 1


def test_wilsons_intervals_of_the_literature():
    # Newcombe (1998), table 1: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    for (hits, of), ends in {
        (81, 263): (0.2553, 0.3662), (15, 148): (0.0624, 0.1605), (0, 20): (0.0, 0.1611), (1, 29): (0.0061, 0.1718),
    }.items():  # fmt: skip
        assert wilson_interval(hits, of) == pytest.approx(ends, abs=5e-5)
    assert wilson_interval(20, 20) == pytest.approx((1 - 0.1611, 1.0), abs=5e-5)
    assert wilson_interval(0, 0) == (0.0, 1.0)


def test_a_mean_lies_within_twice_its_standard_error():
    """Of 400 normal values: the ends are 1.96 s / sqrt(n) from the mean, to what 2000 resamples tell (5 %)."""
    values = np.random.default_rng(4).normal(30, 2, 400)
    mean, low, high = mean_interval(values.tolist())
    error = 1.96 * values.std() / math.sqrt(400)
    assert mean == pytest.approx(values.mean())
    assert (mean - low, high - mean) == pytest.approx((error, error), rel=0.1)
    assert mean_interval(values.tolist()) == (mean, low, high) != mean_interval(values.tolist(), seed=1)


def test_means_of_one_value_of_none_and_of_infinity():
    assert mean_interval([7.5]) == (7.5, 7.5, 7.5)
    with pytest.raises(ValueError, match="at least one value"):
        mean_interval([])
    mean, low, high = mean_interval([30.0] * 99 + [math.inf])
    assert mean == high == math.inf and low == 30
