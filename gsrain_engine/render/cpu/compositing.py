"""Alpha compositing of tiled splats, front to back with early termination, and its transpose."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Float32, Int32

from ...scene.camera import Camera
from ...scene.scene import DrawItem
from .fast_math import FAST, exponential, power
from .projection import MIN_SCENE_CUT, Splats, project
from .tiles import BATCH, TILE, TileLists, bin_into_tiles

MAX_ALPHA = 0.999  # maximum alpha of a fragment, as in the reference rasterizer

MIN_TRANSMITTANCE = 1e-4
"""Transmittance below which a pixel is finished.

3DGS (Kerbl et al. 2023) stops before the splat that falls below it, which loses up to a tenth of a pixel at once: a
drop that hardly dims a pixel could switch such a splat off. Here that splat is blended, so the loss never exceeds this
value.
"""


def composite(
    shapes: Float[np.ndarray, "m 8"],
    channels: Float[np.ndarray, "m 4"],
    tiles: TileLists,
    veil: Float32[np.ndarray, "3"] | None = None,
) -> tuple[Float[np.ndarray, "h w 4"], Float[np.ndarray, "h w"]]:
    """Blend four channels per splat over nothing. Returns the first three with alpha, and the fourth.

    Each pixel gets sum_i w_i channel_i with w_i = alpha_i * prod_{j<i} (1 - alpha_j), alpha from `shapes` (see
    `Splats`), at most `MAX_ALPHA`, until transmittance has fallen below `MIN_TRANSMITTANCE`. With `veil`, rain has that
    color, which is cheaper per drop, and is left out of the fourth channel. The precision is that of `shapes`; the
    output is byte-identical at any thread count.
    """
    rgba = np.empty((tiles.height, tiles.width, 4), shapes.dtype)
    fourth = np.empty((tiles.height, tiles.width), shapes.dtype)
    _composite(shapes, channels, tiles.starts, tiles.members, tiles.columns, rgba, fourth, None, None, veil)
    return rgba, fourth


def composite_in_rain(
    shapes: Float32[np.ndarray, "m 8"],
    channels: Float32[np.ndarray, "m 4"],
    light_linear: Float32[np.ndarray, "3"],
    tiles: TileLists,
) -> tuple[Float32[np.ndarray, "h w 4"], Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Blend the scene's splats as `composite` does, with rain of one color in front of and among them.

    With T_i the product of 1 - alpha_j over all nearer splats, of scene and rain alike, the shares of the scene and of
    the rain are the sums of alpha_i T_i over their own splats. Rain behind opaque surfaces is hidden. `add_rain_light`
    combines the shares into the image. Returns it, and the fourth channel and alpha of the scene alone.
    """
    rgba = np.empty((tiles.height, tiles.width, 4), np.float32)
    fourth, alpha = (np.empty((tiles.height, tiles.width), np.float32) for _ in range(2))
    _composite(shapes, channels, tiles.starts, tiles.members, tiles.columns, rgba, fourth, light_linear, alpha, None)
    return rgba, fourth, alpha


@numba.njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _composite(shapes, channels, starts, members, columns, rgba, fourth, light_linear, clear_alpha, veil):
    """Compiled per precision without rain, where the last three are None, with its light, and with its color."""
    height, width = fourth.shape
    real = shapes.dtype.type
    for place in numba.prange(len(starts) - 1):
        tile, x0, y0 = tile_at(place, starts, columns)
        # A column's lines of TILE numbers: transmittance (0 once finished), four channels, alpha; for rain see
        # add_rain_light.
        lines = RAIN_LINES if light_linear is not None else 6 if veil is None else 7
        state = np.zeros((TILE, lines * TILE), shapes.dtype)
        state[: width - x0, : min(TILE, height - y0)] = 1
        if light_linear is not None:
            state[:, OPEN : OPEN + TILE] = 1
        near_shapes, near_channels = np.empty((BATCH, 8), shapes.dtype), np.empty((BATCH, 4), shapes.dtype)
        for first in range(starts[tile], starts[tile + 1], BATCH):
            if is_finished(state):
                break
            batch = members[first : min(first + BATCH, starts[tile + 1])]
            gather_rows(shapes, batch, 8, near_shapes)
            gather_rows(channels, batch, 4, near_channels)
            for j in range(len(batch)):
                if light_linear is not None and near_shapes[j, 6] < MIN_SCENE_CUT:
                    _blend_rain(near_shapes[j], real(x0 + 0.5), real(y0 + 0.5), state)
                elif veil is not None and near_shapes[j, 6] < MIN_SCENE_CUT:
                    _blend_veil(near_shapes[j], real(x0 + 0.5), real(y0 + 0.5), state)
                else:
                    _blend(near_shapes[j], near_channels[j], real(x0 + 0.5), real(y0 + 0.5), state)
        for u in range(min(TILE, width - x0)):
            line = state[u]
            if light_linear is not None:
                for v in range(min(TILE, height - y0)):
                    clear_alpha[y0 + v, x0 + u] = line[5 * TILE + v]
                add_rain_light(line, light_linear)
            if veil is not None:
                for v in range(TILE):
                    share = line[v + VEIL_SHARE]
                    line[v + TILE] += share * veil[0]
                    line[v + 2 * TILE] += share * veil[1]
                    line[v + 3 * TILE] += share * veil[2]
                    line[v + 5 * TILE] += share
        for v in range(min(TILE, height - y0)):
            for u in range(min(TILE, width - x0)):
                rgba[y0 + v, x0 + u, 0] = state[u, TILE + v]
                rgba[y0 + v, x0 + u, 1] = state[u, 2 * TILE + v]
                rgba[y0 + v, x0 + u, 2] = state[u, 3 * TILE + v]
                rgba[y0 + v, x0 + u, 3] = state[u, 5 * TILE + v]
                fourth[y0 + v, x0 + u] = state[u, 4 * TILE + v]


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _blend(shape, channels, x0, y0, state):
    real = shape.dtype.type
    first, second, third, fourth = channels[0], channels[1], channels[2], channels[3]
    sharpness, log_cut = shape[4], shape[6]
    left, right = columns_of(shape, x0)
    for u in range(left, right):
        _, peak, start = column_of(shape, u, x0, y0)
        line = state[u]
        for v in range(TILE):
            dy = start + real(v)
            weight = absorb(line, v, alpha_of(sharpness * dy * dy + peak, log_cut, real), real)
            line[v + TILE] += weight * first
            line[v + 2 * TILE] += weight * second
            line[v + 3 * TILE] += weight * third
            line[v + 4 * TILE] += weight * fourth
            line[v + 5 * TILE] += weight


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _blend_rain(shape, x0, y0, state):
    """Blend a rain splat and occlude splats behind it; the lines of the clear scene are unchanged.

    Of all light that enters a pixel, `share` meets its first drop here. The scene in front had covered A of that; the
    rest shows the drop.
    """
    sharpness, log_cut = shape[4], shape[6]
    left, right = columns_of(shape, x0)
    for u in range(left, right):
        _, peak, start = column_of(shape, u, x0, y0)
        line = state[u]
        for v in range(TILE):
            dy = start + np.float32(v)
            share = line[v + OPEN] * alpha_of(sharpness * dy * dy + peak, log_cut, np.float32)
            line[v + OPEN] -= share
            line[v + RAIN_SHARE] += share * line[v]
            line[v + SCENE_SHARE] += share * line[v + 5 * TILE]


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _blend_veil(shape, x0, y0, state):
    """Occlude splats behind a rain splat and accumulate its share; the color is added at the end."""
    sharpness, log_cut = shape[4], shape[6]
    left, right = columns_of(shape, x0)
    for u in range(left, right):
        _, peak, start = column_of(shape, u, x0, y0)
        line = state[u]
        for v in range(TILE):
            dy = start + np.float32(v)
            share = line[v] * alpha_of(sharpness * dy * dy + peak, log_cut, np.float32)
            line[v] -= share
            line[v + VEIL_SHARE] += share


# Walk over tiles and the pixels of a splat
# Shared by all kernels; `real` is their precision, x0 and y0 the center of a tile's first pixel.


@numba.njit(inline="always")
@no_type_check
def tile_at(place, starts, columns):
    """Tile at a place of the loop, and its first pixel: column by column, so that each thread has sky and road."""
    rows = (len(starts) - 1) // columns
    tile = place % rows * columns + place // rows
    return tile, (tile % columns) * TILE, (tile // columns) * TILE


@numba.njit(inline="always")
@no_type_check
def gather_rows(rows, members, width, near):
    """Copy scattered rows next to each other before they are processed, so that cache misses overlap."""
    for j in range(len(members)):
        for i in range(width):
            near[j, i] = rows[members[j], i]


@numba.njit(inline="always")
@no_type_check
def is_finished(state):
    """Return whether all pixels of a tile are finished; their transmittance is the first line of each column."""
    for u in range(TILE):
        line = state[u]
        largest = state.dtype.type(0)
        for v in range(TILE):
            largest = max(largest, line[v])
        if largest > 0:
            return False
    return True


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def columns_of(shape, x0):
    """First and past-the-last column of a tile that a splat reaches."""
    low = np.ceil(shape[0] - shape[7] - x0 - np.float32(0.01))
    high = np.floor(shape[0] + shape[7] - x0 + np.float32(0.01))
    return int(max(low, np.float32(0))), int(min(high, np.float32(TILE - 1))) + 1


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def column_of(shape, u, x0, y0):
    """Column u of a tile: dx from the splat's center, the largest ln alpha there, and its first row from that line."""
    dx = shape.dtype.type(u) + (x0 - shape[0])
    return dx, shape[5] + shape[3] * dx * dx, y0 - (shape[1] + shape[2] * dx)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def alpha_of(power, log_cut, real):
    """Alpha of a fragment from its logarithm; 0 below the cut."""
    alpha = exponential(power)
    alpha = alpha if alpha < real(MAX_ALPHA) else real(MAX_ALPHA)
    return alpha if power >= log_cut else real(0)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def absorb(line, v, alpha, real):
    """Take a fragment's light from the transmittance of pixel v of a column; returns it, the blending weight."""
    weight = line[v] * alpha
    after = line[v] - weight
    line[v] = after if after >= real(MIN_TRANSMITTANCE) else real(0)
    return weight


# Rain light
# Adds the rain's light to the scene's in linear space (docs/physics.md, section 6), as in rain_resolve.frag.

OPEN, RAIN_SHARE, SCENE_SHARE = 6 * TILE, 7 * TILE, 8 * TILE
"""Offsets in a tile's column, after the lines of `composite`: the product of 1 - alpha of the rain alone, the rain's
share, and the scene's share before rain; TILE numbers each.
"""

VEIL_SHARE = 6 * TILE  # offset of the rain's share in a column if its color is added at the end
RAIN_LINES = 9  # lines of a column in rain


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def add_rain_light(line: Float32[np.ndarray, " nine_tiles"], light_linear: Float32[np.ndarray, "3"]) -> None:
    """Combine a column's scene and rain, replacing the scene's color and alpha.

    With the scene's premultiplied color B and alpha A, its share W_s, the rain's share W_r and a drop's color S in
    linear light: enc(min(W_s / A, 1) dec(B) + W_r S), alpha W_r + W_s. Without rain, B and A bit for bit.
    """
    wettest = np.float32(0)
    for v in range(TILE):
        wettest = max(wettest, line[v + RAIN_SHARE])
    if wettest == 0:
        return
    # One channel after the other: only contiguous numbers are vectorized.
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
    """Branch-free sRGB transfer function (IEC 61966-2-1). Colors of Gaussians are never negative."""
    knee = np.float32(0.04045)
    bounded = min(max(display, knee), np.float32(1e9))
    curve = power((bounded + np.float32(0.055)) * np.float32(1 / 1.055), np.float32(2.4))
    return curve if display > knee else display * np.float32(1 / 12.92)


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _to_display(linear):
    knee = np.float32(0.0031308)
    curve = np.float32(1.055) * power(max(linear, knee), np.float32(1 / 2.4)) - np.float32(0.055)
    return curve if linear > knee else np.float32(12.92) * linear


# Transpose of compositing


def color_operator_transpose(
    shapes: Float[np.ndarray, "m 8"], image: Float[np.ndarray, "h w 3"], tiles: TileLists, *, with_squares: bool = True
) -> Float[np.ndarray, "m c"]:
    """Sum w(pixel) * image(pixel) over all pixels, per splat; with squares the fourth column is the sum of w^2.

    The weights w are those of `composite`: blending is image = W colors, this is W^T image and the diagonal of W^T W,
    in the precision of `shapes`. A splat's sums are taken per tile, then added in tile order: byte-identical at any
    thread count.
    """
    by_pair = np.zeros((len(tiles.members), 4 if with_squares else 3), shapes.dtype)
    squares = True if with_squares else None
    _accumulate(shapes, tiles.starts, tiles.members, tiles.columns, image, by_pair, squares)
    return add_pairs(tiles.members, by_pair, len(shapes))


@numba.njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _accumulate(shapes, starts, members, columns, image, by_pair, squares):
    """Compiled per precision with the squares of the weights, which are added strictly in order, or None."""
    height, width = image.shape[0], image.shape[1]
    real = shapes.dtype.type
    for place in numba.prange(len(starts) - 1):
        tile, x0, y0 = tile_at(place, starts, columns)
        # A column's lines of TILE numbers: transmittance (0 once finished) and the image's three channels.
        state = np.zeros((TILE, 4 * TILE), shapes.dtype)
        state[: width - x0, : min(TILE, height - y0)] = 1
        for v in range(min(TILE, height - y0)):
            for u in range(min(TILE, width - x0)):
                for channel in range(3):
                    state[u, (channel + 1) * TILE + v] = image[y0 + v, x0 + u, channel]
        lanes, near_shapes = np.empty(4 * TILE, shapes.dtype), np.empty((BATCH, 8), shapes.dtype)
        for first in range(starts[tile], starts[tile + 1], BATCH):
            if is_finished(state):
                break
            batch = members[first : min(first + BATCH, starts[tile + 1])]
            gather_rows(shapes, batch, 8, near_shapes)
            for j in range(len(batch)):
                lanes[:] = 0
                _gather(near_shapes[j], real(x0 + 0.5), real(y0 + 0.5), state, lanes, squares)
                if squares is None:
                    add_lanes(lanes, 3, by_pair[first + j])
                else:
                    for channel in range(4):
                        total = real(0)
                        for v in range(TILE):
                            total += lanes[channel * TILE + v]
                        by_pair[first + j, channel] = total


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _gather(shape, x0, y0, state, lanes, squares):
    """Accumulate over the same pixels with the same weights as compositing; one lane per row of the tile."""
    real = shape.dtype.type
    sharpness, log_cut = shape[4], shape[6]
    left, right = columns_of(shape, x0)
    for u in range(left, right):
        _, peak, start = column_of(shape, u, x0, y0)
        line = state[u]
        for v in range(TILE):
            dy = start + real(v)
            weight = absorb(line, v, alpha_of(sharpness * dy * dy + peak, log_cut, real), real)
            lanes[v] += weight * line[v + TILE]
            lanes[v + TILE] += weight * line[v + 2 * TILE]
            lanes[v + 2 * TILE] += weight * line[v + 3 * TILE]
            if squares is not None:
                lanes[v + 3 * TILE] += weight * weight


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST | {"reassoc"})
@no_type_check
def add_lanes(lanes, count, sums):
    """Add up `count` lines of lanes; a constant count lets LLVM vectorize it, always in the same order."""
    for c in range(count):
        total = lanes[c * TILE]
        for v in range(1, TILE):
            total += lanes[c * TILE + v]
        sums[c] = total


def add_pairs(
    members: Int32[np.ndarray, " pairs"], by_pair: Float[np.ndarray, "pairs c"], count: int
) -> Float[np.ndarray, "{count} c"]:
    """Add the rows of each splat's tiles in the order of the tiles; `members` as in `TileLists`, of `count` splats."""
    sums = np.zeros((count, by_pair.shape[1]), by_pair.dtype)
    _add_pairs(members, by_pair, sums, numba.get_num_threads())
    return sums


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _add_pairs(members, by_pair, sums, shares):
    """Each thread goes through all pairs but owns a range of splats, so that no row is written by two."""
    count = len(sums)
    for share in numba.prange(shares):
        first, last = share * count // shares, (share + 1) * count // shares
        for k in range(len(members)):
            n = members[k]
            if first <= n < last:
                for c in range(by_pair.shape[1]):
                    sums[n, c] += by_pair[k, c]


# Color operator
# One view as a linear operator on the Gaussians' colors: image = W colors, without storing W.

_LEAST_ALPHA = np.float32(1e-3)  # alpha below which a pixel counts as empty


@dataclass(frozen=True, slots=True, eq=False)
class ColorOperator:
    """Splats of one view and their tiles, for blending any colors and for the transpose.

    Colors are linear: a renderer's max(0, .) on a splat's color is not part of W.
    """

    splats: Splats
    tiles: TileLists

    def blend(self, channels: Float32[np.ndarray, "m c"]) -> Float32[np.ndarray, "h w c"]:
        """W times up to four channels of the splats: the premultiplied image."""
        c = channels.shape[1]
        padded = np.zeros((len(channels), 4), np.float32)
        padded[:, :c] = channels
        rgba, fourth = composite(self.splats.shapes, padded, self.tiles)
        return np.ascontiguousarray(rgba[..., :c]) if c < 4 else np.dstack([rgba[..., :3], fourth])

    def accumulate(self, image: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "m 3"]:
        """W transposed times an image."""
        return color_operator_transpose(self.splats.shapes, image, self.tiles)[:, :3]

    def squared_sums(self) -> Float32[np.ndarray, " m"]:
        """Sum of each splat's squared weights: the diagonal of W transposed times W."""
        nothing = np.zeros((self.tiles.height, self.tiles.width, 3), np.float32)
        return color_operator_transpose(self.splats.shapes, nothing, self.tiles)[:, 3]


def color_operator(parts: Sequence[DrawItem], camera: Camera) -> ColorOperator:
    """Project, sort and bin the parts for one camera (in the world, meters)."""
    splats = project(parts, camera)
    return ColorOperator(splats, bin_into_tiles(splats.shapes, splats.nearest_first(), camera.width, camera.height))


def expected(weighted: Float32[np.ndarray, "h w"], weight: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Weighted mean of a blended channel; 0 where empty."""
    return np.where(weight > _LEAST_ALPHA, weighted / np.maximum(weight, _LEAST_ALPHA), np.float32(0))
