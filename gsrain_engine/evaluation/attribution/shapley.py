"""Shapley shares: how much each factor contributes to an effect, exactly, from all coalitions of the factors.

A factor's share is the change that it makes when it is added, averaged over the orders in which factors can be added
(Shapley 1953). The shares sum to the whole effect, and a factor without effect has none.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from math import factorial

import numpy as np
from jaxtyping import Float64

Coalition = frozenset[str]
"""Factors that are present."""
Values = Mapping[Coalition, Float64[np.ndarray, " m"]]
"""Measures of each coalition."""

MAX_FACTORS = 9
"""Number of factors whose coalitions, 512, can all be evaluated."""


def coalitions_of(factors: Sequence[str]) -> list[Coalition]:
    """Return all coalitions of factors, from none to all. Raises ValueError for more than nine factors."""
    if len(factors) > MAX_FACTORS:
        raise ValueError(f"attribute: expected at most {MAX_FACTORS} factors, got {len(factors)}")
    return [frozenset(chosen) for size in range(len(factors) + 1) for chosen in combinations(factors, size)]


def shapley_shares(factors: Sequence[str], values: Values) -> Float64[np.ndarray, "k m"]:
    """Return the share of each factor in the effect on each measure, from the values of all coalitions."""
    total, n = np.zeros((len(factors), len(values[frozenset()]))), len(factors)
    for before in coalitions_of(factors)[:-1]:
        weight = factorial(len(before)) * factorial(n - len(before) - 1) / factorial(n)
        for k, name in enumerate(factors):
            if name not in before:
                total[k] += weight * (values[before | {name}] - values[before])
    return total
