"""What a picture's own exposure and white balance did to it: an affine map of colour a view, the mean of all fixed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int64

PULL = 1e-3
"""Tikhonov pull towards no change, in squared colour: what a picture without contrast can't tell."""

SWEEPS = 6
"""Rounds over all views; each takes the others' newest maps."""

_LEAST_PX = 1.0
"""A Gaussian that a view, or all others together, see less of than this says nothing about exposures."""

_MIDDLE = 0.5
_GAIN_LIMITS = 0.2, 5.0
"""So that a map can always be undone: a black picture has no gain."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewAffine:
    """Picture = gains * (colour of the scene - 1/2) + 1/2 + offsets, channel by channel, in display colour."""

    gains: Float64[np.ndarray, "3"]
    offsets: Float64[np.ndarray, "3"]

    def undone(self, picture: Float32[np.ndarray, "*p 3"]) -> Float32[np.ndarray, "*p 3"]:
        shift = _MIDDLE - (self.offsets + _MIDDLE) / self.gains
        return picture * (1 / self.gains).astype(np.float32) + shift.astype(np.float32)


NO_CHANGE = ViewAffine(np.ones(3), np.zeros(3))


def view_affines(
    seen: Sequence[Float32[np.ndarray, "_ 3"]],
    evidence: Sequence[Float32[np.ndarray, " _"]],
    indices: Sequence[Int64[np.ndarray, " _"]],
    count: int,
) -> list[ViewAffine]:
    """Find the maps by comparing what several views see of the same Gaussians.

    Each view's Gaussians are compared with the mean of what all *other* views make of them, weighted by what both see:
    so that a view can't agree with itself, and colours needn't be known. What depends on direction counts as noise.

    Args:
        seen: For each view, what each splat gathers of the picture: the sum of weight * colour.
        evidence: For each view, the sum of each splat's weights in pixels.
        indices: Row of each splat among all Gaussians.
        count: How many Gaussians there are.
    """
    kept = [np.flatnonzero(each >= _LEAST_PX) for each in evidence]
    means = [own[rows] / each[rows, None] for own, each, rows in zip(seen, evidence, kept, strict=True)]
    amounts = [each[rows] for each, rows in zip(evidence, kept, strict=True)]
    places = [each[rows] for each, rows in zip(indices, kept, strict=True)]
    sums, totals = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
    for mean, amount, place in zip(means, amounts, places, strict=True):
        sums[place] += mean * amount[:, None]
        totals[place] += amount
    affines = [NO_CHANGE] * len(means)
    for _ in range(SWEEPS):
        for v, (mean, amount, place) in enumerate(zip(means, amounts, places, strict=True)):
            sums[place] -= affines[v].undone(mean) * amount[:, None]
            others = totals[place] - amount
            both = np.where(others >= _LEAST_PX, amount * others / np.maximum(totals[place], _LEAST_PX), 0)
            affines[v] = _fitted(sums[place] / np.maximum(others, _LEAST_PX)[:, None], mean, both.astype(np.float32))
            sums[place] += affines[v].undone(mean) * amount[:, None]
    return _gauge_fixed(affines)


def _fitted(
    scene: Float32[np.ndarray, "p 3"], picture: Float32[np.ndarray, "p 3"], trust: Float32[np.ndarray, " p"]
) -> ViewAffine:
    """Fit the map that takes the scene's colours to the picture's, by weighted ridge regression towards no change."""
    x, change = scene - np.float32(_MIDDLE), picture - scene
    total = float(trust.sum(dtype=np.float64))
    pull = PULL * total + 1e-9
    mean, square, shift, product = (
        np.einsum("p,pc->c", trust, each, dtype=np.float64) for each in (x, x * x, change, x * change)
    )
    determinant = (square + pull) * (total + pull) - mean**2
    gains = 1 + ((total + pull) * product - mean * shift) / determinant
    offsets = ((square + pull) * shift - mean * product) / determinant
    return ViewAffine(np.clip(gains, *_GAIN_LIMITS), offsets)


def _gauge_fixed(affines: Sequence[ViewAffine]) -> list[ViewAffine]:
    """Make the middle of all maps no change: else the scene could darken and every picture brighten, unseen.

    The same change of the scene's colours is taken out of each, on its scene's side: A_v becomes A_v M^-1. The middle
    is the median, so that one picture of something else does not move it.
    """
    gain = np.median([each.gains for each in affines], axis=0)
    offset = np.median([each.offsets for each in affines], axis=0)
    return [ViewAffine(each.gains / gain, each.offsets - each.gains / gain * offset) for each in affines]
