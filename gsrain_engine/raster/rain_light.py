"""Adds the rain's light to the scene's in linear space (docs/physics.md, section 6); `rain_resolve.frag`'s twin."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32

from .fast_math import FAST, power
from .tiles import TILE

OPEN, RAIN_SHARE, SCENE_SHARE = 6 * TILE, 7 * TILE, 8 * TILE
"""Where a tile's column keeps, behind the lines of `composite`: the product of 1 - alpha of the rain alone, the rain's
share, and the scene's share before rain; TILE numbers each."""

VEIL_SHARE = 6 * TILE
"""Where a column keeps the rain's share alone, when its colour comes on at the end."""

RAIN_LINES = 9
"""Lines of a column in rain."""


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def add_rain_light(line: Float32[np.ndarray, " nine_tiles"], light_linear: Float32[np.ndarray, "3"]) -> None:
    """Put a column's scene and the drops before and in it together, in place of the scene's colour and alpha.

    With the scene's premultiplied colour B and alpha A, its share W_s, the rain's share W_r and a drop's colour S in
    linear light: enc(min(W_s / A, 1) dec(B) + W_r S), alpha W_r + W_s. Where there is no rain, B and A bit for bit.
    """
    wettest = np.float32(0)
    for v in range(TILE):
        wettest = max(wettest, line[v + RAIN_SHARE])
    if wettest == 0:
        return
    # One channel after the other: only numbers that lie side by side become SIMD.
    for v in range(TILE):
        alpha = line[v + 5 * TILE]
        scene = line[v + SCENE_SHARE] + line[v + OPEN] * alpha
        line[v + OPEN] = min(scene / alpha, np.float32(1)) if alpha > 0 else np.float32(1)
        line[v + 5 * TILE] = line[v + RAIN_SHARE] + scene if line[v + RAIN_SHARE] > 0 else alpha
    for channel in range(3):
        for v in range(TILE):
            rain, before = line[v + RAIN_SHARE], line[v + (1 + channel) * TILE]
            mixed = _to_display(line[v + OPEN] * _to_linear(before) + rain * light_linear[channel])
            line[v + (1 + channel) * TILE] = mixed if rain > 0 else before


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _to_linear(display):
    """The sRGB transfer function (IEC 61966-2-1) without a branch. Colours of Gaussians are never negative."""
    least, most = np.float32(0.04045), np.float32(1e9)
    bounded = min(max(display, least), most)
    curve = power((bounded + np.float32(0.055)) * np.float32(1 / 1.055), np.float32(2.4))
    return curve if display > least else display * np.float32(1 / 12.92)


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _to_display(linear):
    least = np.float32(0.0031308)
    curve = np.float32(1.055) * power(max(linear, least), np.float32(1 / 2.4)) - np.float32(0.055)
    return curve if linear > least else np.float32(12.92) * linear
