"""Alpha compositing of tiled splats, front to back with early termination, and its transpose."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float, Float32, Int32

from ...fast_math import FAST, exponential, power, stack_lines
from ...kernels import kernel, range_of
from ...rain.medium import RainMedium, depth_behind_scene, less_drawn, without_drawn
from ...scene.camera import Camera
from ...scene.geometry import linear_to_srgb
from ...scene.scene import DrawItem
from .projection import project
from .splats import MIN_SCENE_CUT, Splats
from .tiles import (
    TILE,
    TileLists,
    absorb,
    alpha_at,
    bin_into_tiles,
    is_rain,
    nothing,
    walk_columns,
    walk_pixels,
    walk_rows,
    walk_tiles,
)


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
    if veil is None:
        _composite(tiles, shapes, channels, (rgba, fourth))
    else:
        _composite_veil(tiles, shapes, channels, (rgba, fourth, veil))
    return rgba, fourth


class Film(NamedTuple):
    """Water on the ground in a picture: the visible shares of films and of standing water in each pixel."""

    of_splats: Float32[np.ndarray, "m 2"]
    visible: Float32[np.ndarray, "h w 2"]
    """Written by `composite_wet` and `composite_in_rain`."""

    @classmethod
    def on(cls, of_splats: Float32[np.ndarray, "m 2"], tiles: TileLists) -> "Film":
        """Film whose shares are to be written, for a picture with these tiles."""
        return cls(of_splats, np.empty((tiles.height, tiles.width, 2), np.float32))


class SkyLayer(NamedTuple):
    """Layer of one color behind the scene and before the background."""

    shares: Float32[np.ndarray, "r c"]
    """Share of each pixel that it covers; one for all pixels, or none without a layer."""
    color: Float32[np.ndarray, "4"]
    """Display color and alpha of 1."""

    @property
    def rgba(self) -> Float32[np.ndarray, "r c 4"]:
        """Premultiplied display color with alpha."""
        return self.shares[..., None] * self.color


NO_ALPHA = np.empty((0, 0), np.float32)  # in place of an image that nobody asks for
NO_SKY = SkyLayer(np.zeros((0, 0), np.float32), np.zeros(4, np.float32))


def film_of_splats(splats: Splats, parts: Sequence[DrawItem]) -> Float32[np.ndarray, "m 2"]:
    """Shares of films and standing water on each splat; none on rain."""
    film = np.zeros((len(splats), 2), np.float32)
    ends = np.cumsum([0, *(len(part.gaussians) for part in parts)])
    for part, first, last in zip(parts, ends[:-1], ends[1:], strict=True):
        if part.film is not None:
            rows = slice(*np.searchsorted(splats.indices, (first, last)))
            film[rows] = part.film[splats.indices[rows] - first]
    return film


def composite_wet(
    shapes: Float32[np.ndarray, "m 8"], channels: Float32[np.ndarray, "m 4"], tiles: TileLists, film: Film
) -> tuple[Float32[np.ndarray, "h w 4"], Float32[np.ndarray, "h w"]]:
    """Blend as `composite` does, and the film as two more channels. Rain must not be among the splats."""
    rgba = np.empty((tiles.height, tiles.width, 4), np.float32)
    fourth = np.empty((tiles.height, tiles.width), np.float32)
    _composite_wet(tiles, shapes, _with_film(channels, film), (rgba, fourth, film.visible))
    return rgba, fourth


def composite_in_rain(
    shapes: Float32[np.ndarray, "m 8"],
    channels: Float32[np.ndarray, "m 4"],
    light_linear: Float32[np.ndarray, "3"],
    tiles: TileLists,
    sky: SkyLayer = NO_SKY,
    lamp_light: Float32[np.ndarray, "h w 3"] | None = None,
    film: Film | None = None,
) -> tuple[Float32[np.ndarray, "h w 4"], Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Blend the scene's splats as `composite` does, with rain of one color in front of and among them.

    With T_i the product of 1 - alpha_j over all nearer splats, of scene and rain alike, the shares of the scene and of
    the rain are the sums of alpha_i T_i over their own splats. Rain behind opaque surfaces is hidden. `add_rain_light`
    combines the shares into the image. Returns it, and the fourth channel and alpha of the scene alone.
    If `lamp_light` is there, the channels of rain are its light of lamps in linear light, and what is visible of that
    is written there. The `film` is blended without the rain in front of it.
    """
    rgba = np.empty((tiles.height, tiles.width, 4), np.float32)
    fourth = np.empty((tiles.height, tiles.width), np.float32)
    alpha = np.empty_like(fourth)
    visible = np.empty((0, 0, 2), np.float32) if film is None else film.visible
    channels = channels if film is None else _with_film(channels, film)
    if lamp_light is None:
        _composite_rain(tiles, shapes, channels, (rgba, fourth, visible, alpha, light_linear, *sky))
    else:
        _composite_lit_rain(tiles, shapes, channels, (rgba, fourth, visible, alpha, light_linear, *sky, lamp_light))
    return rgba, fourth, alpha


def _with_film(channels: Float32[np.ndarray, "m 4"], film: Film) -> Float32[np.ndarray, "m 6"]:
    """Four channels and two of the film next to each other, for one read of memory a splat."""
    joined = np.empty((len(channels), 6), np.float32)
    _join(channels, film.of_splats, joined)
    return joined


@kernel(parallel=True)
@no_type_check
def _join(portion, channels, film, joined):
    for i in range_of(portion, len(joined)):
        for c in range(4):
            joined[i, c] = channels[i, c]
        joined[i, 4], joined[i, 5] = film[i, 0], film[i, 1]


# Lines of a tile's column, TILE numbers each: transmittance, four channels, alpha; then two of the film; with rain the
# open share, the rain's share and the scene's share before rain; with a veil only the rain's share, and no film.


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _composite(portion, tiles, shapes, channels, images):
    walk_columns(portion, tiles, shapes, channels, 6, nothing, _visit, _store, images)


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _composite_rain(portion, tiles, shapes, channels, images):
    walk_columns(portion, tiles, shapes, channels, RAIN_LINES, open_to_rain, _visit_in_rain, store_rain, images)


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _composite_lit_rain(portion, tiles, shapes, channels, images):
    walk_columns(
        portion, tiles, shapes, channels, _LIT_LINES, open_to_rain, _visit_in_lit_rain, _store_lit_rain, images
    )


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _composite_veil(portion, tiles, shapes, channels, images):
    walk_columns(portion, tiles, shapes, channels, 7, nothing, _visit_behind_veil, _store_veil, images)


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _composite_wet(portion, tiles, shapes, channels, images):
    walk_columns(portion, tiles, shapes, channels, 8, nothing, _visit_wet, _store_wet, images)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _visit(line, falloff, channels, j, images):
    walk_rows(line, falloff, _blend, (channels[j, 0], channels[j, 1], channels[j, 2], channels[j, 3]))


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _visit_wet(line, falloff, channels, j, images):
    if channels.shape[1] > 4 and channels[j, 4] + channels[j, 5] > 0:
        light = channels[j, 0], channels[j, 1], channels[j, 2], channels[j, 3], channels[j, 4], channels[j, 5]
        walk_rows(line, falloff, _blend_film, light)
    else:
        _visit(line, falloff, channels, j, images)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _visit_in_rain(line, falloff, channels, j, images):
    if is_rain(falloff):
        walk_rows(line, falloff, _share_rain, ())
    else:
        _visit_wet(line, falloff, channels, j, images)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _visit_in_lit_rain(line, falloff, channels, j, images):
    if is_rain(falloff):
        walk_rows(line, falloff, _share_lit_rain, (channels[j, 0], channels[j, 1], channels[j, 2]))
    else:
        _visit_wet(line, falloff, channels, j, images)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _visit_behind_veil(line, falloff, channels, j, images):
    if is_rain(falloff):
        walk_rows(line, falloff, _share_veil, ())
    else:
        _visit(line, falloff, channels, j, images)


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _blend(line, v, alpha, channels):
    weight = absorb(line, v, alpha)
    line[v + TILE] += weight * channels[0]
    line[v + 2 * TILE] += weight * channels[1]
    line[v + 3 * TILE] += weight * channels[2]
    line[v + 4 * TILE] += weight * channels[3]
    line[v + 5 * TILE] += weight


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _blend_film(line, v, alpha, channels):
    weight = absorb(line, v, alpha)
    line[v + TILE] += weight * channels[0]
    line[v + 2 * TILE] += weight * channels[1]
    line[v + 3 * TILE] += weight * channels[2]
    line[v + 4 * TILE] += weight * channels[3]
    line[v + 5 * TILE] += weight
    line[v + FILM] += weight * channels[4]
    line[v + FILM + TILE] += weight * channels[5]


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _share_rain(line, v, alpha, nothing):
    """Blend a rain fragment and occlude splats behind it; the lines of the clear scene are unchanged.

    Of all light that enters a pixel, `share` meets its first drop here. The scene in front had covered A of that; the
    rest shows the drop.
    """
    share = line[v + OPEN] * alpha
    line[v + OPEN] -= share
    line[v + RAIN_SHARE] += share * line[v]
    line[v + SCENE_SHARE] += share * line[v + 5 * TILE]


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _share_lit_rain(line, v, alpha, light):
    """Blend a rain fragment as `_share_rain` does, and add up its light of lamps."""
    share = line[v + OPEN] * alpha
    shown = share * line[v]
    line[v + OPEN] -= share
    line[v + RAIN_SHARE] += shown
    line[v + SCENE_SHARE] += share * line[v + 5 * TILE]
    line[v + LAMP_LIGHT] += shown * light[0]
    line[v + LAMP_LIGHT + TILE] += shown * light[1]
    line[v + LAMP_LIGHT + 2 * TILE] += shown * light[2]


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _share_veil(line, v, alpha, nothing):
    """Occlude splats behind a rain fragment and accumulate its share; the color is added at the end."""
    share = line[v] * alpha
    line[v] -= share
    line[v + VEIL_SHARE] += share


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def open_to_rain(state, x0, y0, images):
    state[:, OPEN : OPEN + TILE] = 1


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _store(state, x0, y0, images):
    rgba, fourth = images[0], images[1]
    height, width = fourth.shape
    for v in range(min(TILE, height - y0)):
        for u in range(min(TILE, width - x0)):
            # All loads before all stores, since LLVM can't know that they don't overlap.
            red, green, blue = state[u, TILE + v], state[u, 2 * TILE + v], state[u, 3 * TILE + v]
            weighted, alpha = state[u, 4 * TILE + v], state[u, 5 * TILE + v]
            rgba[y0 + v, x0 + u, 0] = red
            rgba[y0 + v, x0 + u, 1] = green
            rgba[y0 + v, x0 + u, 2] = blue
            rgba[y0 + v, x0 + u, 3] = alpha
            fourth[y0 + v, x0 + u] = weighted


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _store_wet(state, x0, y0, images):
    film = images[2]
    height, width = film.shape[:2]
    for v in range(min(TILE, height - y0)):
        for u in range(min(TILE, width - x0)):
            film[y0 + v, x0 + u, 0] = state[u, FILM + v]
            film[y0 + v, x0 + u, 1] = state[u, FILM + TILE + v]
    _store(state, x0, y0, images)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def store_rain(state, x0, y0, images):
    clear_alpha, light_linear, shares, color = images[3], images[4], images[5], images[6]
    height, width = images[1].shape
    for v in range(min(TILE, height - y0) if len(clear_alpha) > 0 else 0):
        for u in range(min(TILE, width - x0)):
            clear_alpha[y0 + v, x0 + u] = state[u, 5 * TILE + v]
    if len(shares) > 0:
        red, green, blue, alpha = color[0], color[1], color[2], color[3]
        behind = stack_lines(1, TILE, state.dtype)
        for u in range(min(TILE, width - x0)):
            column = min(x0 + u, shares.shape[1] - 1)
            for v in range(TILE):
                behind[v] = shares[min(y0 + v, len(shares) - 1), column]
            for v in range(TILE):
                open_share = np.float32(1) - state[u, 5 * TILE + v]
                state[u, TILE + v] += open_share * (behind[v] * red)
                state[u, 2 * TILE + v] += open_share * (behind[v] * green)
                state[u, 3 * TILE + v] += open_share * (behind[v] * blue)
                state[u, 5 * TILE + v] += open_share * (behind[v] * alpha)
    for u in range(min(TILE, width - x0)):
        add_rain_light(state[u], light_linear)
    _store_wet(state, x0, y0, images)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _store_lit_rain(state, x0, y0, images):
    lamp_light = images[7]
    height, width = lamp_light.shape[:2]
    for u in range(min(TILE, width - x0)):
        for v in range(min(TILE, height - y0)):
            for channel in range(3):
                lamp_light[y0 + v, x0 + u, channel] = state[u, LAMP_LIGHT + channel * TILE + v]
    store_rain(state, x0, y0, images)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _store_veil(state, x0, y0, images):
    veil = images[2]
    for u in range(TILE):
        line = state[u]
        for v in range(TILE):
            share = line[v + VEIL_SHARE]
            line[v + TILE] += share * veil[0]
            line[v + 2 * TILE] += share * veil[1]
            line[v + 3 * TILE] += share * veil[2]
            line[v + 5 * TILE] += share
    _store(state, x0, y0, images)


# Rain light
# Adds the rain's light to the scene's in linear space (docs/physics/streaks.md), as in rain_resolve.frag.

FILM = 6 * TILE
"""Offset in a tile's column, after the lines of `composite`, of the visible shares of films and of standing water."""

OPEN, RAIN_SHARE, SCENE_SHARE = 8 * TILE, 9 * TILE, 10 * TILE
"""Offsets of the product of 1 - alpha of the rain alone, of the rain's share, and of the scene's share before rain."""

VEIL_SHARE = 6 * TILE  # offset of the rain's share in a column if its color is added at the end
RAIN_LINES = 11  # lines of a column in rain
LAMP_LIGHT = RAIN_LINES * TILE  # offset of the three lines of the rain's light of lamps
_LIT_LINES = RAIN_LINES + 3


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def add_rain_light(line: Float32[np.ndarray, " tiles"], light_linear: Float32[np.ndarray, "3"]) -> None:
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


# Medium


def dim_by_medium(splats: Splats, camera: Camera, medium: RainMedium, *, is_linear: bool) -> None:
    """Change the scene's colors in place to those that arrive through a medium, in linear light or in display values.

    A splat keeps its share t of light, and takes in 1 - t of the airlight. Rain keeps its color.
    """
    light = medium.airlight_linear if is_linear else linear_to_srgb(medium.airlight_linear).astype(np.float32)
    if splats.points is not None:
        is_scene = (splats.shapes[:, 6] >= MIN_SCENE_CUT) & (splats.colors[:, 3] > 0)
        shares = np.where(is_scene, medium.transmittance(splats.points), np.float32(1))
        _mix_airlights(splats.colors, shares, light, is_linear)
        return
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    # As a tuple, whose values a loop can't overwrite: LLVM would not vectorize it.
    numbers = tuple(medium.numbers)
    _dim_by_medium(splats.shapes, splats.colors, intrinsics, numbers, medium.drawn, light, is_linear)


_BLOCK = 1024  # splats that are copied to contiguous numbers, which LLVM vectorizes


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _dim_by_medium(portion, shapes, colors, intrinsics, numbers, drawn, light, is_linear):
    for block in range_of(portion, (len(colors) + _BLOCK - 1) // _BLOCK):
        lines = np.empty((6, _BLOCK), np.float32)
        start = block * _BLOCK
        count = min(_BLOCK, len(colors) - start)
        for i in range(count):
            for channel in range(3):
                lines[channel, i] = shapes[start + i, channel]
            lines[2, i] = colors[start + i, 3] if shapes[start + i, 6] >= MIN_SCENE_CUT else np.float32(0)
        _shares(lines, intrinsics, numbers, drawn)
        for channel in range(3):
            for i in range(count):
                lines[0, i] = colors[start + i, channel]
            _mix_airlight(lines[0], lines[3], light[channel], is_linear)
            for i in range(count):
                colors[start + i, channel] = lines[0, i]


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _mix_airlights(portion, colors, shares, light, is_linear):
    """Change colors in place by the share of light that arrives from each, of which there may be any number."""
    for block in range_of(portion, (len(colors) + _BLOCK - 1) // _BLOCK):
        start = block * _BLOCK
        count = min(_BLOCK, len(colors) - start)
        line, there = np.zeros(_BLOCK, np.float32), np.ones(_BLOCK, np.float32)
        there[:count] = shares[start : start + count]
        for channel in range(3):
            line[:count] = colors[start : start + count, channel]
            _mix_airlight(line, there, light[channel], is_linear)
            colors[start : start + count, channel] = line[:count]


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _shares(lines, intrinsics, numbers, drawn):
    """Share of light that arrives from pixels x and y (lines 0 and 1) at the depth z (line 2), to line 3."""
    one = np.float32(1)
    fx, fy, cx, cy = one / intrinsics[0], one / intrinsics[1], intrinsics[2], intrinsics[3]
    for i in range(_BLOCK):
        z = lines[2, i]
        x, y = (lines[0, i] - cx) * fx * z, (lines[1, i] - cy) * fy * z
        lines[3, i], lines[0, i], lines[1, i], lines[4, i] = without_drawn(x, y, z, numbers)
    for i in range(_BLOCK):  # looks up, which is not vectorized
        lines[5, i] = less_drawn(lines[3, i], lines[0, i], lines[1, i], lines[4, i], numbers[1], drawn)
    for i in range(_BLOCK):
        lines[3, i] = exponential(-lines[5, i]) if lines[2, i] > 0 else one


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _mix_airlight(line, shares, light, is_linear):
    one = np.float32(1)
    if is_linear:
        for i in range(_BLOCK):
            mixed = _to_display(shares[i] * _to_linear(line[i]) + (one - shares[i]) * light)
            line[i] = mixed if shares[i] < one else line[i]
    else:
        for i in range(_BLOCK):
            line[i] = shares[i] * line[i] + (one - shares[i]) * light


def add_light(rgba: Float32[np.ndarray, "h w 4"], light: Float32[np.ndarray, "h w 3"]) -> None:
    """Add linear light to a premultiplied display color in place."""
    _add_light(rgba, light)


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _add_light(portion, rgba, light):
    height, width = light.shape[:2]
    for row in range_of(portion, height):
        # Contiguous numbers, which LLVM vectorizes.
        before, added = np.empty(width, np.float32), np.empty(width, np.float32)
        for channel in range(3):
            brightest = np.float32(0)
            for column in range(width):
                before[column], added[column] = rgba[row, column, channel], light[row, column, channel]
                brightest = max(brightest, added[column])
            if brightest <= 0:
                continue
            for column in range(width):
                mixed = _to_display(_to_linear(before[column]) + added[column])
                before[column] = mixed if added[column] > 0 else before[column]
            for column in range(width):
                rgba[row, column, channel] = before[column]


def sky_layer(medium: RainMedium, camera: Camera) -> SkyLayer:
    """Airlight of the medium behind the scene."""
    color = np.append(linear_to_srgb(medium.airlight_linear), 1).astype(np.float32)
    if medium.is_endless:
        return SkyLayer(np.ones((1, 1), np.float32), color)
    if not camera.is_pinhole:
        return SkyLayer(1 - medium.sky_transmittance(camera.rays), color)
    shares = np.empty((camera.height, camera.width), np.float32)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    _write_sky(shares, intrinsics, tuple(medium.floor), tuple(medium.numbers), medium.drawn)  # see `dim_by_medium`
    return SkyLayer(shares, color)


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _write_sky(portion, shares, intrinsics, floor, numbers, drawn):
    height, width = shares.shape
    one, half = np.float32(1), np.float32(0.5)
    fx, fy, cx, cy = one / intrinsics[0], one / intrinsics[1], intrinsics[2], intrinsics[3]
    for row in range_of(portion, height):
        lines = np.empty((5, width), np.float32)
        y = (np.float32(row) + half - cy) * fy
        for column in range(width):
            x = (np.float32(column) + half - cx) * fx
            z = depth_behind_scene(x, y, floor)
            depth, first, last, slope = without_drawn(x * z, y * z, z, numbers)
            lines[0, column], lines[1, column], lines[2, column], lines[3, column] = depth, first, last, slope
        for i in range(width):  # looks up, which is not vectorized
            lines[4, i] = less_drawn(lines[0, i], lines[1, i], lines[2, i], lines[3, i], numbers[1], drawn)
        for column in range(width):
            shares[row, column] = one - exponential(-lines[4, column])


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
    accumulate = _accumulate_with_squares if with_squares else _accumulate
    accumulate(tiles, shapes, (image, by_pair))
    return add_pairs(tiles.members, by_pair, len(shapes))


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _accumulate(portion, tiles, shapes, data):
    walk_tiles(portion, tiles, shapes, shapes[:0, :0], 4, 3, _load, _sum_image, nothing, data)


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _accumulate_with_squares(portion, tiles, shapes, data):
    walk_tiles(portion, tiles, shapes, shapes[:0, :0], 4, 4, _load, _sum_squares, nothing, data)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _load(state, x0, y0, data):
    """Copy the image's three channels to the lines after the transmittance."""
    image, _ = data
    height, width = image.shape[:2]
    for v in range(min(TILE, height - y0)):
        for u in range(min(TILE, width - x0)):
            for channel in range(3):
                state[u, (channel + 1) * TILE + v] = image[y0 + v, x0 + u, channel]


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _sum_image(shapes, channels, j, x, y, state, lanes, k, data):
    _, by_pair = data
    lanes[:] = 0
    walk_pixels(shapes[j], x, y, state, lanes, _weigh, ())
    add_lanes(lanes, 3, by_pair[k])


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _sum_squares(shapes, channels, j, x, y, state, lanes, k, data):
    """Sum the lanes strictly in order."""
    _, by_pair = data
    lanes[:] = 0
    walk_pixels(shapes[j], x, y, state, lanes, _weigh_and_square, ())
    for channel in range(4):
        total = lanes.dtype.type(0)
        for v in range(TILE):
            total += lanes[channel * TILE + v]
        by_pair[k, channel] = total


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _weigh(line, v, dx, dy, falloff, lanes, nothing):
    """Add the weighted image to the lanes, with the weights of compositing; returns the weight."""
    weight = absorb(line, v, alpha_at(line, dx, dy, falloff))
    lanes[v] += weight * line[v + TILE]
    lanes[v + TILE] += weight * line[v + 2 * TILE]
    lanes[v + 2 * TILE] += weight * line[v + 3 * TILE]
    return weight


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _weigh_and_square(line, v, dx, dy, falloff, lanes, nothing):
    weight = _weigh(line, v, dx, dy, falloff, lanes, nothing)
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
    _add_pairs(members, by_pair, sums)
    return sums


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _add_pairs(portion, members, by_pair, sums):
    """Each portion goes through all pairs but owns a range of splats, so that no row is written by two."""
    first, last = range_of(portion, len(sums)).start, range_of(portion, len(sums)).stop
    for k in range(len(members)):
        n = members[k]
        if first <= n < last:
            for c in range(by_pair.shape[1]):
                sums[n, c] += by_pair[k, c]


# Color operator
# One view as a linear operator on the Gaussians' colors: image = W colors, without storing W.

_MIN_ALPHA = np.float32(1e-3)  # alpha below which a pixel counts as empty


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


def expected(
    weighted: Float32[np.ndarray, "h w"], weight: Float32[np.ndarray, "h w"], min_weight: np.float32 = _MIN_ALPHA
) -> Float32[np.ndarray, "h w"]:
    """Weighted mean of a blended channel; 0 where empty, at weights up to `min_weight`."""
    return np.where(weight > min_weight, weighted / np.maximum(weight, min_weight), np.float32(0))
