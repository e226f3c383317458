"""Adds the rain's light to the scene's in linear space (docs/physics.md, section 6); `rain_resolve.frag`'s twin."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32

from .compositing import FAST, SceneInRain

_ROOT_HALF = 0x3F3504F3  # the bits of sqrt(1/2) as float32


def add_rain_light(scene: SceneInRain, light_linear: Float32[np.ndarray, "3"]) -> Float32[np.ndarray, "h w 4"]:
    """Put a scene and the drops before and in it together: premultiplied display colour and alpha.

    With the scene's premultiplied colour B and alpha A, its share W_s, the rain's share W_r and a drop's colour S in
    linear light: enc(min(W_s / A, 1) dec(B) + W_r S), alpha W_r + W_s. Where there is no rain, B and A bit for bit.
    """
    rgba = np.empty_like(scene.rgba)
    _add(scene.rgba, scene.shares, light_linear, rgba)
    return rgba


@numba.njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _add(clear, shares, light, rgba):
    height, width = clear.shape[0], clear.shape[1]
    for v in numba.prange(height):
        # A row at a time, one channel after the other: only numbers that lie side by side become SIMD.
        values = np.empty(width, np.float32)
        transmittance, rain = np.empty(width, np.float32), np.empty(width, np.float32)
        for u in range(width):
            alpha = clear[v, u, 3]
            rain[u] = shares[v, u, 0]
            transmittance[u] = min(shares[v, u, 1] / alpha, np.float32(1)) if alpha > 0 else np.float32(1)
            rgba[v, u, 3] = shares[v, u, 0] + shares[v, u, 1] if shares[v, u, 0] > 0 else alpha
        for channel in range(3):
            for u in range(width):
                values[u] = clear[v, u, channel]
            _mix(values, transmittance, rain, light[channel])
            for u in range(width):
                rgba[v, u, channel] = values[u]


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _mix(values, transmittance, rain, light):
    for u in range(len(values)):
        before = values[u]
        mixed = _to_display(transmittance[u] * _to_linear(before) + rain[u] * light)
        values[u] = mixed if rain[u] > 0 else before


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _to_linear(display):
    """The sRGB transfer function (IEC 61966-2-1) without a branch. Colours of Gaussians are never negative."""
    least, most = np.float32(0.04045), np.float32(1e9)
    bounded = min(max(display, least), most)
    curve = _power((bounded + np.float32(0.055)) * np.float32(1 / 1.055), np.float32(2.4))
    return curve if display > least else display * np.float32(1 / 12.92)


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _to_display(linear):
    least = np.float32(0.0031308)
    curve = np.float32(1.055) * _power(max(linear, least), np.float32(1 / 2.4)) - np.float32(0.055)
    return curve if linear > least else np.float32(12.92) * linear


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _power(x, exponent):
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
