"""How far a distance would vary with other pictures: confidence intervals by resampling pictures."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64

from .frechet import frechet_distance, rotated
from .kernel_distance import weighted_distances

CONFIDENCE = 0.95

Features = Float[np.ndarray, "_ d"]
Advance = Callable[[], None]


class Interval(NamedTuple):
    """The ends between which a value lies with `CONFIDENCE`."""

    low: float
    high: float


def frechet_interval(
    real: Features,
    fake: Features,
    resamples: int,
    seed: int,
    advance: Advance = lambda: None,
    value: float | None = None,
) -> Interval:
    """Return how far the Frechet distance varies between sets of pictures as large as these.

    Pictures of each set are drawn again with repeats (Efron 1979). Resamples hold fewer different pictures and so their
    distances are too high, as those of few pictures are; that shift is taken out: the interval is the value plus the
    quantiles of the resampled distances around their mean. It tells nothing of how far the value itself is too high for
    want of pictures: `small_samples` does. Of few pictures it is rather too wide (of 32 with 64 features by half); of
    pictures that are alike, such as neighbouring frames of a drive, too narrow, for it takes them for independent.
    `advance` is called after each resample. `value` is the distance itself, where it is known.
    """
    value = frechet_distance(real, fake) if value is None else value
    points = rotated(real, fake)
    distances: list[float] = []
    for chosen in _drawn(len(real), len(fake), resamples, seed):
        distances.append(frechet_distance(*points, (_counts(chosen[0], len(real)), _counts(chosen[1], len(fake)))))
        advance()
    shifts = np.array(distances) - np.mean(distances)
    interval = quantiles(shifts)
    return Interval(max(value + interval.low, 0.0), value + interval.high)


def kernel_interval(
    real: Features, fake: Features, resamples: int, seed: int, shared: Bool[np.ndarray, "_ _"] | None = None
) -> Interval:
    """Return how far KID varies between sets of pictures as large as these; nothing is shifted, for it has no bias.

    Pictures are taken for independent, as in `frechet_interval`; `shared` is that of `weighted_distances`.
    """
    return kernel_estimate(real, fake, resamples, seed, shared)[1]


def kernel_estimate(
    real: Features, fake: Features, resamples: int, seed: int, shared: Bool[np.ndarray, "_ _"] | None = None
) -> tuple[float, Interval]:
    """Return KID with its `kernel_interval`; kernels are made once for both."""
    weights = [np.ones((len(each), 1 + resamples)) for each in (real, fake)]
    for k, chosen in enumerate(_drawn(len(real), len(fake), resamples, seed)):
        for own, drawn in zip(weights, chosen, strict=True):
            own[:, 1 + k] = _counts(drawn, len(own))
    values = weighted_distances(real, fake, weights[0], weights[1], shared)
    return float(values[0]), quantiles(values[1:])


def quantiles(values: Float64[np.ndarray, " n"]) -> Interval:
    """Return the ends of the middle `CONFIDENCE` of some values."""
    outside = (1 - CONFIDENCE) / 2
    low, high = np.nanquantile(values, (outside, 1 - outside))
    return Interval(float(low), float(high))


def _counts(drawn: Int64[np.ndarray, " n"], pictures: int) -> Int64[np.ndarray, " _"]:
    return np.bincount(drawn, minlength=pictures)


def _drawn(
    real: int, fake: int, resamples: int, seed: int
) -> Iterator[tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " m"]]]:
    """Yield numbers of pictures, with repeats; at least two different ones of each set, as every distance needs."""
    random = np.random.default_rng(seed)
    for _ in range(resamples):
        yield _some(random, real), _some(random, fake)


def _some(random: np.random.Generator, count: int) -> Int64[np.ndarray, " n"]:
    while True:
        drawn = random.integers(0, count, count)
        if (drawn != drawn[0]).any():
            return drawn
