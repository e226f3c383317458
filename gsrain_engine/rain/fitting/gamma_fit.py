"""The gamma law of drop diameters (paper, eq. 8) fitted to histograms: maximum likelihood, and moments beside it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy import special

SHAPES = (0.2, 200.0)
SCALES_MM = (1e-3, 10.0)
"""Fits stay within these: beyond, a histogram doesn't look like rain."""

_LOW, _HIGH = np.log(np.array([SHAPES, SCALES_MM]).T)
_STEP = 1e-4  # of the numerical derivative, in ln shape and ln scale
_LONGEST = 0.5
_ARRIVED = 1e-7
_ROUNDS, _HALVINGS = 100, 12
_TINY = 1e-300


class GammaLaws(NamedTuple):
    """One law each histogram."""

    shape: Float64[np.ndarray, " fits"]
    scale_mm: Float64[np.ndarray, " fits"]


def class_shares(
    laws: GammaLaws, edges_mm: Float64[np.ndarray, " classes_and_one"]
) -> Float64[np.ndarray, "fits classes"]:
    """Share of the uncut law's drops in each class; from the upper tail above the mean, where the lower one is 1."""
    shape, scale = laws.shape[:, None], laws.scale_mm[:, None]
    x = edges_mm / scale
    below, above = np.diff(special.gammainc(shape, x)), -np.diff(special.gammaincc(shape, x))
    return np.where(x[:, :-1] > shape, above, below)


def fit_by_likelihood(
    density: Float64[np.ndarray, "fits classes"], edges_mm: Float64[np.ndarray, " classes_and_one"]
) -> GammaLaws:
    """Maximize sum_i n_i ln p_i, where p_i is class i's share among these classes: binned and truncated likelihood.

    `density` is the number of drops in the air by diameter class, in any unit. Fisher scoring in ln shape and ln scale,
    all fits at once, with steps halved until the likelihood rises. Raises `ValueError` for a histogram with fewer than
    three occupied classes: two numbers can't be fitted to it.
    """
    if np.any((density > 0).sum(axis=1) < 3):
        raise ValueError("a gamma law needs drops in at least three diameter classes")
    observed = density / density.sum(axis=1, keepdims=True)
    moments = fit_by_moments(density, edges_mm)
    shape = np.clip(moments.shape, *SHAPES)
    at = np.clip(np.log(np.stack([shape, moments.shape * moments.scale_mm / shape], axis=1)), _LOW, _HIGH)
    climbing = np.arange(len(at))
    for _ in range(_ROUNDS):
        ahead = _climb(at[climbing], observed[climbing], edges_mm)
        moved = np.abs(ahead - at[climbing]).max(axis=1) > _ARRIVED
        at[climbing] = ahead
        climbing = climbing[moved]
        if not climbing.size:
            break
    shape, scale = np.exp(at).T
    return GammaLaws(shape, scale)


def fit_by_moments(
    density: Float64[np.ndarray, "fits classes"], edges_mm: Float64[np.ndarray, " classes_and_one"]
) -> GammaLaws:
    """Shape and scale from mean and variance of the diameters, blind to what lies outside the classes.

    The variance is Sheppard's: less w^2/12 of the class width w, which sorting into classes has added.
    """
    share = density / density.sum(axis=1, keepdims=True)
    middle, width = 0.5 * (edges_mm[:-1] + edges_mm[1:]), np.diff(edges_mm)
    mean = share @ middle
    variance = (share * ((middle - mean[:, None]) ** 2 - width**2 / 12)).sum(axis=1)
    variance = np.maximum(variance, 1e-3 * mean**2)
    return GammaLaws(mean**2 / variance, variance / mean)


def _climb(
    at: Float64[np.ndarray, "fits 2"],
    observed: Float64[np.ndarray, "fits classes"],
    edges_mm: Float64[np.ndarray, " classes_and_one"],
) -> Float64[np.ndarray, "fits 2"]:
    """One step up for each fit; where even a small one leads down, the fit stays."""
    step = _scoring_step(at, observed, edges_mm)
    step /= np.maximum(
        np.abs(step).max(axis=1, keepdims=True) / _LONGEST, 1
    )  # each by itself would turn it off its way
    likelihood = (observed * _log_shares(at, edges_mm)).sum(axis=1)
    reached, searching = at.copy(), np.arange(len(at))
    for _ in range(_HALVINGS):
        ahead = np.clip(at[searching] + step[searching], _LOW, _HIGH)
        better = (observed[searching] * _log_shares(ahead, edges_mm)).sum(axis=1) > likelihood[searching]
        reached[searching[better]] = ahead[better]
        searching = searching[~better]
        if not searching.size:
            break
        step[searching] *= 0.5
    return reached


def _log_shares(
    at: Float64[np.ndarray, "fits 2"], edges_mm: Float64[np.ndarray, " classes_and_one"]
) -> Float64[np.ndarray, "fits classes"]:
    """Log of each class's share among these classes."""
    shares = np.maximum(class_shares(GammaLaws(*np.exp(at).T), edges_mm), _TINY)
    return np.log(shares) - np.log(shares.sum(axis=1, keepdims=True))


def _scoring_step(
    at: Float64[np.ndarray, "fits 2"],
    observed: Float64[np.ndarray, "fits classes"],
    edges_mm: Float64[np.ndarray, " classes_and_one"],
) -> Float64[np.ndarray, "fits 2"]:
    slopes = np.stack(
        [(_log_shares(at + h, edges_mm) - _log_shares(at - h, edges_mm)) / (2 * _STEP) for h in _STEP * np.eye(2)],
        axis=2,
    )
    score = np.einsum("fc,fcp->fp", observed, slopes)
    information = np.einsum("fc,fcp,fcq->fpq", np.exp(_log_shares(at, edges_mm)), slopes, slopes)
    step = np.linalg.solve(information + 1e-9 * np.eye(2), score[:, :, None])[:, :, 0]
    for bound, free in ((0, 1), (1, 0)):  # one that stands at its limit and wants out lets the other go its own way
        stuck = ((at[:, bound] <= _LOW[bound]) & (step[:, bound] < 0)) | (
            (at[:, bound] >= _HIGH[bound]) & (step[:, bound] > 0)
        )
        alone = score[:, free] / (information[:, free, free] + 1e-9)
        step[:, free] = np.where(stuck, alone, step[:, free])
        step[:, bound] = np.where(stuck, 0, step[:, bound])
    return step
