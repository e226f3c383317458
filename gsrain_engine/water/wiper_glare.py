"""Glare of a wiped pane: ridges of the film along the blade's arcs spread light across them, towards and off the pivot.

Lamps so get the long streaks that drivers know from wiped windshields, and the film carries light of the sky down over
what is dark. All directions are those of lines through the wiper's pivot, as the camera sees it.
"""

from functools import cache, lru_cache
from typing import no_type_check

import numpy as np
from jaxtyping import Float32, Int32, UInt8

from ..kernels import kernel, range_of
from ..scene.camera import Camera
from ..scene.geometry import srgb_to_linear
from .pane import Pane
from .wiper import INNER_M, OUTER_M, PIVOT_M

SPREAD_RAD = 0.07
"""Angle in which the light that a film spreads falls to 1/e; ours."""
GAIN = 5.0
"""Light of lamps that are brighter than white, in white; ours."""
SHRINK = 4
"""Pixels of the picture along one of the glare."""
_RESIDUE = 0.04  # share of the light that wiped glass spreads when it is dry; ours
_FROM, _FULL = 215, 250  # of a pixel's brightest channel: it counts as a lamp from the first, wholly from the second
_WIDE = 15  # window of the glare's pixels, in which what is white by far and large is no lamp
_LEAST, _OVER = np.float32(0.02), np.float32(3)  # light of the faintest lamp; times the mean around, taken off
_REACH = 3.0  # of a streak, in lengths in which it falls to 1/e
_TAPS = 5
_COVERS = np.float32(2e-4)  # coverage from which what is on the pane is drawn


def pivot_px(pane: Pane, camera: Camera) -> tuple[float, float, float]:
    """Place of the wiper's pivot in the picture, homogeneous: it may lie behind the camera."""
    x, y, z = (pane.origin_m + PIVOT_M[0] * pane.right + PIVOT_M[1] * pane.up).tolist()
    return camera.fx * x + camera.cx * z, camera.fy * y + camera.cy * z, z


def lamp_streaks(
    image: UInt8[np.ndarray, "h w 3"], pivot: tuple[float, float, float], focal_px: float
) -> Float32[np.ndarray, "r c 3"] | None:
    """Linear light of the streaks of a picture's lamps, a pixel for `SHRINK` of them; None without any.

    Lamps are small and as bright as a pixel can be. Their light is in two-sided exponentials along the streak.
    """
    rows, columns = image.shape[0] // SHRINK, image.shape[1] // SHRINK
    if min(rows, columns) < 2:
        return None
    lamps, counts = np.empty((rows, columns, 3), np.float32), np.empty(rows, np.int64)
    _find_lamps(np.ascontiguousarray(image), _light_of_lamps(), lamps, counts)
    lit = np.flatnonzero(counts)
    if not len(lit):
        return None
    made, (x, y, z) = np.zeros_like(lamps), pivot
    _draw_streaks(made, lamps, lit, np.array([x / SHRINK, y / SHRINK, z]), SPREAD_RAD * focal_px / SHRINK)
    return made


def smeared(
    light: Float32[np.ndarray, "r c 3"], pivot: tuple[float, float, float], focal_px: float, shrink: float
) -> Float32[np.ndarray, "r c 3"]:
    """Blur a picture, of a pixel for `shrink` of them, along the lines through the pivot."""
    made = np.empty_like(light)
    _smear(light.reshape(-1, 3), *_taps(light.shape[0], light.shape[1], pivot, focal_px, shrink), made.reshape(-1, 3))
    return made


@lru_cache(maxsize=8)
def _taps(
    rows: int, columns: int, pivot: tuple[float, float, float], focal_px: float, shrink: float
) -> tuple[Int32[np.ndarray, "pixels taps"], Float32[np.ndarray, " taps"]]:
    """Pixels of which the smeared one is the weighted mean, and their weights; the same for all frames of a camera."""
    x, y, z = pivot
    length = SPREAD_RAD * focal_px / shrink
    step = max(_REACH * length / _TAPS, 1e-3)
    weights = np.exp(-np.abs(np.arange(-_TAPS, _TAPS + 1)) * step / length)
    taps = np.empty((rows * columns, len(weights)), np.int32)
    _fill_taps(rows, columns, np.array([x / shrink, y / shrink, z]), step, taps)
    return taps, (weights / weights.sum()).astype(np.float32)


def add_streaks(
    layer: Float32[np.ndarray, "rows columns 4"],
    streaks: Float32[np.ndarray, "r c 3"],
    places: Float32[np.ndarray, "2 rows columns"],
    cell_px: int,
    margin: int,
    low_m: tuple[float, float],
    film_share: Float32[np.ndarray, "n m"],
    film_cell_m: float,
) -> None:
    """Add streaks to the light on a pane, as far as it is wiped, by the share of light that the film spreads.

    `places` are those of the layer's cells in pane coordinates; `margin` cells on each side are outside of the picture.
    """
    _add_streaks(layer, streaks, places, cell_px, margin, np.array(low_m), film_share, film_cell_m)


@cache
def _light_of_lamps() -> Float32[np.ndarray, "256 2"]:
    """Linear light of a level, and the share to which a pixel with this brightest channel is a lamp."""
    levels = np.arange(256)
    share = np.clip((levels - _FROM) / (_FULL - _FROM), 0, 1)
    return np.stack([srgb_to_linear(levels / 255), share], axis=1).astype(np.float32)


# Kernels


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _find_lamps(portion, image, tables, lamps, counts):
    """Write the mean light of lamps of each pixel of the glare, and the number of those with any in each row."""
    side, values = SHRINK, 3 * SHRINK * lamps.shape[1]
    for row in range_of(portion, lamps.shape[0]):
        lamps[row] = 0
        counts[row] = 0
        # Three words for a pixel of the glare, all 0 where no value is above `_FROM`: whole vectors are compared.
        bright, first = np.empty(values, np.uint8), side * row
        one, two = image[first].reshape(-1), image[first + 1].reshape(-1)
        three, four = image[first + 2].reshape(-1), image[first + 3].reshape(-1)
        for i in range(values):
            is_bright = (one[i] > _FROM) | (two[i] > _FROM) | (three[i] > _FROM) | (four[i] > _FROM)
            bright[i] = np.uint8(is_bright)
        words = bright.view(np.uint32)
        for column in range(lamps.shape[1]):
            if (words[3 * column] | words[3 * column + 1] | words[3 * column + 2]) == 0:
                continue
            red = green = blue = np.float32(0)
            for y in range(first, first + side):
                for x in range(side * column, side * column + side):
                    r, g, b = image[y, x, 0], image[y, x, 1], image[y, x, 2]
                    brightest = max(r, g, b)
                    if brightest > _FROM:
                        share = tables[brightest, 1]
                        red += share * tables[r, 0]
                        green += share * tables[g, 0]
                        blue += share * tables[b, 0]
            part = np.float32(1 / (side * side))
            lamps[row, column, 0], lamps[row, column, 1] = part * red, part * green
            lamps[row, column, 2] = part * blue
            counts[row] += np.int64(red + green + blue > 0)


@kernel(error_model="numpy")
@no_type_check
def _direction(x, y, pivot):
    """Unit vector in the picture along the line through the pivot."""
    dx, dy = x * pivot[2] - pivot[0], y * pivot[2] - pivot[1]
    length = max(np.hypot(dx, dy), 1e-9)
    return dx / length, dy / length


@kernel(error_model="numpy")
@no_type_check
def _draw_streaks(made, lamps, lit, pivot, length):
    """Draw the streak of each pixel that is brighter than three times the mean around it, which windows are not.

    Only the rows in `lit` have lamps.
    """
    sums, half = _sums_across(lamps, lit), _WIDE // 2
    start, excess = 0, np.empty(3, np.float32)
    for k in range(len(lit)):
        row = lit[k]
        while lit[start] < row - half:
            start += 1
        tall = min(row + half, lamps.shape[0] - 1) - max(row - half, 0) + 1
        for column in range(lamps.shape[1]):
            if max(lamps[row, column, 0], lamps[row, column, 1], lamps[row, column, 2]) <= _LEAST:
                continue
            wide = min(column + half, lamps.shape[1] - 1) - max(column - half, 0) + 1
            for channel in range(3):
                total, other = 0.0, start
                while other < len(lit) and lit[other] <= row + half:
                    total += sums[other, column, channel]
                    other += 1
                excess[channel] = max(lamps[row, column, channel] - _OVER * total / (tall * wide), 0.0)
            if max(excess[0], excess[1], excess[2]) > _LEAST:
                _draw_streak(made, row, column, excess, pivot, length)


@kernel(error_model="numpy")
@no_type_check
def _sums_across(lamps, rows):
    """Sum of the pixels up to half a window to the left and to the right of each, in some rows."""
    half, last = _WIDE // 2, lamps.shape[1] - 1
    sums = np.empty((len(rows), last + 1, 3))
    for k in range(len(rows)):
        for channel in range(3):
            total = 0.0
            for column in range(-half, last + 1):
                total += lamps[rows[k], column + half, channel] if column + half <= last else 0.0
                total -= lamps[rows[k], column - half - 1, channel] if column > half else 0.0
                if column >= 0:
                    sums[k, column, channel] = total
    return sums


@kernel(error_model="numpy")
@no_type_check
def _draw_streak(made, from_row, from_column, light, pivot, length):
    dx, dy = _direction(from_column + 0.5, from_row + 0.5, pivot)
    is_steep = abs(dy) > abs(dx)
    step = 1.0 / max(abs(dx), abs(dy))  # one row or column
    reach, fall = int(_REACH * length / step), np.exp(-step / length)
    weight = GAIN * step / (2.0 * length) * fall ** (reach + 1)
    for k in range(-reach, reach + 1):
        weight = weight / fall if k <= 0 else weight * fall
        x, y = from_column + k * step * dx, from_row + k * step * dy
        column, row = int(np.floor(x)), int(np.floor(y))
        part = x - column if is_steep else y - row
        for side in range(2):
            i = int(np.floor(y + 0.5)) if is_steep else row + side
            j = column + side if is_steep else int(np.floor(x + 0.5))
            if i < 0 or j < 0 or i >= made.shape[0] or j >= made.shape[1]:
                continue
            share = np.float32(weight * (part if side == 1 else 1.0 - part))
            for channel in range(3):
                made[i, j, channel] += share * light[channel]


@kernel(error_model="numpy")
@no_type_check
def _fill_taps(rows, columns, pivot, step, taps):
    for row in range(rows):
        for column in range(columns):
            dx, dy = _direction(column + 0.5, row + 0.5, pivot)
            for k in range(-_TAPS, _TAPS + 1):
                x = min(max(0.0, column + k * step * dx), columns - 1.0)
                y = min(max(0.0, row + k * step * dy), rows - 1.0)
                taps[row * columns + column, k + _TAPS] = int(y + 0.5) * columns + int(x + 0.5)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _smear(portion, light, taps, weights, made):
    for pixel in range_of(portion, len(taps)):
        red = green = blue = np.float32(0)
        for k in range(2 * _TAPS + 1):
            weight, at = weights[k], np.uint32(taps[pixel, k])
            red += weight * light[at, 0]
            green += weight * light[at, 1]
            blue += weight * light[at, 2]
        made[pixel, 0], made[pixel, 1], made[pixel, 2] = red, green, blue


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _add_streaks(portion, layer, streaks, places, cell, margin, low, film_share, film_cell):
    last_row, last_column = streaks.shape[0] - 1, streaks.shape[1] - 1
    for row in range_of(portion, layer.shape[0]):
        at_y = min(max(0.0, (row + 0.5 - margin) * cell / SHRINK - 0.5), last_row - 1e-3)
        i = int(at_y)
        below = np.float32(at_y - i)
        for column in range(layer.shape[1]):
            at_x = min(max(0.0, (column + 0.5 - margin) * cell / SHRINK - 0.5), last_column - 1e-3)
            j = int(at_x)
            brightest = np.float32(0)
            for channel in range(3):
                for corner in range(4):
                    brightest = max(brightest, streaks[i + corner // 2, j + corner % 2, channel])
            if brightest < 1e-4:
                continue
            u, v = places[0, row, column], places[1, row, column]
            if not INNER_M <= np.hypot(u - PIVOT_M[0], v - PIVOT_M[1]) <= OUTER_M:
                continue
            share, right = np.float32(_RESIDUE), np.float32(at_x - j)
            k, m = int(np.floor((v - low[1]) / film_cell)), int(np.floor((u - low[0]) / film_cell))
            if 0 <= k < film_share.shape[0] and 0 <= m < film_share.shape[1]:
                share += film_share[k, m]
            share *= 1 - layer[row, column, 3]
            for channel in range(3):
                upper = streaks[i, j, channel] + right * (streaks[i, j + 1, channel] - streaks[i, j, channel])
                lower = streaks[i + 1, j, channel] + right * (
                    streaks[i + 1, j + 1, channel] - streaks[i + 1, j, channel]
                )
                layer[row, column, channel] += share * (upper + below * (lower - upper))
            layer[row, column, 3] = max(layer[row, column, 3], _COVERS)
