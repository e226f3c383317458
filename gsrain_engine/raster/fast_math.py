"""Exponentials and powers in steps that LLVM turns into SIMD inside compiled code; those of libm it can't."""

from typing import no_type_check

import numba
import numpy as np

FAST = {"contract", "nsz", "arcp"}
"""Rounding freedom of the kernels: fused multiply-add and reciprocals, but infinities and order stay as written."""

_ROOT_HALF = 0x3F3504F3  # the bits of sqrt(1/2) as float32


@numba.njit(inline="always")
@no_type_check
def exp_of_negative(x):
    """exp(x) for x in [-11.1, 0] to 5e-6 relative, exactly 1 at 0.

    A polynomial of degree 5 for exp(x / 16) on [-0.694, 0] (least squares at Chebyshev nodes), squared four times:
    nothing in it keeps LLVM from turning it into SIMD. Smaller x count as -11.1, whose exp is below every cut.
    """
    x = x if x > np.float32(-11.1) else np.float32(-11.1)
    x = x * np.float32(0.0625)
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
    """Raise a positive x to an exponent, to 1e-6 relative, in steps that LLVM turns into SIMD (powf it can't).

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
