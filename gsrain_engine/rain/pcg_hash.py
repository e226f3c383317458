"""Stateless random numbers by the hash pcg4d (Jarzynski and Olano 2020, "Hash Functions for GPU Rendering").

A number is a pure function of its inputs, so any drop at any time can be computed independently, with identical bits in
NumPy, Numba and GLSL.
"""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import UInt32

_MULTIPLIER, _INCREMENT, _SHIFT = np.uint32(1664525), np.uint32(1013904223), np.uint32(16)
_Bits = UInt32[np.ndarray, "*n"]


def pcg4d(x: _Bits, y: _Bits, z: _Bits, w: _Bits) -> tuple[_Bits, _Bits, _Bits, _Bits]:
    """Hash four 32-bit numbers to four: readable reference of `pcg4d_scalar`."""
    with np.errstate(over="ignore"):
        x, y, z, w = _mix(*(v * _MULTIPLIER + _INCREMENT for v in (x, y, z, w)))
        return _mix(*(v ^ (v >> _SHIFT) for v in (x, y, z, w)))


def _mix(x: _Bits, y: _Bits, z: _Bits, w: _Bits) -> tuple[_Bits, _Bits, _Bits, _Bits]:
    x = x + y * w
    y = y + z * x
    z = z + x * y
    w = w + y * z
    return x, y, z, w


@numba.njit(inline="always")
@no_type_check
def pcg4d_scalar(x, y, z, w):
    """Hash four 32-bit numbers to four, inside compiled code."""
    m, c, s = _MULTIPLIER, _INCREMENT, _SHIFT
    x, y, z, w = np.uint32(x * m + c), np.uint32(y * m + c), np.uint32(z * m + c), np.uint32(w * m + c)
    x = np.uint32(x + y * w)
    y = np.uint32(y + z * x)
    z = np.uint32(z + x * y)
    w = np.uint32(w + y * z)
    x, y, z, w = np.uint32(x ^ (x >> s)), np.uint32(y ^ (y >> s)), np.uint32(z ^ (z >> s)), np.uint32(w ^ (w >> s))
    x = np.uint32(x + y * w)
    y = np.uint32(y + z * x)
    z = np.uint32(z + x * y)
    return x, y, z, np.uint32(w + y * z)
