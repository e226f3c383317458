"""What the Frechet distance is for want of pictures alone: its value where both sets come from one distribution."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64

from .bootstrap import Advance, Interval, quantiles
from .extractor import Extractor
from .frechet import frechet_distance, rotated

Features = Float[np.ndarray, "_ d"]

NOTABLE_SHARE = 0.1
"""From this share of a distance on, what it owes to few pictures is worth a warning."""


@dataclass(frozen=True, slots=True)
class SameDistribution:
    """Frechet distances of sets of one distribution, as large as those that were compared."""

    mean: float
    interval: Interval


def same_distribution(
    real: Features, fake: Features, splits: int, seed: int, advance: Advance = lambda: None
) -> SameDistribution:
    """Estimate the Frechet distance that two sets of one distribution would have at these numbers of pictures.

    The mean of each set is taken out (and what that takes off its spread put back), all pictures are mixed, dealt out
    at random into sets of the same sizes, and compared. Of N pictures with d features it is about as large as the
    spread of the features itself until N is many times d: at N = 32 FID is mostly this. It is exact where both sets
    have one covariance, else that of their mixture. `advance` is called after each split.
    """
    random = np.random.default_rng(seed)
    points = np.concatenate([_centred(each) for each in rotated(real, fake)])
    distances: list[float] = []
    for _ in range(splits):
        mixed = points[random.permutation(len(points))]
        distances.append(frechet_distance(mixed[: len(real)], mixed[len(real) :]))
        advance()
    values = np.array(distances)
    return SameDistribution(float(values.mean()), quantiles(values))


def warning(extractor: Extractor, value: float, counts: tuple[int, int], same: SameDistribution) -> str | None:
    """Return one sentence where the number of pictures says more than the pictures do; None where it does not."""
    if same.mean < NOTABLE_SHARE * value:
        return None
    said = (
        f"for want of pictures ({counts[0]} and {counts[1]} for {extractor.features} features) the "
        f"{extractor.metric} of two such sets of one distribution would be about {same.mean:.4g} "
        f"({same.interval.low:.4g} to {same.interval.high:.4g}): "
    )
    if value <= same.interval.high:
        return f"{said}{value:.4g} tells no difference"
    return f"{said}compare {value:.4g} only with values of as many pictures, or take {extractor.kernel_metric}"


def _centred(points: Float64[np.ndarray, "n r"]) -> Float64[np.ndarray, "n r"]:
    return (points - points.mean(axis=0)) * np.sqrt(len(points) / (len(points) - 1))
