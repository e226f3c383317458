"""Shapley shares: how much each factor contributes to an effect, from all orders of the factors or from sampled ones.

A factor's share is the change that it makes when it is added, averaged over the orders in which factors can be added
(Shapley 1953). Some act only on top of another, such as a mirror on wet ground: orders in which they would come first
are left out (Faigle and Kern 1992, Int. J. Game Theory 21). The shares sum to the whole effect.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.special import stdtrit

Coalition = frozenset[str]
"""Factors that are present."""
Values = Mapping[Coalition, Float64[np.ndarray, " m"]]
"""Measures of each coalition."""


@dataclass(frozen=True)
class Game:
    """Factors, and those that act only on top of another one."""

    factors: tuple[str, ...]
    after: Mapping[str, str] = field(default_factory=dict[str, str])
    """For a factor, the one that it acts on top of; each bears at most one, so that these form chains."""

    def __post_init__(self) -> None:
        below = list(self.after.values())
        if len(set(below)) < len(below) or not {*self.after, *below} <= set(self.factors):
            raise ValueError(f"factors {', '.join(self.factors)}: each may bear one other of them, got {self.after}")

    @cached_property
    def coalitions(self) -> list[Coalition]:
        """All coalitions that some order passes, from none to all."""
        found: list[Coalition] = []
        for bits in range(1 << len(self.factors)):
            present = frozenset(name for k, name in enumerate(self.factors) if bits >> k & 1)
            if all(self.after[each] in present for each in present if each in self.after):
                found.append(present)
        return sorted(found, key=len)

    def shares(self, values: Values) -> Float64[np.ndarray, "k m"]:
        """Return the share of each factor in the effect on each measure; exact, from the values of all coalitions."""
        total = np.zeros((len(self.factors), len(values[frozenset()])))
        before, behind = self._order_counts
        for present in self.coalitions:
            for k, name in enumerate(self.factors):
                larger = present | {name}
                if name not in present and larger in behind:
                    weight = before[present] * behind[larger] / before[frozenset(self.factors)]
                    total[k] += weight * (values[larger] - values[present])
        return total

    @cached_property
    def _order_counts(self) -> tuple[dict[Coalition, int], dict[Coalition, int]]:
        """Number of orders that lead to each coalition, and of those that lead from it to all factors."""
        before, behind = dict.fromkeys(self.coalitions, 0), dict.fromkeys(self.coalitions, 0)
        before[frozenset()] = behind[frozenset(self.factors)] = 1
        for present in self.coalitions[1:]:
            before[present] = sum(before.get(present - {each}, 0) for each in present)
        for present in self.coalitions[-2::-1]:
            behind[present] = sum(behind.get(present | {each}, 0) for each in self.factors if each not in present)
        return before, behind

    def orders(self, pairs: int, seed: int) -> list[tuple[str, ...]]:
        """Draw orders uniformly, each with its opposite, which cancels much of the sampling error.

        Sampling: Castro, Gomez and Tejada 2009, Computers and Operations Research 36; opposite pairs: Mitchell, Cooper,
        Frank and Holmes 2022, J. Machine Learning Research 23. A function of the seed.
        """
        random = np.random.default_rng([seed, len(self.factors)])
        found: list[tuple[str, ...]] = []
        for _ in range(pairs):
            places = random.permutation(len(self.factors))
            found += [self._in_order(places), self._in_order(len(places) - 1 - places)]
        return found

    def _in_order(self, places: np.ndarray) -> tuple[str, ...]:
        """Factors by their places, where those of a chain take the places of that chain from bottom to top."""
        places = places.copy()
        for chain in self._chains:
            places[chain] = np.sort(places[chain])
        return tuple(self.factors[k] for k in np.argsort(places))

    @cached_property
    def _chains(self) -> list[list[int]]:
        upon = {below: above for above, below in self.after.items()}
        chains: list[list[int]] = []
        for name in self.factors:
            if name not in self.after:
                chain = [name]
                while chain[-1] in upon:
                    chain.append(upon[chain[-1]])
                chains.append([self.factors.index(each) for each in chain])
        return chains


def sampled_shares(
    factors: Sequence[str], orders: Sequence[Sequence[str]], values: Values
) -> Float64[np.ndarray, "k m"]:
    """Return the shares of `factors` as means over `orders`; they sum to the whole effect, whatever the orders."""
    total = np.zeros((len(factors), len(values[frozenset()])))
    for order in orders:
        for smaller, larger in _steps(order):
            (name,) = larger - smaller
            total[factors.index(name)] += values[larger] - values[smaller]
    return total / len(orders)


def _steps(order: Sequence[str]) -> Iterator[tuple[Coalition, Coalition]]:
    for k in range(len(order)):
        yield frozenset(order[:k]), frozenset(order[: k + 1])


# Plan of an attribution: coalitions of each seed

EXACT_UP_TO = 32
"""Number of coalitions up to which all of them are evaluated by default."""
DEFAULT_PAIRS, MAX_PAIRS = 2, 1000


@dataclass(frozen=True)
class AttributionPlan:
    """Coalitions to evaluate for each seed, and the shares that follow."""

    game: Game
    pairs: int
    """Pairs of opposite orders that each seed draws for itself; 0 for all orders."""

    @classmethod
    def of(cls, game: Game, pairs: int | None) -> "AttributionPlan":
        """Plan a game; without `pairs`, all orders where they take at most 32 coalitions, else two pairs."""
        if pairs is None:
            pairs = 0 if len(game.coalitions) <= EXACT_UP_TO else DEFAULT_PAIRS
        return cls(game, pairs)

    def coalitions(self, seed: int) -> list[Coalition]:
        """Coalitions that a seed takes, each once, among them none and all."""
        if not self.pairs:
            return self.game.coalitions
        met = {each for order in self.game.orders(self.pairs, seed) for step in _steps(order) for each in step}
        return [each for each in self.game.coalitions if each in met]

    def shares(self, seed: int, values: Values) -> Float64[np.ndarray, "k m"]:
        """Return the shares of the factors for a seed, from the values of its coalitions."""
        if not self.pairs:
            return self.game.shares(values)
        return sampled_shares(self.game.factors, self.game.orders(self.pairs, seed), values)


def student_interval(values: Sequence[float] | Float64[np.ndarray, " n"]) -> tuple[float, float, float]:
    """Return mean, and lower and upper end of its 95 % interval by Student's t; both NaN for a single value."""
    array = np.asarray(values, np.float64)
    mean, n = float(array.mean()), len(array)
    if n < 2:
        return mean, float("nan"), float("nan")
    half = float(stdtrit(n - 1, 0.975) * array.std(ddof=1) / np.sqrt(n))
    return mean, mean - half, mean + half
