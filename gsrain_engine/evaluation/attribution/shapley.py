"""Shapley shares: how much each factor contributes to an effect, from all orders of the factors or from sampled ones.

A factor's share is the change that it makes when it is added, averaged over the orders in which factors can be added
(Shapley 1953). Some act only on top of another, such as a mirror on wet ground: these form a chain, which is added as
one, from bottom to top, and divides its own share among its members (a priori unions: Owen 1977). The shares sum to the
whole effect, and a factor without effect leaves those of the others as they are.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from math import factorial

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
    def chains(self) -> list[tuple[str, ...]]:
        """Factors that act on top of each other, from bottom to top; most are alone."""
        upon = {below: above for above, below in self.after.items()}
        chains: list[tuple[str, ...]] = []
        for name in self.factors:
            if name not in self.after:
                chain = [name]
                while chain[-1] in upon:
                    chain.append(upon[chain[-1]])
                chains.append(tuple(chain))
        return chains

    @cached_property
    def coalitions(self) -> list[Coalition]:
        """All coalitions that some order passes, from none to all."""
        found = [frozenset(self.factors)]
        for whole in self._unions(range(len(self.chains))):
            for chain in self.chains:
                if not whole & {*chain}:
                    found += [whole.union(chain[:k]) for k in range(len(chain))]
        return sorted(dict.fromkeys(found), key=lambda each: (len(each), [name not in each for name in self.factors]))

    def _unions(self, numbers: Sequence[int]) -> list[Coalition]:
        """Coalitions of whole chains, by their numbers."""
        sets = [combinations(numbers, size) for size in range(len(self.chains) + 1)]
        return [frozenset(name for k in chosen for name in self.chains[k]) for each in sets for chosen in each]

    def shares(self, values: Values) -> Float64[np.ndarray, "k m"]:
        """Return the share of each factor in the effect on each measure; exact, from the values of all coalitions."""
        total, n = np.zeros((len(self.factors), len(values[frozenset()]))), len(self.chains)
        for own, chain in enumerate(self.chains):
            for before in self._unions([k for k in range(n) if k != own]):
                met = sum(other[0] in before for other in self.chains)
                weight = factorial(met) * factorial(n - met - 1) / factorial(n)
                for k, name in enumerate(chain):
                    change = values[before.union(chain[: k + 1])] - values[before.union(chain[:k])]
                    total[self.factors.index(name)] += weight * change
        return total

    def orders(self, pairs: int, seed: int) -> list[tuple[str, ...]]:
        """Draw orders uniformly, each with its opposite, which cancels much of the sampling error.

        Sampling: Castro, Gomez and Tejada 2009, Computers and Operations Research 36; opposite pairs: Mitchell, Cooper,
        Frank and Holmes 2022, J. Machine Learning Research 23. A function of the seed.
        """
        random = np.random.default_rng([seed, len(self.factors)])
        drawn = [random.permutation(len(self.chains)) for _ in range(pairs)]
        return [tuple(name for k in each for name in self.chains[k]) for one in drawn for each in (one, one[::-1])]


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

EXACT_UP_TO = 64
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
        """Plan a game; without `pairs`, all orders where they take at most 64 coalitions, else two pairs."""
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
