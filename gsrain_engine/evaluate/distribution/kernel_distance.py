"""KID: the kernel distance of two sets of features, without the bias that the Frechet distance has of few pictures."""

import numpy as np
from jaxtyping import Bool, Float, Float64

Features = Float[np.ndarray, "_ d"]

_BLOCK_ROWS = 512


def weighted_distances(
    real: Features,
    fake: Features,
    real_weights: Float64[np.ndarray, "_ k"],
    fake_weights: Float64[np.ndarray, "_ k"],
    shared: Bool[np.ndarray, "_ _"] | None = None,
) -> Float64[np.ndarray, " k"]:
    """Unbiased squared maximum mean discrepancies of two sets of features, with the kernel (x.y / d + 1)^3.

    Pictures count as often as each column of weights says. Binkowski et al. 2018 ("Demystifying MMD GANs", sec. 4);
    without a unit; the expectation is 0 for sets of one distribution at any number of pictures, and above 0 for others;
    single values may lie below 0. Lower is better. A picture is never paired with itself, however often it counts.

    `shared` marks pairs (real, fake) that are one and the same picture: they count no more than a picture with itself
    does within a set. Raises ValueError for fewer than two pictures.
    """
    if min(len(real), len(fake)) < 2:
        raise ValueError(f"{len(real)} real and {len(fake)} fake pictures: KID takes at least two of each")
    within = _within(real, real_weights) + _within(fake, fake_weights)
    return within - 2 * _across(real, fake, real_weights, fake_weights, shared)


def _kernel(rows: Float64[np.ndarray, "_ d"], columns: Float64[np.ndarray, "_ d"]) -> Float64[np.ndarray, "_ _"]:
    near = rows @ columns.T
    near /= rows.shape[1]
    near += 1
    cubed = near * near
    cubed *= near
    return cubed


def _within(features: Features, weights: Float64[np.ndarray, "_ k"]) -> Float64[np.ndarray, " k"]:
    """Mean over pairs of one set: those below the diagonal twice, those with themselves not at all."""
    total = np.zeros(weights.shape[1])
    points = features.astype(np.float64)
    for start in range(0, len(points), _BLOCK_ROWS):
        block = slice(start, start + _BLOCK_ROWS)
        kernel = _kernel(points[block], points[: start + _BLOCK_ROWS])
        at = np.arange(len(kernel))
        kernel[at, start + at] = 0
        kernel[:, :start] *= 2
        total += np.sum((kernel @ weights[: start + _BLOCK_ROWS]) * weights[block], axis=0)
    return _mean(total, np.sum(weights, axis=0) ** 2 - np.sum(weights**2, axis=0))


def _across(
    real: Features,
    fake: Features,
    real_weights: Float64[np.ndarray, "_ k"],
    fake_weights: Float64[np.ndarray, "_ k"],
    shared: Bool[np.ndarray, "_ _"] | None,
) -> Float64[np.ndarray, " k"]:
    total = np.zeros(real_weights.shape[1])
    pairs = np.sum(real_weights, axis=0) * np.sum(fake_weights, axis=0)
    first, second = real.astype(np.float64), fake.astype(np.float64)
    for start in range(0, len(first), _BLOCK_ROWS):
        block = slice(start, start + _BLOCK_ROWS)
        kernel = _kernel(first[block], second)
        if shared is not None:
            kernel[shared[block]] = 0
            pairs = pairs - np.sum((shared[block] @ fake_weights) * real_weights[block], axis=0)
        total += np.sum((kernel @ fake_weights) * real_weights[block], axis=0)
    return _mean(total, pairs)


def _mean(total: Float64[np.ndarray, " k"], pairs: Float64[np.ndarray, " k"]) -> Float64[np.ndarray, " k"]:
    return np.divide(total, pairs, out=np.full_like(total, np.nan), where=pairs > 0)
