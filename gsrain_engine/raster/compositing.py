"""Sorted splats in tiles -> an image, front to back: alpha compositing in SIMD with early termination."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float32

from .tiles import TILE, TileLists

MAX_ALPHA = np.float32(0.999)
"""No fragment is opaque, as in the reference rasterizer."""

MIN_TRANSMITTANCE = np.float32(1e-4)
"""A pixel is finished before the splat that would leave less than this (3DGS, Kerbl et al. 2023)."""

CHECK_EVERY = 16
"""Splats between two looks at whether a whole tile is finished."""

FAST = {"contract", "nsz", "arcp"}
"""Rounding freedom of the kernels: fused multiply-add and reciprocals, but infinities and order stay as written."""


def composite(
    shapes: Float32[np.ndarray, "m 8"], channels: Float32[np.ndarray, "m 4"], tiles: TileLists
) -> tuple[Float32[np.ndarray, "h w 4"], Float32[np.ndarray, "h w"]]:
    """Blend four channels a splat over nothing. Returns the first three with alpha, and the fourth.

    Each pixel gets sum_i w_i channel_i with w_i = alpha_i * prod_{j<i} (1 - alpha_j), alpha from `shapes` (see
    `Splats`), at most `MAX_ALPHA`, until transmittance would fall below `MIN_TRANSMITTANCE`. The same bytes at any
    thread count.
    """
    rgba = np.empty((tiles.height, tiles.width, 4), np.float32)
    fourth = np.empty((tiles.height, tiles.width), np.float32)
    _composite(shapes, channels, None, tiles.starts, tiles.members, tiles.columns, rgba, fourth, None)
    return rgba, fourth


class SceneInRain(NamedTuple):
    """A scene as if it were clear, and how much the eye sees of scene and rain through each other."""

    rgba: Float32[np.ndarray, "h w 4"]
    fourth: Float32[np.ndarray, "h w"]
    shares: Float32[np.ndarray, "h w 2"]
    """Of rain, of scene; their sum is what both together cover."""


def composite_in_rain(
    shapes: Float32[np.ndarray, "m 8"], channels: Float32[np.ndarray, "m 4"], is_rain: Bool[np.ndarray, " m"],
    tiles: TileLists,
) -> SceneInRain:  # fmt: skip
    """Blend the scene's splats as `composite` does without the rain's, and gather both shares in the same walk.

    With T_i the product of 1 - alpha_j over all nearer splats, of scene and rain alike, a share is the sum of
    alpha_i T_i over its own splats. Both end with the clear scene: behind what is opaque, no rain is seen either.
    """
    rgba = np.empty((tiles.height, tiles.width, 4), np.float32)
    fourth = np.empty((tiles.height, tiles.width), np.float32)
    shares = np.empty((tiles.height, tiles.width, 2), np.float32)
    _composite(shapes, channels, is_rain, tiles.starts, tiles.members, tiles.columns, rgba, fourth, shares)
    return SceneInRain(rgba, fourth, shares)


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


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def alpha_of(power, log_cut):
    """Alpha of a fragment from its logarithm; 0 below the cut."""
    alpha = exp_of_negative(power)
    alpha = alpha if alpha < MAX_ALPHA else MAX_ALPHA
    return alpha if power >= log_cut else np.float32(0)


@numba.njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _composite(shapes, channels, is_rain, starts, members, columns, rgba, fourth, shares):
    """Compiled twice: without rain, where `is_rain` and `shares` are None, and with it."""
    height, width = fourth.shape
    for tile in numba.prange(len(starts) - 1):
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        u0, v0 = np.float32(x0 + 0.5), np.float32(y0 + 0.5)
        # One line a row: transmittance (0 once finished), four channels, alpha; in rain also the transmittance of
        # scene and rain together, the rain's share, the scene's share. TILE numbers each.
        if is_rain is None:
            state = np.zeros((TILE, 6 * TILE), np.float32)
        else:
            state = np.zeros((TILE, 9 * TILE), np.float32)
            state[: height - y0, 6 * TILE : 6 * TILE + min(TILE, width - x0)] = 1
        state[: height - y0, : min(TILE, width - x0)] = 1
        for k in range(starts[tile], starts[tile + 1]):
            if (k - starts[tile]) % CHECK_EVERY == 0 and is_finished(state):
                break
            n = members[k]
            if is_rain is None:
                _blend(shapes[n], channels[n], u0, v0, state)
            elif is_rain[n]:
                _blend_rain(shapes[n], u0, v0, state)
            else:
                _blend_in_rain(shapes[n], channels[n], u0, v0, state)
        for v in range(min(TILE, height - y0)):
            for u in range(min(TILE, width - x0)):
                rgba[y0 + v, x0 + u, 0] = state[v, TILE + u]
                rgba[y0 + v, x0 + u, 1] = state[v, 2 * TILE + u]
                rgba[y0 + v, x0 + u, 2] = state[v, 3 * TILE + u]
                rgba[y0 + v, x0 + u, 3] = state[v, 5 * TILE + u]
                fourth[y0 + v, x0 + u] = state[v, 4 * TILE + u]
                if shares is not None:
                    shares[y0 + v, x0 + u, 0] = state[v, 7 * TILE + u]
                    shares[y0 + v, x0 + u, 1] = state[v, 8 * TILE + u]


@numba.njit(inline="always")
@no_type_check
def is_finished(state):
    """Whether no pixel of a tile takes any more light."""
    for v in range(TILE):
        line = state[v]
        largest = np.float32(0)
        for u in range(TILE):
            largest = max(largest, line[u])
        if largest > 0:
            return False
    return True


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def rows_of(shape, y0):
    """First and past-the-last row of a tile that a splat reaches; y0 is the tile's first pixel centre."""
    low = np.ceil(shape[1] - shape[7] - y0 - np.float32(0.01))
    high = np.floor(shape[1] + shape[7] - y0 + np.float32(0.01))
    return int(max(low, np.float32(0))), int(min(high, np.float32(TILE - 1))) + 1


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _blend(shape, channels, x0, y0, state):
    first, second, third, fourth = channels[0], channels[1], channels[2], channels[3]
    x, shear, sharpness, log_cut = shape[0], shape[2], shape[3], shape[6]
    top, bottom = rows_of(shape, y0)
    for v in range(top, bottom):
        dy = np.float32(v) + (y0 - shape[1])
        peak = shape[5] + shape[4] * dy * dy
        start = x0 - (x + shear * dy)
        line = state[v]
        for u in range(TILE):
            dx = start + np.float32(u)
            alpha = alpha_of(sharpness * dx * dx + peak, log_cut)
            before = line[u]
            weight = before * alpha
            after = before - weight
            is_open = after >= MIN_TRANSMITTANCE
            line[u] = after if is_open else np.float32(0)
            weight = weight if is_open else np.float32(0)
            line[u + TILE] += weight * first
            line[u + 2 * TILE] += weight * second
            line[u + 3 * TILE] += weight * third
            line[u + 4 * TILE] += weight * fourth
            line[u + 5 * TILE] += weight


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _blend_in_rain(shape, channels, x0, y0, state):
    """`_blend` again, with the same bits, and the scene's share under scene and rain together."""
    first, second, third, fourth = channels[0], channels[1], channels[2], channels[3]
    x, shear, sharpness, log_cut = shape[0], shape[2], shape[3], shape[6]
    top, bottom = rows_of(shape, y0)
    for v in range(top, bottom):
        dy = np.float32(v) + (y0 - shape[1])
        peak = shape[5] + shape[4] * dy * dy
        start = x0 - (x + shear * dy)
        line = state[v]
        for u in range(TILE):
            dx = start + np.float32(u)
            alpha = alpha_of(sharpness * dx * dx + peak, log_cut)
            before = line[u]
            weight = before * alpha
            after = before - weight
            is_open = after >= MIN_TRANSMITTANCE
            line[u] = after if is_open else np.float32(0)
            weight = weight if is_open else np.float32(0)
            line[u + TILE] += weight * first
            line[u + 2 * TILE] += weight * second
            line[u + 3 * TILE] += weight * third
            line[u + 4 * TILE] += weight * fourth
            line[u + 5 * TILE] += weight
            together = line[u + 6 * TILE]
            share = together * alpha if is_open else np.float32(0)
            line[u + 6 * TILE] = together - share if is_open else np.float32(0)
            line[u + 8 * TILE] += share


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _blend_rain(shape, x0, y0, state):
    """Let a rain splat take its share; the clear scene does not see it."""
    x, shear, sharpness, log_cut = shape[0], shape[2], shape[3], shape[6]
    top, bottom = rows_of(shape, y0)
    for v in range(top, bottom):
        dy = np.float32(v) + (y0 - shape[1])
        peak = shape[5] + shape[4] * dy * dy
        start = x0 - (x + shear * dy)
        line = state[v]
        for u in range(TILE):
            dx = start + np.float32(u)
            share = line[u + 6 * TILE] * alpha_of(sharpness * dx * dx + peak, log_cut)
            line[u + 6 * TILE] -= share
            line[u + 7 * TILE] += share
