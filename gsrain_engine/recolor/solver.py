"""Color solver for fixed geometry: linear least squares in the spherical harmonics, by conjugate gradients."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32, Int64

from ..kernels import kernel, range_of
from .weights import LazyWeights, Picture, Plane, SplatColors, StoredWeights

Harmonics = Float32[np.ndarray, "n k 3"]
Rows = Int64[np.ndarray, " m"]
Basis = Float32[np.ndarray, "m k"]

TIKHONOV = 0.3  # prior weight: a Gaussian whose squared weights sum to this over all views moves halfway, if alone


@dataclass(frozen=True, slots=True, eq=False)
class ColorTarget:
    """Data term of one view."""

    weights: StoredWeights | LazyWeights
    indices: Rows
    """Row of each of the view's splats among all unknowns."""
    basis: Basis
    """Harmonics in each splat's view direction; 0 disables one."""
    residual: Picture
    """Premultiplied target image minus the image of the current colors."""
    trust: Plane
    """Weight of each pixel, 0 to 1."""


class SolverStep(NamedTuple):
    """State of the solver after an iteration."""

    length: float
    """Norm of the preconditioned residual relative to the start; usually in (0, 1]."""
    change: Harmonics
    """Current change of the harmonics; the solver overwrites it in later iterations."""


def solve_colors(
    targets: Sequence[ColorTarget],
    count: int,
    iterations: int,
    prior_weights: Float32[np.ndarray, "_ k 1"],
    offset: Harmonics | None = None,
) -> Generator[SolverStep, None, Harmonics]:
    """Find the change d of `count` Gaussians' harmonics that explains the views; yields the state after each iteration.

    It minimizes the sum over views of |sqrt(trust) (W d - residual)|^2, plus weights |d + offset|^2.

    Preconditioned conjugate gradients on the normal equations (Hestenes and Stiefel 1952) with the exact diagonal as
    Jacobi preconditioner; each iteration applies W of each view and its transpose once, and convergence ends it early.
    The model is linear: it omits the renderer's max(0, .) on splat colors. `prior_weights` are those of each Gaussian,
    or one for all, `offset` the initial difference of the harmonics from their prior, None for zero.
    """
    k = targets[0].basis.shape[1]
    diagonal = np.broadcast_to(prior_weights, (count, k, 1)).copy()
    remainder = np.zeros((count, k, 3), np.float32) if offset is None else -prior_weights * offset
    for target in targets:
        squares = target.weights.squared_sums(target.trust)[:, None] * target.basis**2
        diagonal[target.indices] += squares[..., None]
        gathered = target.weights.accumulate(target.residual * target.trust[..., None])
        add_colors_transposed(remainder, target.indices, target.basis, gathered)
    change = np.zeros_like(remainder)
    direction = np.empty_like(remainder)
    slope = start = _summed(_condition, remainder, diagonal, np.float32(0), direction)
    for _ in range(iterations):
        if slope <= 1e-12 * start:
            break
        image = apply_normal(targets, direction)
        step = np.float32(slope / _summed(_curvature, image, direction, prior_weights))
        _advance(change, remainder, direction, image, step)
        before, slope = slope, _summed(_sloped, remainder, diagonal)
        _summed(_condition, remainder, diagonal, np.float32(slope / before), direction)
        yield SolverStep(float(np.sqrt(slope / start)), change)
    return change


def apply_normal(targets: Sequence[ColorTarget], change: Harmonics) -> Harmonics:
    """W^T trust W times a change of the harmonics, summed over the views in order."""
    result = np.zeros_like(change)
    for target in targets:
        gathered = target.weights.normal(evaluate_colors(change, target.indices, target.basis), target.trust)
        add_colors_transposed(result, target.indices, target.basis, gathered)
    return result


def evaluate_colors(sh: Harmonics, indices: Rows, basis: Basis) -> SplatColors:
    """Sum of harmonics of each splat, without the 0.5 of 3DGS."""
    colors = np.empty((len(indices), 3), np.float32)
    _evaluate(sh, indices, basis, colors)
    return colors


@kernel(parallel=True)
@no_type_check
def _evaluate(portion, sh, indices, basis, colors):
    for n in range_of(portion, len(indices)):
        row = sh[indices[n]]
        red = green = blue = np.float32(0)
        for k in range(basis.shape[1]):
            value = basis[n, k]
            red += value * row[k, 0]
            green += value * row[k, 1]
            blue += value * row[k, 2]
        colors[n, 0], colors[n, 1], colors[n, 2] = red, green, blue


@kernel(parallel=True)
@no_type_check
def add_colors_transposed(portion, sh: Harmonics, indices: Rows, basis: Basis, colors: SplatColors) -> None:
    """Transpose of `evaluate_colors`, added in place; parallel over rows, since indices are unique within a view."""
    for n in range_of(portion, len(indices)):
        row = sh[indices[n]]
        for k in range(basis.shape[1]):
            value = basis[n, k]
            for channel in range(3):
                row[k, channel] += value * colors[n, channel]


_CHUNKS = 64  # sums run over this number of chunks in order: byte-identical for any number of threads


def _summed(kernel: Callable[..., None], *arguments: Any) -> float:
    sums = np.zeros(_CHUNKS)
    kernel(*arguments, sums)
    return float(sums.sum())


@kernel(parallel=True)
@no_type_check
def _condition(portion, remainder, diagonal, turn, direction, sums):
    """Compute direction = remainder / diagonal + turn * direction; sum up remainder . (remainder / diagonal)."""
    n, k = remainder.shape[:2]
    for chunk in range_of(portion, _CHUNKS):
        total = 0.0
        for i in range(n * chunk // _CHUNKS, n * (chunk + 1) // _CHUNKS):
            for j in range(k):
                for channel in range(3):
                    conditioned = remainder[i, j, channel] / diagonal[i, j, 0]
                    total += remainder[i, j, channel] * conditioned
                    before = turn * direction[i, j, channel] if turn != 0 else np.float32(0)
                    direction[i, j, channel] = conditioned + before
        sums[chunk] = total


@kernel(parallel=True)
@no_type_check
def _sloped(portion, remainder, diagonal, sums):
    n, k = remainder.shape[:2]
    for chunk in range_of(portion, _CHUNKS):
        total = 0.0
        for i in range(n * chunk // _CHUNKS, n * (chunk + 1) // _CHUNKS):
            for j in range(k):
                for channel in range(3):
                    total += remainder[i, j, channel] * remainder[i, j, channel] / diagonal[i, j, 0]
        sums[chunk] = total


@kernel(parallel=True)
@no_type_check
def _curvature(portion, image, direction, prior_weights, sums):
    n, k = image.shape[:2]
    for chunk in range_of(portion, _CHUNKS):
        total = 0.0
        for i in range(n * chunk // _CHUNKS, n * (chunk + 1) // _CHUNKS):
            own = i if len(prior_weights) > 1 else 0
            for j in range(k):
                for channel in range(3):
                    image[i, j, channel] += prior_weights[own, j, 0] * direction[i, j, channel]
                    total += direction[i, j, channel] * image[i, j, channel]
        sums[chunk] = total


@kernel(parallel=True)
@no_type_check
def _advance(portion, change, remainder, direction, image, step):
    n, k = change.shape[:2]
    for i in range_of(portion, n):
        for j in range(k):
            for channel in range(3):
                change[i, j, channel] += step * direction[i, j, channel]
                remainder[i, j, channel] -= step * image[i, j, channel]
