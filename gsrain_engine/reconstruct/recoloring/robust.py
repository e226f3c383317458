"""How far pictures can be trusted that disagree with the others: weights of iteratively reweighted least squares."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32, Float64

VIEW_LIMIT = 2.0
"""A view whose typical error is up to so many times the median view's counts in full."""

PIXEL_LIMIT = 6.0
"""Errors beyond so many standard deviations count no longer by their square."""

LEAST_SPREAD = 1 / 255
"""What eight bits can't tell is no disagreement."""

_QUANTILE, _NORMAL = 0.9, 1.645
"""Errors are told by the largest tenth: half the pixels of a road or a wall are explained at once, and say nothing
about how far the others may be off. Of a normal distribution that is so many standard deviations."""

_SPACING_PX = 3
"""Every third pixel each way says enough about a quantile."""


def spread(residual: Float32[np.ndarray, "h w 3"], counted: Bool[np.ndarray, "h w"]) -> float:
    """Typical error of a picture: the standard deviation that its quantiles tell; 0 where no pixel is counted."""
    some = residual[::_SPACING_PX, ::_SPACING_PX][counted[::_SPACING_PX, ::_SPACING_PX]]
    return float(np.quantile(np.abs(some), _QUANTILE)) / _NORMAL if some.size else 0.0


def view_trust(spreads: Sequence[float]) -> Float64[np.ndarray, " v"]:
    """Trust in each view by its spread: 1 up to the limit, then falling with the fourth power.

    The error such a view adds to the sum of squares falls the further off it is (a redescending influence, as that of
    Geman and McClure 1985): a picture that shows something else altogether has no say.
    """
    scaled = np.maximum(np.asarray(spreads, np.float64), LEAST_SPREAD)
    limit = VIEW_LIMIT * np.median(scaled)
    return (limit / np.maximum(scaled, limit)) ** 4


def pixel_trust(residual: Float32[np.ndarray, "h w 3"], typical: float) -> Float32[np.ndarray, "h w"]:
    """Trust in each pixel by its error, all channels together (Huber 1964): 1 up to the limit, then falling.

    `typical` is the standard deviation of a channel in a view that agrees.
    """
    limit = np.float32(PIXEL_LIMIT * np.sqrt(3) * max(typical, LEAST_SPREAD))
    length = np.sqrt(np.einsum("hwc,hwc->hw", residual, residual))
    return limit / np.maximum(length, limit)
