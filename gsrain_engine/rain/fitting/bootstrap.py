"""Resampled minutes: how far a fit would have come out otherwise."""

import numpy as np
from jaxtyping import Float64

from ..calibration import Interval

FEWEST_MINUTES = 5
"""Fewer say nothing about how minutes differ."""

_TAILS = (0.025, 0.975)


def resampling_weights(minutes: int, resamples: int, generator: np.random.Generator) -> Float64[np.ndarray, "r m"]:
    """How often each minute is drawn in each resample: as many as there are, with replacement (Efron, 1979)."""
    return generator.multinomial(minutes, np.full(minutes, 1 / minutes), size=resamples).astype(np.float64)


def interval(values: Float64[np.ndarray, " resamples"]) -> Interval:
    """The middle 95 %, to four digits."""
    low, high = np.quantile(values, _TAILS)
    return rounded(low), rounded(high)


def rounded(value: float) -> float:
    """Four digits: more than any of these numbers is worth."""
    return float(f"{value:.4g}")
