"""Wilson's interval of a counted share, and the bootstrap's of a mean."""

import math

import numpy as np
import pytest

from gsrain_engine.evaluation.image_metrics import mean_interval, wilson_interval


def test_values_of_the_literature():
    # Newcombe (1998), table 1: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    for (hits, of), ends in {
        (81, 263): (0.2553, 0.3662), (15, 148): (0.0624, 0.1605), (0, 20): (0.0, 0.1611), (1, 29): (0.0061, 0.1718),
    }.items():  # fmt: skip
        assert wilson_interval(hits, of) == pytest.approx(ends, abs=5e-5)


def test_all_and_nothing():
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
