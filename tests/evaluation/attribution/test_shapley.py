"""Shapley shares of games with known values, sampled orders and their intervals, and factors that need another one."""

from itertools import permutations

import numpy as np
import pytest

from gsrain_engine.evaluation.attribution.shapley import AttributionPlan, Game, sampled_shares, student_interval

ABC = Game(("a", "b", "c"))


def values_of(game, worth):
    return {each: np.array([worth(each)], float) for each in game.coalitions}


GLOVES = (lambda s: float("a" in s and ("b" in s or "c" in s)), (2 / 3, 1 / 6, 1 / 6))  # a left glove, two right ones
ADDITIVE = (lambda s: sum({"a": 3.0, "b": -1.0, "c": 0.5}[each] for each in s), (3.0, -1.0, 0.5))
UNANIMOUS = (lambda s: 6.0 * (s >= {"a", "c"}), (3.0, 0.0, 3.0))
MAJORITY = (lambda s: float(len(s) >= 2), (1 / 3, 1 / 3, 1 / 3))


@pytest.mark.parametrize(("worth", "expected"), [GLOVES, ADDITIVE, UNANIMOUS, MAJORITY])
def test_known_games(worth, expected):
    np.testing.assert_allclose(ABC.shares(values_of(ABC, worth))[:, 0], expected, atol=1e-12)


def test_what_acts_on_top_of_another_comes_after_it():
    game = Game(("x", "light", "wet", "mirror"), {"wet": "light", "mirror": "wet"})
    assert len(game.coalitions) == 8 and frozenset({"wet"}) not in game.coalitions
    worth = {each: np.random.default_rng(len(each)).normal(size=2) + len(each & {"x"}) for each in game.coalitions}
    allowed = [
        order for order in permutations(game.factors)
        if order.index("light") < order.index("wet") < order.index("mirror")
    ]  # fmt: skip
    assert len(allowed) == 4
    np.testing.assert_allclose(game.shares(worth), sampled_shares(game.factors, allowed, worth), atol=1e-12)
    drawn = game.orders(400, seed=1)
    assert set(drawn) == set(allowed)
    counts = np.array([drawn.count(each) for each in allowed])
    assert np.all(abs(counts - 200) < 4 * np.sqrt(200 * 3 / 4))  # uniform
    for wrong in ({"wet": "light", "mirror": "light"}, {"wet": "rain"}):
        with pytest.raises(ValueError, match="each may bear one"):
            Game(game.factors, wrong)


def random_worth(game, seed):
    """Main effects with interactions of all orders, as of a detector that fails by several causes together."""
    draw = np.random.default_rng(seed)
    main = dict(zip(game.factors, draw.normal(size=len(game.factors)), strict=True))
    return {each: np.array([sum(main[f] for f in each) + draw.normal()]) for each in game.coalitions}


SIX = Game(tuple("abcdef"))


def test_sampled_shares_lie_within_their_intervals_as_often_as_stated():
    worth = random_worth(SIX, 0)
    exact = SIX.shares(worth)[:, 0]
    plan, seeds, covered = AttributionPlan(SIX, 2), 6, []
    for trial in range(150):
        shares = np.stack([plan.shares(seeds * trial + seed, worth)[:, 0] for seed in range(seeds)])
        intervals = [student_interval(own) for own in shares.T]
        covered += [low <= value <= high for (_, low, high), value in zip(intervals, exact, strict=True)]
    assert abs(np.mean(covered) - 0.95) < 0.03  # 900 intervals, six by six from the same orders


def test_opposite_orders_err_less_than_independent_ones():
    worth = random_worth(SIX, 3)
    exact = SIX.shares(worth)[:, 0]
    opposite = [sampled_shares(SIX.factors, SIX.orders(2, seed), worth)[:, 0] for seed in range(100)]
    one_of_each = [SIX.orders(4, 1000 + seed)[::2] for seed in range(100)]
    independent = [sampled_shares(SIX.factors, orders, worth)[:, 0] for orders in one_of_each]
    assert np.square(opposite - exact).mean() < 0.9 * np.square(independent - exact).mean()


@pytest.mark.parametrize("pairs", [0, 1, 3])
def test_shares_sum_to_the_whole_effect_with_any_orders(pairs):
    worth, plan = random_worth(SIX, 5), AttributionPlan(SIX, pairs)
    for seed in range(5):
        taken = plan.coalitions(seed)
        assert taken[0] == frozenset() and taken[-1] == frozenset(SIX.factors) and len(set(taken)) == len(taken)
        assert len(taken) == 64 if pairs == 0 else len(taken) <= 2 + 10 * pairs
        shares = plan.shares(seed, {each: worth[each] for each in taken})  # of these coalitions alone
        np.testing.assert_allclose(shares.sum(axis=0), worth[taken[-1]] - worth[taken[0]], atol=1e-13)


def test_all_orders_are_taken_where_they_are_few():
    assert AttributionPlan.of(ABC, None).pairs == 0 and AttributionPlan.of(ABC, 3).pairs == 3
    assert AttributionPlan.of(SIX, None).pairs == 2 and AttributionPlan.of(SIX, 0).pairs == 0
