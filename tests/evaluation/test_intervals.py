"""Intervals and same-distribution values, held against drawing new sets again and again."""

import numpy as np
import pytest

from gsrain_engine.evaluation.fid import (
    SameDistribution,
    frechet_distance,
    frechet_interval,
    kernel_estimate,
    same_distribution,
    small_sample_warning,
)
from gsrain_engine.evaluation.fid_features import Extractor
from oracles.kernel_distance import kernel_distance

FEATURES = 24
FID = Extractor(metric="FID", described="", features=FEATURES, key=None, function=lambda image: image.mean(axis=(0, 1)))


def _set(random, count, shift=0.0, scale=1.0):
    return random.normal(0, 1, (count, FEATURES)) * np.arange(1, FEATURES + 1) ** -0.5 * scale + shift


@pytest.mark.parametrize(("shift", "scale"), [(0.0, 1.0), (0.2, 1.3)])
def test_the_frechet_interval_is_as_wide_as_new_sets_vary(shift, scale):
    random = np.random.default_rng(3)
    true = np.array([frechet_distance(_set(random, 60), _set(random, 50, shift, scale)) for _ in range(200)])
    covers, widths = 0, list[float]()
    for seed in range(20):
        interval = frechet_interval(_set(random, 60), _set(random, 50, shift, scale), 60, seed)
        covers += interval.low <= true.mean() <= interval.high
        widths.append(interval.high - interval.low)
    assert covers >= 17
    assert 0.8 < np.mean(widths) / (3.92 * true.std()) < 1.7


@pytest.mark.parametrize(("shift", "scale"), [(0.0, 1.0), (0.3, 1.3)])
def test_the_kernel_interval_covers_what_many_pictures_give(shift, scale):
    random = np.random.default_rng(4)
    true = kernel_distance(_set(random, 1500), _set(random, 1500, shift, scale)) if shift else 0.0
    covers = 0
    for seed in range(20):
        interval = kernel_estimate(_set(random, 60), _set(random, 50, shift, scale), 200, seed)[1]
        covers += interval.low <= true <= interval.high
    assert covers >= 17
    assert (interval.low > 0) == bool(shift)


def test_the_kernel_interval_of_a_set_and_itself_covers_zero():
    points = _set(np.random.default_rng(0), 40)
    interval = kernel_estimate(points, points, 200, 0, np.eye(40, dtype=bool))[1]
    assert interval.low < 0 < interval.high


@pytest.mark.parametrize(("n", "m"), [(16, 16), (12, 30), (80, 60)])
def test_the_same_distribution_value_is_that_of_new_sets(n, m):
    random = np.random.default_rng(7)
    true = np.array([frechet_distance(_set(random, n), _set(random, m)) for _ in range(100)])
    estimates = [same_distribution(_set(random, n), _set(random, m, 0.5), 20, seed) for seed in range(12)]
    assert np.mean([each.mean for each in estimates]) == pytest.approx(true.mean(), rel=0.08)
    assert all(each.interval.low < each.mean < each.interval.high for each in estimates)


def test_what_few_pictures_do_to_fid_is_as_large_as_the_features_spread():
    """Of 2048 features whose variances fall as 1/k, two sets of 32 are 1.18 times the total variance apart."""
    random = np.random.default_rng(0)
    variances = 1 / np.arange(1, 2049)
    sets = [random.normal(0, 1, (32, 2048)) * variances**0.5 for _ in range(2)]
    same = same_distribution(sets[0], sets[1], 20, 0)
    assert same.mean / variances.sum() == pytest.approx(1.18, abs=0.06)
    assert frechet_distance(*sets) / variances.sum() == pytest.approx(1.18, abs=0.06)


def test_the_seed_decides_and_steps_are_reported():
    random = np.random.default_rng(1)
    real, fake = _set(random, 20), _set(random, 18)
    steps: list[None] = []
    first = frechet_interval(real, fake, 30, 5, lambda: steps.append(None))
    assert len(steps) == 30
    assert first == frechet_interval(real, fake, 30, 5)
    assert first != frechet_interval(real, fake, 30, 6)
    assert same_distribution(real, fake, 20, 5) == same_distribution(real, fake, 20, 5)
    assert same_distribution(real, fake, 20, 5) != same_distribution(real, fake, 20, 6)
    assert kernel_estimate(real, fake, 50, 5)[1] == kernel_estimate(real, fake, 50, 5)[1]


def test_two_pictures_can_be_drawn_again():
    random = np.random.default_rng(1)
    interval = frechet_interval(_set(random, 2), _set(random, 2), 20, 0)
    assert np.isfinite(interval).all()


def test_the_warning_says_what_few_pictures_do():
    random = np.random.default_rng(2)
    few = _set(random, 12), _set(random, 12)
    value, same = frechet_distance(*few), same_distribution(*few, 40, 0)
    said = small_sample_warning(FID, value, (12, 12), same)
    assert said is not None
    assert said.startswith(f"for want of pictures (12 and 12 for {FEATURES} features) the FID of two such sets")
    assert f"{value:.4g} tells no difference" in said
    far = small_sample_warning(FID, 3 * same.interval.high, (12, 12), same)
    assert far is not None
    assert "only with values of as many pictures, or take KID" in far
    assert small_sample_warning(FID, 100 * same.mean, (12, 12), same) is None
    assert small_sample_warning(FID, 1.0, (9, 9), SameDistribution(0.09, same.interval)) is None


def test_kid_and_its_interval_come_from_one_look_at_the_kernels():
    random = np.random.default_rng(1)
    real, fake = _set(random, 30), _set(random, 25, 0.1)
    value, interval = kernel_estimate(real, fake, 50, 5)
    assert value == pytest.approx(kernel_distance(real, fake), rel=1e-12)
    assert interval == pytest.approx(kernel_estimate(real, fake, 50, 5)[1], rel=1e-12)
