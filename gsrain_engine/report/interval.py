"""Interval of a figure: its ends, their kind, and over what and how many it was taken."""

import warnings
from collections.abc import Callable, Sequence
from math import isnan, nan
from typing import Any, Literal

import numpy as np
import scipy
from jaxtyping import Float64, Int64, Real
from msgspec import Struct, structs

CONFIDENCE = 0.95
FEW_OBJECTS = 10
"""Number of objects below which a table states that there are few."""

Values = Sequence[float] | Real[np.ndarray, " n"]
Indices = Int64[np.ndarray, "... _"]


class Interval(Struct, frozen=True, rename={"value": "mean"}):
    """A figure and its interval; in JSON the value is called mean. An end is NaN where it can't be known."""

    value: float
    low: float
    high: float
    kind: str
    """Method and probability, such as "Student, 95 %"."""
    over: str
    """Noun in the plural for the population that it was taken over, such as "rain seeds"."""
    n: int
    """Number of these."""

    @classmethod
    def student(cls, values: Values, over: str) -> "Interval":
        """Return the mean and its interval of 95 % by Student's t; the ends are NaN for a single value."""
        array = np.asarray(values, np.float64)
        mean, low, high = float(array.mean()), nan, nan
        if len(array) > 1:
            error = float(scipy.stats.sem(array))
            low, high = scipy.stats.t.interval(CONFIDENCE, len(array) - 1, mean, error) if error > 0 else (mean, mean)
        return cls(mean, float(low), float(high), "Student, 95 %", over, len(array))

    @classmethod
    def wilson(cls, hits: int, of: int, over: str) -> "Interval":
        """Return a share and its interval of 95 % for independent trials (Wilson 1927); 0..1 for none."""
        if not of:
            return cls(nan, 0.0, 1.0, "Wilson, 95 %", over, 0)
        ends = scipy.stats.binomtest(hits, of).proportion_ci(CONFIDENCE, method="wilson")
        return cls(hits / of, float(ends.low), float(ends.high), "Wilson, 95 %", over, of)

    @classmethod
    def spread(cls, values: Values, over: str) -> "Interval":
        """Return the mean, and the lowest and the highest value."""
        array = np.asarray(values, np.float64)
        return cls(float(array.mean()), float(array.min()), float(array.max()), "lowest to highest", over, len(array))

    @classmethod
    def bootstrap(cls, values: Values, over: str, seed: int = 0) -> "Interval":
        """Return the mean and its percentile bootstrap of 95 % (Efron 1979), deterministic for values and seed.

        Infinite values, as the PSNR of equal images, make the mean infinite. For neighboring frames of one drive, which
        are not independent, the interval is too narrow. Raises ValueError without values.
        """
        if not len(values):
            raise ValueError("a mean takes at least one value")
        array = np.asarray(values, np.float64)
        drawn = resampled((array,), np.mean, seed) if len(array) > 1 else array
        low, high = quantiles(drawn, method="inverted_cdf")
        return cls(float(array.mean()), low, high, "bootstrap, 95 %", over, len(array))

    @classmethod
    def over_objects(
        cls, totals: Float64[np.ndarray, "objects seeds"], counts: Float64[np.ndarray, "objects seeds"],
        scenes: Sequence[str],
    ) -> "Interval":  # fmt: skip
        """Return a mean over objects and rain seeds with its bootstrap of 95 %, clustered by scene.

        `totals` are sums over the `counts` images of each object with each seed, `scenes` has each object's. A resample
        draws scenes with replacement, each with all of its objects, or the objects of a single scene, and one seed of
        the rain: the interval covers what as many such objects give in one such rain, and with it the spread by seeds.
        Its ends are NaN for one object with one seed. Deterministic.
        """
        names = list(dict.fromkeys(scenes))
        of, n = "objects", len(totals)
        if len(names) > 1:
            rows = [np.array([each == name for each in scenes]) for name in names]
            totals, counts = (np.stack([each[row].sum(axis=0) for row in rows]) for each in (totals, counts))
            of = f"objects of {len(names)} scenes"

        def mean(units: Indices, seeds: Indices, axis: int) -> Float64[np.ndarray, "..."]:
            seed = seeds[..., :1]
            return totals[units, seed].sum(axis=axis) / counts[units, seed].sum(axis=axis)

        value = float(np.mean(totals.sum(axis=0) / counts.sum(axis=0)))
        # one unit, or one seed, is drawn from two equal ones: SciPy requires two
        drawn = [np.zeros(2, np.int64) if size == 1 else np.arange(size) for size in totals.shape]
        low, high = (nan, nan) if totals.size == 1 else quantiles(resampled(drawn, mean), method="inverted_cdf")
        units = "objects" if len(names) == 1 else "objects, clustered by scene,"
        kind = f"bootstrap over {units} and rain seeds, 95 %"
        return cls(value, low, high, kind, of, n)

    @property
    def half_width(self) -> float:
        return (self.high - self.low) / 2

    @property
    def plain(self) -> dict[str, Any]:
        """Values for JSON, NaN as None."""
        values = {"mean" if name == "value" else name: each for name, each in structs.asdict(self).items()}
        return {name: None if isinstance(each, float) and isnan(each) else each for name, each in values.items()}

    def scaled(self, factor: float) -> "Interval":
        """Return the interval in another unit."""
        ends = factor * self.value, factor * self.low, factor * self.high
        return structs.replace(self, value=ends[0], low=ends[1], high=ends[2])


def quantiles(
    values: Float64[np.ndarray, " n"],
    confidence: float = CONFIDENCE,
    method: Literal["linear", "inverted_cdf"] = "linear",
) -> tuple[float, float]:
    """Return the ends of the middle of some values, without NaN; among infinite values by `inverted_cdf`."""
    outside = (1 - confidence) / 2
    low, high = np.nanquantile(values, (outside, 1 - outside), method=method)
    return float(low), float(high)


def resampled(
    samples: Sequence[np.ndarray],
    statistic: Callable[..., Any],
    seed: int = 0,
    resamples: int = 2000,
    *,
    vectorized: bool = True,
) -> Float64[np.ndarray, " resamples"]:
    """Return a figure of samples that are drawn with replacement, seeded; see `scipy.stats.bootstrap`."""
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        # SciPy also takes percentiles, which here may be of infinite values or NaN; ours are those of `quantiles`
        warnings.simplefilter("ignore", scipy.stats.DegenerateDataWarning)
        return scipy.stats.bootstrap(
            samples, statistic, n_resamples=resamples, method="percentile", vectorized=vectorized,
            rng=np.random.default_rng(seed),
        ).bootstrap_distribution  # fmt: skip
