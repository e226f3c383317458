"""Shapley shares of games with known values, and of as many factors as are allowed."""

from itertools import permutations

import numpy as np
import pytest

from gsrain_engine.evaluation.attribution.shapley import MAX_FACTORS, coalitions_of, shapley_shares

ABC = ("a", "b", "c")


def values_of(factors, worth):
    return {each: np.array([worth(each)], float) for each in coalitions_of(factors)}


GLOVES = (lambda s: float("a" in s and ("b" in s or "c" in s)), (2 / 3, 1 / 6, 1 / 6))  # a left glove, two right ones
ADDITIVE = (lambda s: sum({"a": 3.0, "b": -1.0, "c": 0.5}[each] for each in s), (3.0, -1.0, 0.5))
UNANIMOUS = (lambda s: 6.0 * (s >= {"a", "c"}), (3.0, 0.0, 3.0))
MAJORITY = (lambda s: float(len(s) >= 2), (1 / 3, 1 / 3, 1 / 3))


@pytest.mark.parametrize(("worth", "expected"), [GLOVES, ADDITIVE, UNANIMOUS, MAJORITY])
def test_known_games(worth, expected):
    np.testing.assert_allclose(shapley_shares(ABC, values_of(ABC, worth))[:, 0], expected, atol=1e-12)


def test_shares_are_means_over_all_orders_and_sum_to_the_whole_effect():
    factors = tuple("abcde")
    worth = {each: np.random.default_rng(number).normal(size=2) for number, each in enumerate(coalitions_of(factors))}
    shares, expected = shapley_shares(factors, worth), np.zeros((5, 2))
    orders = list(permutations(factors))
    for order in orders:
        for k, name in enumerate(order):
            change = worth[frozenset(order[: k + 1])] - worth[frozenset(order[:k])]
            expected[factors.index(name)] += change / len(orders)
    np.testing.assert_allclose(shares, expected, atol=1e-12)
    np.testing.assert_allclose(shares.sum(axis=0), worth[frozenset(factors)] - worth[frozenset()], atol=1e-12)


def test_nine_factors_have_512_coalitions_and_more_are_refused():
    nine = tuple("abcdefghi")
    assert len(nine) == MAX_FACTORS and len(set(coalitions_of(nine))) == 512
    shares = shapley_shares(nine, values_of(nine, lambda s: float(len(s) ** 2)))
    np.testing.assert_allclose(shares, 9.0)
    with pytest.raises(ValueError, match="attribute: expected at most 9 factors, got 10"):
        coalitions_of((*nine, "j"))
