"""Where Gaussians lie: boxes around their centres, in their own units and axes."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from .gaussians import Gaussians

_ROBUST_SHARE = 0.98
"""Share of the opacity along an axis that the robust box keeps; captures have strays far outside."""


_SAMPLES = 1_000_000
"""Gaussians that the robust box looks at, evenly spaced in order: sorting all of 10 million takes seconds."""


class Bounds(NamedTuple):
    """An axis-aligned box."""

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]


def bounds(gaussians: Gaussians) -> Bounds:
    """Box around all centres; without Gaussians a point at the origin."""
    if not len(gaussians):
        return Bounds(np.zeros(3), np.zeros(3))
    columns = gaussians.means.T
    return Bounds(
        np.array([column.min() for column in columns], np.float64),
        np.array([column.max() for column in columns], np.float64),
    )


def robust_bounds(*sets: Gaussians, share: float = _ROBUST_SHARE) -> Bounds:
    """Box that keeps the middle `share` (0..1) of all opacity along each axis; without Gaussians the origin.

    Where everything is fully transparent, every centre counts the same. Of more than a million, an even share counts.
    """
    step = -(-sum(map(len, sets)) // _SAMPLES) or 1
    means = np.concatenate([np.zeros((0, 3), np.float32), *(each.means[::step] for each in sets)])
    weights = np.concatenate([np.zeros(0), *(each.opacities[::step].astype(np.float64) for each in sets)])
    if not weights.sum() > 0:
        weights = np.ones(len(weights))
    ends = [(1 - share) / 2, (1 + share) / 2]
    columns = [_weighted_quantiles(column, weights, ends) for column in means.T] if len(means) else []
    low, high = np.array(columns, np.float64).T if columns else np.zeros((2, 3))
    return Bounds(low, high)


def _weighted_quantiles(
    values: Float32[np.ndarray, " n"], weights: Float64[np.ndarray, " n"], shares: list[float]
) -> Float64[np.ndarray, " s"]:
    """Smallest values that have at least these shares of the weight at or below them."""
    order = np.argsort(values)
    summed = np.cumsum(weights[order])
    index = np.searchsorted(summed, np.array(shares) * summed[-1])
    return values[order[np.minimum(index, len(values) - 1)]].astype(np.float64)
