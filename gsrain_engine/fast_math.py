"""Vectorizable exponential, power and spherical harmonics for compiled kernels, and numbers held in registers."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32
from llvmlite import ir
from numba import extending, types
from numba.core import cgutils

from .kernels import kernel, range_of

FAST = {"contract", "nsz", "arcp"}
"""Rounding freedom of the kernels: fused multiply-add and reciprocals, but no change of infinities or order."""

ROOT = 16
"""A polynomial approximates the root of this degree of an exponential."""

_ROOT_HALF = 0x3F3504F3  # the bits of sqrt(1/2) as float32


@no_type_check
def exponential(x):
    """exp(x) for x <= 0 inside compiled code, in the precision of x: `_fast_exponential` for float32."""
    return np.exp(x)


@extending.overload(exponential, inline="always")
@no_type_check
def _exponential(x):
    if x == types.float32:
        return lambda x: _fast_exponential(x)  # noqa: PLW0108 - numba wants a function with this one's arguments
    return lambda x: np.exp(x)  # noqa: PLW0108


@numba.njit(inline="always")
@no_type_check
def _fast_exponential(x):
    """exp(x) for x in [-11.1, 0] to 5e-6 relative, exactly 1 at 0; smaller x count as -11.1, below every cut."""
    x = x if x > np.float32(-11.1) else np.float32(-11.1)
    return _sixteenth_power(x * np.float32(1 / ROOT))


@no_type_check
def exponential_of_root(x):
    """exp(ROOT x) inside compiled code, in the precision of x; in float32 any number where ROOT x is not in [-11.1, 0].

    Two instructions fewer than `exponential`, for loops over pixels whose callers scale x beforehand and drop the rest.
    """
    return np.exp(x * ROOT)


@extending.overload(exponential_of_root, inline="always")
@no_type_check
def _exponential_of_root(x):
    if x == types.float32:
        return lambda x: _sixteenth_power(x)  # noqa: PLW0108 - numba wants a function with this one's arguments
    return lambda x: np.exp(x * ROOT)


@numba.njit(inline="always")
@no_type_check
def _sixteenth_power(x):
    """exp(16 x), from a polynomial of degree 5 for exp(x) on [-0.694, 0] (least squares at Chebyshev nodes).

    Squared four times, which LLVM vectorizes.
    """
    p = np.float32(0.0058943)
    p = p * x + np.float32(0.0398607)
    p = p * x + np.float32(0.16603369)
    p = p * x + np.float32(0.49990045)
    p = p * x + np.float32(0.99999476)
    p = p * x + np.float32(1)
    p = p * p
    p = p * p
    p = p * p
    return p * p


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def power(x, exponent):
    """Raise a positive x to an exponent, to 1e-6 relative, in steps that LLVM vectorizes, unlike powf.

    2^(exponent log2 x). Of x = m 2^e with m in [sqrt(1/2), sqrt(2)) the bits give e; log2 m is a polynomial of degree 9
    and 2^f on [-1/2, 1/2] one of degree 6 (least squares at Chebyshev nodes).
    """
    bits = np.int32(np.float32(x).view(np.int32) - _ROOT_HALF)
    e = np.int32(bits >> 23)
    t = np.int32((bits & 0x7FFFFF) + _ROOT_HALF).view(np.float32) - np.float32(1)
    p = np.float32(0.12614846)
    p = p * t + np.float32(-0.20742103)
    p = p * t + np.float32(0.21566986)
    p = p * t + np.float32(-0.23892035)
    p = p * t + np.float32(0.28791833)
    p = p * t + np.float32(-0.36070484)
    p = p * t + np.float32(0.4809106)
    p = p * t + np.float32(-0.72134733)
    p = p * t + np.float32(1.442695)
    y = exponent * (p * t + np.float32(e))
    whole = np.floor(y + np.float32(0.5))
    f = y - whole
    q = np.float32(1.5469732e-4)
    q = q * f + np.float32(1.3400433e-3)
    q = q * f + np.float32(9.6180253e-3)
    q = q * f + np.float32(5.5503272e-2)
    q = q * f + np.float32(0.24022651)
    q = q * f + np.float32(0.69314718)
    q = q * f + np.float32(1)
    return q * np.int32((np.int32(whole) + 127) << 23).view(np.float32)


# Registers


@extending.intrinsic(prefer_literal=True)
@no_type_check
def _stack_numbers(context, lines, length, dtype):
    """Pointer to lines of numbers on the stack; `lines` and `length` are constant."""
    number, count = dtype.dtype, lines.literal_value * length.literal_value

    @no_type_check
    def generate(context, builder, signature, arguments):
        numbers = cgutils.alloca_once(builder, ir.ArrayType(context.get_value_type(number), count))
        numbers.align = 64
        return builder.bitcast(numbers, context.get_value_type(number).as_pointer())

    return types.CPointer(number)(lines, length, dtype), generate


@numba.njit(inline="always")
@no_type_check
def stack_lines(lines, length, dtype):
    """Array of lines of numbers one after the other, not initialized, on the stack; both counts are constant.

    Nothing else can be at its address, so that LLVM holds it in registers during loops that use it by constant places.
    """
    return numba.carray(_stack_numbers(lines, length, dtype), lines * length)


# Spherical harmonics


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def sh_basis(x: np.float32, y: np.float32, z: np.float32, coefficients: int, basis: Float32[np.ndarray, "16"]) -> None:
    """Write the harmonics of the unit direction (x, y, z), eye to Gaussian, to the start of `basis`.

    `coefficients` is 1, 4, 9 or 16. Constants, order and sign as in 3DGS (Kerbl et al. 2023).
    """
    basis[0] = np.float32(0.28209479177387814)
    if coefficients > 1:
        basis[1] = np.float32(-0.4886025119029199) * y
        basis[2] = np.float32(0.4886025119029199) * z
        basis[3] = np.float32(-0.4886025119029199) * x
    if coefficients > 4:
        basis[4] = np.float32(1.0925484305920792) * x * y
        basis[5] = np.float32(-1.0925484305920792) * y * z
        basis[6] = np.float32(0.31539156525252005) * (np.float32(2) * z * z - x * x - y * y)
        basis[7] = np.float32(-1.0925484305920792) * x * z
        basis[8] = np.float32(0.5462742152960396) * (x * x - y * y)
    if coefficients > 9:
        basis[9] = np.float32(-0.5900435899266435) * y * (np.float32(3) * x * x - y * y)
        basis[10] = np.float32(2.890611442640554) * x * y * z
        basis[11] = np.float32(-0.4570457994644658) * y * (np.float32(4) * z * z - x * x - y * y)
        three = np.float32(3)
        basis[12] = np.float32(0.3731763325901154) * z * (np.float32(2) * z * z - three * x * x - three * y * y)
        basis[13] = np.float32(-0.4570457994644658) * x * (np.float32(4) * z * z - x * x - y * y)
        basis[14] = np.float32(1.445305721320277) * z * (x * x - y * y)
        basis[15] = np.float32(-0.5900435899266435) * x * (x * x - np.float32(3) * y * y)


def harmonics(directions: Float32[np.ndarray, "m 3"], coefficients: int) -> Float32[np.ndarray, "m k"]:
    """Evaluate the first 1, 4, 9 or 16 harmonics in unit directions, eye to Gaussian, in the object's own frame."""
    values = np.empty((len(directions), coefficients), np.float32)
    _fill_harmonics(directions, values)
    return values


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _fill_harmonics(portion, directions, values):
    coefficients = values.shape[1]
    for chunk in range_of(portion, (len(directions) + 1023) // 1024):
        basis = np.empty(16, np.float32)
        for n in range(chunk * 1024, min(len(directions), (chunk + 1) * 1024)):
            sh_basis(directions[n, 0], directions[n, 1], directions[n, 2], coefficients, basis)
            values[n] = basis[:coefficients]
