"""Color solver for fixed geometry: linear least squares in the spherical harmonics, by conjugate gradients."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, no_type_check, runtime_checkable

import numba
import numpy as np
from jaxtyping import Float32, Int64
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

TIKHONOV = 0.3
"""Prior weight: a Gaussian whose squared weights sum to this over all views moves halfway, if alone."""

DIRECTIONAL_TIKHONOV = 4.0
"""Factor of the prior weight above degree 0: few views carry little information about directions."""


@runtime_checkable
class WeightOperator(Protocol):
    """Blending weights of one view as a linear operator W on the colors of its splats."""

    def blend(self, colors: Float32[np.ndarray, "m 3"], /) -> Float32[np.ndarray, "h w 3"]:
        """W times colors: the premultiplied image."""
        ...

    def accumulate(self, image: Float32[np.ndarray, "h w 3"], /) -> Float32[np.ndarray, "m 3"]:
        """W transposed times an image."""
        ...

    def normal(
        self, colors: Float32[np.ndarray, "m 3"], trust: Float32[np.ndarray, "h w"], /
    ) -> Float32[np.ndarray, "m 3"]:
        """W transposed times trust times W times colors."""
        ...

    def squared_sums(self, trust: Float32[np.ndarray, "h w"], /) -> Float32[np.ndarray, " m"]:
        """Diagonal of W transposed times trust times W."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ColorTarget:
    """Data term of one view."""

    weights: WeightOperator
    indices: Int64[np.ndarray, " m"]
    """Row of each of the view's splats among all unknowns."""
    basis: Float32[np.ndarray, "m k"]
    """Harmonics in each splat's view direction; 0 disables one."""
    residual: Float32[np.ndarray, "h w 3"]
    """Premultiplied target image minus the image of the current colors."""
    trust: Float32[np.ndarray, "h w"]
    """Weight of each pixel, 0 to 1."""


class SolverStep(NamedTuple):
    """State of the solver after an iteration."""

    length: float
    """Norm of the preconditioned residual relative to the start; usually in (0, 1]."""
    change: Float32[np.ndarray, "n k 3"]
    """Current change of the harmonics; the solver overwrites it in later iterations."""


def solve_colors(
    targets: Sequence[ColorTarget],
    count: int,
    iterations: int,
    pull: Float32[np.ndarray, "_ k 1"],
    offset: Float32[np.ndarray, "n k 3"] | None = None,
) -> Generator[SolverStep, None, Float32[np.ndarray, "n k 3"]]:
    """Find the change d of `count` Gaussians' harmonics that explains the views.

    It minimizes the sum over views of |sqrt(trust) (W d - residual)|^2, plus pull |d + offset|^2.

    Preconditioned conjugate gradients on the normal equations (Hestenes and Stiefel 1952) with the exact diagonal as
    Jacobi preconditioner; each iteration applies W of each view and its transpose once. The model is linear: it omits
    the renderer's max(0, .) on splat colors.

    Args:
        targets: The views.
        count: Number of unknown Gaussians.
        iterations: Maximum number; it stops earlier at convergence.
        pull: Prior weight of each Gaussian, or one for all.
        offset: Initial difference of the harmonics from their prior; None for zero.

    Yields:
        The state after each iteration.

    Returns:
        The change of the harmonics.
    """
    k = targets[0].basis.shape[1]
    diagonal = np.broadcast_to(pull, (count, k, 1)).copy()
    remainder = np.zeros((count, k, 3), np.float32) if offset is None else -pull * offset
    for target in targets:
        squares = target.weights.squared_sums(target.trust)[:, None] * target.basis**2
        diagonal[target.indices] += squares[..., None]
        gathered = target.weights.accumulate(target.residual * target.trust[..., None])
        add_colors_transposed(remainder, target.indices, target.basis, gathered)
    change = np.zeros_like(remainder)
    direction = np.empty_like(remainder)
    slope = start = _condition(remainder, diagonal, np.float32(0), direction)
    for _ in range(iterations):
        if slope <= 1e-12 * start:
            break
        image = apply_normal(targets, direction)
        step = np.float32(slope / _pulled(image, direction, pull))
        _advance(change, remainder, direction, image, step)
        before, slope = slope, _sloped(remainder, diagonal)
        _condition(remainder, diagonal, np.float32(slope / before), direction)
        yield SolverStep(float(np.sqrt(slope / start)), change)
    return change


def apply_normal(targets: Sequence[ColorTarget], change: Float32[np.ndarray, "n k 3"]) -> Float32[np.ndarray, "n k 3"]:
    """W^T trust W times a change of the harmonics, summed over the views in order."""
    result = np.zeros_like(change)
    for target in targets:
        gathered = target.weights.normal(evaluate_colors(change, target.indices, target.basis), target.trust)
        add_colors_transposed(result, target.indices, target.basis, gathered)
    return result


@numba.njit(parallel=True, cache=True)
@no_type_check
def evaluate_colors(
    sh: Float32[np.ndarray, "n k 3"], indices: Int64[np.ndarray, " m"], basis: Float32[np.ndarray, "m k"]
) -> Float32[np.ndarray, "m 3"]:
    """Sum of harmonics of each splat, without the 0.5 of 3DGS."""
    colors = np.empty((len(indices), 3), np.float32)
    for n in numba.prange(len(indices)):
        row = sh[indices[n]]
        red = green = blue = np.float32(0)
        for k in range(basis.shape[1]):
            value = basis[n, k]
            red += value * row[k, 0]
            green += value * row[k, 1]
            blue += value * row[k, 2]
        colors[n, 0], colors[n, 1], colors[n, 2] = red, green, blue
    return colors


@numba.njit(parallel=True, cache=True)
@no_type_check
def add_colors_transposed(
    sh: Float32[np.ndarray, "n k 3"],
    indices: Int64[np.ndarray, " m"],
    basis: Float32[np.ndarray, "m k"],
    colors: Float32[np.ndarray, "m 3"],
) -> None:
    """Transpose of `evaluate_colors`, added in place; parallel over rows, since indices are unique within a view."""
    for n in numba.prange(len(indices)):
        row = sh[indices[n]]
        for k in range(basis.shape[1]):
            value = basis[n, k]
            for channel in range(3):
                row[k, channel] += value * colors[n, channel]


_CHUNKS = 64  # sums run over this number of chunks in order: byte-identical for any number of threads


@numba.njit(parallel=True, cache=True)
@no_type_check
def _condition(remainder, diagonal, turn, direction):
    """Compute direction = remainder / diagonal + turn * direction; return remainder . (remainder / diagonal)."""
    n, k = remainder.shape[:2]
    sums = np.zeros(_CHUNKS)
    for chunk in numba.prange(_CHUNKS):
        total = 0.0
        for i in range(n * chunk // _CHUNKS, n * (chunk + 1) // _CHUNKS):
            for j in range(k):
                for channel in range(3):
                    conditioned = remainder[i, j, channel] / diagonal[i, j, 0]
                    total += remainder[i, j, channel] * conditioned
                    before = turn * direction[i, j, channel] if turn != 0 else np.float32(0)
                    direction[i, j, channel] = conditioned + before
        sums[chunk] = total
    return sums.sum()


@numba.njit(parallel=True, cache=True)
@no_type_check
def _sloped(remainder, diagonal):
    n, k = remainder.shape[:2]
    sums = np.zeros(_CHUNKS)
    for chunk in numba.prange(_CHUNKS):
        total = 0.0
        for i in range(n * chunk // _CHUNKS, n * (chunk + 1) // _CHUNKS):
            for j in range(k):
                for channel in range(3):
                    total += remainder[i, j, channel] * remainder[i, j, channel] / diagonal[i, j, 0]
        sums[chunk] = total
    return sums.sum()


@numba.njit(parallel=True, cache=True)
@no_type_check
def _pulled(image, direction, pull):
    n, k = image.shape[:2]
    sums = np.zeros(_CHUNKS)
    for chunk in numba.prange(_CHUNKS):
        total = 0.0
        for i in range(n * chunk // _CHUNKS, n * (chunk + 1) // _CHUNKS):
            own = i if len(pull) > 1 else 0
            for j in range(k):
                for channel in range(3):
                    image[i, j, channel] += pull[own, j, 0] * direction[i, j, channel]
                    total += direction[i, j, channel] * image[i, j, channel]
        sums[chunk] = total
    return sums.sum()


@numba.njit(parallel=True, cache=True)
@no_type_check
def _advance(change, remainder, direction, image, step):
    n, k = change.shape[:2]
    for i in numba.prange(n):
        for j in range(k):
            for channel in range(3):
                change[i, j, channel] += step * direction[i, j, channel]
                remainder[i, j, channel] -= step * image[i, j, channel]


# SIMD intrinsics
# Eight weights at a time, for loops that LLVM does not vectorize by itself.

LANES = 8
"""Pixels per piece, in vertical order."""

_FLOATS = ir.VectorType(ir.FloatType(), LANES)
_SHORTS = ir.VectorType(ir.IntType(16), LANES)
_CONTRACT = ("contract",)


@intrinsic
def add_piece(typing: Any, weights: Any, piece: Any, red: Any, green: Any, blue: Any, canvas: Any, place: Any) -> Any:
    """Add weights[piece, :] times (red, green, blue) to canvas[place], whose row has LANES reds, greens and blues."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        weights, piece, red, green, blue, canvas, place = arguments
        weight = _weights(context, builder, signature.args[0], weights, piece)
        line = _data(context, builder, signature.args[5], canvas)
        for channel, color in enumerate((red, green, blue)):
            at = _vector_at(builder, line, place, 3, channel)
            product = builder.fmul(weight, _splat(builder, color), flags=_CONTRACT)
            builder.store(builder.fadd(builder.load(at, align=4), product, flags=_CONTRACT), at, align=4)
        return context.get_dummy_value()

    return types.void(weights, types.intp, *[types.float32] * 3, canvas, types.intp), generate


@intrinsic
def sum_piece(typing: Any, weights: Any, piece: Any, canvas: Any, place: Any, lanes: Any) -> Any:
    """Add weights[piece, :] times canvas[place] to `lanes`, per lane and channel."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        weights, piece, canvas, place, lanes = arguments
        weight = _weights(context, builder, signature.args[0], weights, piece)
        line = _data(context, builder, signature.args[2], canvas)
        sums = _data(context, builder, signature.args[4], lanes)
        zero = ir.Constant(place.type, 0)
        for channel in range(3):
            product = builder.fmul(
                weight, builder.load(_vector_at(builder, line, place, 3, channel), align=4), flags=_CONTRACT
            )
            at = _vector_at(builder, sums, zero, 3, channel)
            builder.store(builder.fadd(builder.load(at, align=4), product, flags=_CONTRACT), at, align=4)
        return context.get_dummy_value()

    return types.void(weights, types.intp, canvas, types.intp, lanes), generate


def _data(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    return context.make_array(kind)(context, builder, array).data


def _weights(context: Any, builder: Any, kind: Any, weights: Any, piece: Any) -> Any:
    """Load a row of uint16 as float32."""
    first = builder.gep(_data(context, builder, kind, weights), [builder.mul(piece, ir.Constant(piece.type, LANES))])
    return builder.uitofp(builder.load(builder.bitcast(first, _SHORTS.as_pointer()), align=2), _FLOATS)


def _vector_at(builder: Any, data: Any, row: Any, vectors: int, vector: int) -> Any:
    offset = builder.add(
        builder.mul(row, ir.Constant(row.type, vectors * LANES)), ir.Constant(row.type, vector * LANES)
    )
    return builder.bitcast(builder.gep(data, [offset]), _FLOATS.as_pointer())


def _splat(builder: Any, value: Any) -> Any:
    one = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(_FLOATS, ir.Undefined), zeros)
