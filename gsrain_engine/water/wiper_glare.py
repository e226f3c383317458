"""Glare of a wiped pane: ridges of the film along the blade's arcs spread light across them, towards and off the pivot.

Lamps so get the long streaks that drivers know from wiped windshields, and the film carries light of the sky down over
what is dark. All directions are those of lines through the wiper's pivot, as the camera sees it.
"""

from functools import cache
from typing import no_type_check

import cv2
import numba
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from ..kernels import NOGIL
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
    lamps = np.empty((rows, columns, 3), np.float32)
    if not _find_lamps(np.ascontiguousarray(image), _light_of_lamps(), lamps):
        return None
    made, (x, y, z) = np.zeros_like(lamps), pivot
    around = cv2.blur(lamps, (_WIDE, _WIDE))
    _draw_streaks(made, lamps, around, np.array([x / SHRINK, y / SHRINK, z]), SPREAD_RAD * focal_px / SHRINK)
    return made


def smeared(
    light: Float32[np.ndarray, "r c 3"], pivot: tuple[float, float, float], focal_px: float, shrink: float
) -> Float32[np.ndarray, "r c 3"]:
    """Blur a picture, of a pixel for `shrink` of them, along the lines through the pivot."""
    made = np.empty_like(light)
    x, y, z = pivot
    _smear(light, np.array([x / shrink, y / shrink, z]), SPREAD_RAD * focal_px / shrink, made)
    return made


def add_streaks(
    layer: Float32[np.ndarray, "rows columns 4"],
    streaks: Float32[np.ndarray, "r c 3"],
    view: Float64[np.ndarray, "6"],
    axes: Float64[np.ndarray, "4 3"],
    low_m: tuple[float, float],
    film_m: Float32[np.ndarray, "n m"],
    film_cell_m: float,
    share: tuple[float, float],
) -> None:
    """Add streaks to the light on a pane, as far as it is wiped, by the film on it.

    `share` is the greatest share of light that a film spreads, and the depth at which 1 - 1/e of it is reached.
    """
    _add_streaks(layer, streaks, view, axes, np.array(low_m), film_m, film_cell_m, *share)


@cache
def _light_of_lamps() -> Float32[np.ndarray, "256 2"]:
    """Linear light of a level, and the share to which a pixel with this brightest channel is a lamp."""
    levels = np.arange(256)
    share = np.clip((levels - _FROM) / (_FULL - _FROM), 0, 1)
    return np.stack([srgb_to_linear(levels / 255), share], axis=1).astype(np.float32)


# Kernels


@numba.njit(parallel=True, cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _find_lamps(image, tables, lamps):
    """Write the mean light of lamps of each pixel of the glare; returns the number of pixels with any."""
    side, found = SHRINK, 0
    for row in numba.prange(lamps.shape[0]):
        for column in range(lamps.shape[1]):
            red = green = blue = np.float32(0)
            for y in range(side * row, side * row + side):
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
            if red + green + blue > 0:
                found += 1
    return found


@numba.njit(cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _direction(x, y, pivot):
    """Unit vector in the picture along the line through the pivot."""
    dx, dy = x * pivot[2] - pivot[0], y * pivot[2] - pivot[1]
    length = max(np.hypot(dx, dy), 1e-9)
    return dx / length, dy / length


@numba.njit(cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _draw_streaks(made, lamps, around, pivot, length):
    """Draw the streak of each pixel that is brighter than three times the mean around it, which windows are not."""
    for row in range(lamps.shape[0]):
        for column in range(lamps.shape[1]):
            brightest = np.float32(0)
            for channel in range(3):
                brightest = max(brightest, lamps[row, column, channel] - _OVER * around[row, column, channel])
            if brightest > _LEAST:
                _draw_streak(made, row, column, lamps[row, column], around[row, column], pivot, length)


@numba.njit(cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _draw_streak(made, from_row, from_column, lamp, around, pivot, length):
    dx, dy = _direction(from_column + 0.5, from_row + 0.5, pivot)
    is_steep = abs(dy) > abs(dx)
    step = 1.0 / max(abs(dx), abs(dy))  # one row or column
    reach = int(_REACH * length / step)
    for k in range(-reach, reach + 1):
        weight = GAIN * np.exp(-abs(k) * step / length) * step / (2.0 * length)
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
                made[i, j, channel] += share * max(lamp[channel] - _OVER * around[channel], np.float32(0))


@numba.njit(parallel=True, cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _smear(light, pivot, length, made):
    height, width = light.shape[0], light.shape[1]
    step = max(_REACH * length / _TAPS, 1e-3)
    for row in numba.prange(height):
        for column in range(width):
            dx, dy = _direction(column + 0.5, row + 0.5, pivot)
            red = green = blue = total = 0.0
            for k in range(-_TAPS, _TAPS + 1):
                weight = np.exp(-abs(k) * step / length)
                x = min(max(column + k * step * dx, 0.0), width - 1.0)
                y = min(max(row + k * step * dy, 0.0), height - 1.0)
                i, j = int(y + 0.5), int(x + 0.5)
                red += weight * light[i, j, 0]
                green += weight * light[i, j, 1]
                blue += weight * light[i, j, 2]
                total += weight
            made[row, column, 0], made[row, column, 1] = red / total, green / total
            made[row, column, 2] = blue / total


@numba.njit(parallel=True, cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _add_streaks(layer, streaks, view, axes, low, film, film_cell, largest, depth_m):
    fx, fy, cx, cy, cell, margin = view
    last_row, last_column = streaks.shape[0] - 1, streaks.shape[1] - 1
    for row in numba.prange(layer.shape[0]):
        y_px = (row + 0.5 - margin) * cell
        y, at_y = (y_px - cy) / fy, min(max(y_px / SHRINK - 0.5, 0.0), last_row - 1e-3)
        i = int(at_y)
        below = at_y - i
        for column in range(layer.shape[1]):
            x_px = (column + 0.5 - margin) * cell
            at_x = min(max(x_px / SHRINK - 0.5, 0.0), last_column - 1e-3)
            j = int(at_x)
            brightest = np.float32(0)
            for channel in range(3):
                for corner in range(4):
                    brightest = max(brightest, streaks[i + corner // 2, j + corner % 2, channel])
            if brightest < 1e-4:
                continue
            right = at_x - j
            x = (x_px - cx) / fx
            along = x * axes[2, 0] + y * axes[2, 1] + axes[2, 2]
            if along <= 0.01:
                continue
            path = (axes[3, 0] * axes[2, 0] + axes[3, 1] * axes[2, 1] + axes[3, 2] * axes[2, 2]) / along
            px, py, pz = path * x - axes[3, 0], path * y - axes[3, 1], path - axes[3, 2]
            u = px * axes[0, 0] + py * axes[0, 1] + pz * axes[0, 2]
            v = px * axes[1, 0] + py * axes[1, 1] + pz * axes[1, 2]
            from_pivot = np.hypot(u - PIVOT_M[0], v - PIVOT_M[1])
            if not INNER_M <= from_pivot <= OUTER_M:
                continue
            # The lens is open: it averages the film over a few of its cells.
            depth = 0.0
            k, m = int((v - low[1]) / film_cell), int((u - low[0]) / film_cell)
            for other in range(max(k - 1, 0), min(k + 2, film.shape[0])):
                for near in range(max(m - 1, 0), min(m + 2, film.shape[1])):
                    depth += film[other, near] / 9.0
            share = _RESIDUE + largest * (1.0 - np.exp(-depth / depth_m))
            share *= 1.0 - layer[row, column, 3]
            for channel in range(3):
                upper = (1 - right) * streaks[i, j, channel] + right * streaks[i, j + 1, channel]
                lower = (1 - right) * streaks[i + 1, j, channel] + right * streaks[i + 1, j + 1, channel]
                layer[row, column, channel] += np.float32(share * ((1 - below) * upper + below * lower))
            layer[row, column, 3] = max(layer[row, column, 3], _COVERS)
