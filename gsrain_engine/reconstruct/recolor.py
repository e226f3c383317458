"""New colours for fixed geometry: linear least squares in the spherical harmonics, by conjugate gradients."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Int64

from gsrain_engine.raster.view_weights import ViewWeights

TIKHONOV = 0.3
"""Pull towards the prior: a Gaussian whose squared weights sum to this over all views goes half the way, if alone."""

DIRECTIONAL_TIKHONOV = 4.0
"""How much stronger the pull is on harmonics above degree 0: few views say little about directions."""


@dataclass(frozen=True, slots=True, eq=False)
class ColorTarget:
    """What one view says about the colours."""

    weights: ViewWeights
    indices: Int64[np.ndarray, " m"]
    """Row of each of the view's splats among all unknowns."""
    basis: Float32[np.ndarray, "m k"]
    """Harmonics that each splat is seen through; 0 forbids one."""
    residual: Float32[np.ndarray, "h w 3"]
    """Premultiplied image that is wanted, minus what the prior colours give."""


def solve_colors(
    targets: Sequence[ColorTarget], count: int, iterations: int = 12, tikhonov: float = TIKHONOV
) -> Generator[float, None, Float32[np.ndarray, "n k 3"]]:
    """Find the change d of the harmonics that minimizes sum |W d - residual|^2 + tikhonov |d|^2 over all views.

    Preconditioned conjugate gradients on the normal equations (Hestenes and Stiefel 1952) with the exact diagonal as
    Jacobi preconditioner; one blending and one accumulation a view and iteration. The model is linear: the max(0, .)
    that a renderer puts on a splat's colour is left out.

    Yields:
        After each iteration, the preconditioned residual's length compared with the start, in (0, 1] as a rule.

    Returns:
        The change of the harmonics, to be added to the prior's.
    """
    k = targets[0].basis.shape[1]
    pull = tikhonov * np.where(np.arange(k) == 0, 1, DIRECTIONAL_TIKHONOV).astype(np.float32)[:, None]
    diagonal = np.broadcast_to(pull, (count, k, 1)).copy()
    remainder = np.zeros((count, k, 3), np.float32)
    for target in targets:
        squares = target.weights.squared_sums()[:, None] * target.basis**2
        diagonal[target.indices] += squares[..., None]
        _add_seen(remainder, target.indices, target.basis, target.weights.accumulate(target.residual))
    change = np.zeros_like(remainder)
    conditioned = remainder / diagonal
    direction = conditioned.copy()
    slope = start = _dot(remainder, conditioned)
    for _ in range(iterations):
        if slope <= 1e-12 * start:
            break
        image = apply_normal(targets, direction) + pull * direction
        step = np.float32(slope / _dot(direction, image))
        change += step * direction
        remainder -= step * image
        conditioned = remainder / diagonal
        slope, before = _dot(remainder, conditioned), slope
        direction = conditioned + np.float32(slope / before) * direction
        yield float(np.sqrt(slope / start))
    return change


def apply_normal(targets: Sequence[ColorTarget], change: Float32[np.ndarray, "n k 3"]) -> Float32[np.ndarray, "n k 3"]:
    """W^T W times a change of the harmonics, summed over the views in order."""
    result = np.zeros_like(change)
    for target in targets:
        image = target.weights.blend(colors_seen(change, target.indices, target.basis))
        _add_seen(result, target.indices, target.basis, target.weights.accumulate(image))
    return result


@numba.njit(parallel=True, cache=True)
@no_type_check
def colors_seen(
    sh: Float32[np.ndarray, "n k 3"], indices: Int64[np.ndarray, " m"], basis: Float32[np.ndarray, "m k"]
) -> Float32[np.ndarray, "m 3"]:
    """Sum of harmonics of each splat, without the 0.5 of 3DGS."""
    colors = np.zeros((len(indices), 3), np.float32)
    for n in numba.prange(len(indices)):
        for k in range(basis.shape[1]):
            for channel in range(3):
                colors[n, channel] += basis[n, k] * sh[indices[n], k, channel]
    return colors


@numba.njit(parallel=True, cache=True)
@no_type_check
def _add_seen(sh, indices, basis, colors):
    """Transpose of `colors_seen`, added in place. A view sees each Gaussian once: no two rows meet."""
    for n in numba.prange(len(indices)):
        for k in range(basis.shape[1]):
            for channel in range(3):
                sh[indices[n], k, channel] += basis[n, k] * colors[n, channel]


def _dot(left: Float32[np.ndarray, "n k 3"], right: Float32[np.ndarray, "n k 3"]) -> float:
    return float(np.sum(left * right, dtype=np.float64))
