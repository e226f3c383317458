"""Wilson's interval of a counted share."""

import pytest

from gsrain_engine.evaluate.share_interval import share_interval


def test_values_of_the_literature():
    # Newcombe (1998), table 1: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    for (hits, of), ends in {
        (81, 263): (0.2553, 0.3662), (15, 148): (0.0624, 0.1605), (0, 20): (0.0, 0.1611), (1, 29): (0.0061, 0.1718),
    }.items():  # fmt: skip
        assert share_interval(hits, of) == pytest.approx(ends, abs=5e-5)


def test_all_and_nothing():
    assert share_interval(20, 20) == pytest.approx((1 - 0.1611, 1.0), abs=5e-5)
    assert share_interval(0, 0) == (0.0, 1.0)
