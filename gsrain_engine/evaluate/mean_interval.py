"""The mean of a measure over pictures, and how far it would vary with other pictures."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

CONFIDENCE = 0.95
_RESAMPLES = 2000


class MeanInterval(NamedTuple):
    """A mean, and the ends between which means of as many such pictures lie with `CONFIDENCE`."""

    mean: float
    low: float
    high: float


def mean_interval(values: Sequence[float], seed: int = 0) -> MeanInterval:
    """Return the mean and its percentile bootstrap (Efron 1979), in the unit of the values.

    The same values and seed give the same ends. Values that are infinite, as the PSNR of equal pictures, stay so in the
    mean. Neighbouring frames of one drive are more alike than pictures drawn at random: of these it is too narrow.
    Raises ValueError without a value.
    """
    if not values:
        raise ValueError("a mean takes at least one value")
    array = np.array(values, np.float64)
    drawn = np.random.default_rng(seed).integers(0, len(array), (_RESAMPLES, len(array)))
    means = array[drawn].mean(axis=1)
    outside = (1 - CONFIDENCE) / 2
    low, high = np.quantile(means, (outside, 1 - outside), method="inverted_cdf")  # picks: infinity has no middle
    return MeanInterval(float(array.mean()), float(low), float(high))
