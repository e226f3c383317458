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
_LEAST = 0.02
_REACH = 3.0  # of a streak, in lengths in which it falls to 1/e
_TAPS = 8
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
    size = image.shape[1] // SHRINK, image.shape[0] // SHRINK
    if min(size) < 2:
        return None
    red, green, blue = cv2.split(image)
    brightest = cv2.LUT(cv2.max(cv2.max(red, green), blue), _ramp_bytes())
    mask = cv2.threshold(brightest, 0, 255, cv2.THRESH_BINARY)[1]
    if not mask.any():
        return None
    bright = cv2.LUT(cv2.bitwise_and(image, image, mask=mask), _linear_bytes())
    lamps, weights, shares = (
        cv2.resize(each, size, interpolation=cv2.INTER_AREA).astype(np.float32) / np.float32(255)
        for each in (bright, brightest, mask)
    )
    lamps *= (weights / np.maximum(shares, np.float32(1e-3)))[..., None]
    lamps -= np.float32(3) * cv2.blur(lamps, (_WIDE, _WIDE))
    rows, columns = np.nonzero(lamps.max(axis=2) > _LEAST)
    if not len(rows):
        return None
    light = np.maximum(lamps[rows, columns], 0) * np.float32(GAIN)
    made = np.zeros_like(lamps)
    x, y, z = pivot
    _draw_streaks(made, rows, columns, light, np.array([x / SHRINK, y / SHRINK, z]), SPREAD_RAD * focal_px / SHRINK)
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
def _ramp_bytes() -> UInt8[np.ndarray, "256"]:
    return np.rint(255 * np.clip((np.arange(256.0) - _FROM) / (_FULL - _FROM), 0, 1)).astype(np.uint8)


@cache
def _linear_bytes() -> UInt8[np.ndarray, "256"]:
    return np.rint(255 * srgb_to_linear(np.arange(256) / 255)).astype(np.uint8)


# Kernels


@numba.njit(cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _direction(x, y, pivot):
    """Unit vector in the picture along the line through the pivot."""
    dx, dy = x * pivot[2] - pivot[0], y * pivot[2] - pivot[1]
    length = max(np.hypot(dx, dy), 1e-9)
    return dx / length, dy / length


@numba.njit(cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _draw_streaks(made, rows, columns, light, pivot, length):
    height, width = made.shape[0], made.shape[1]
    for n in range(len(rows)):
        dx, dy = _direction(columns[n] + 0.5, rows[n] + 0.5, pivot)
        is_steep = abs(dy) > abs(dx)
        step = 1.0 / max(abs(dx), abs(dy))  # one row or column
        reach = int(_REACH * length / step)
        for k in range(-reach, reach + 1):
            weight = np.exp(-abs(k) * step / length) * step / (2.0 * length)
            x, y = columns[n] + k * step * dx, rows[n] + k * step * dy
            column, row = int(np.floor(x)), int(np.floor(y))
            part = y - row if not is_steep else x - column
            for side in range(2):
                i = row + side if not is_steep else int(np.floor(y + 0.5))
                j = column + side if is_steep else int(np.floor(x + 0.5))
                if i < 0 or j < 0 or i >= height or j >= width:
                    continue
                share = np.float32(weight * (part if side == 1 else 1.0 - part))
                for channel in range(3):
                    made[i, j, channel] += share * light[n, channel]


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
