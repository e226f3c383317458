"""Splats of one image: their shape, color and depth, as all projections write them, and their order."""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Float32, Float64, Int32, Int64, UInt32

from ...kernels import NOGIL
from ...scene.camera import Camera
from ...scene.flags import BitMask
from ...scene.scene import DrawItem
from .fast_math import sh_basis

NEAR_M = 0.2  # Gaussians with nearer centers are skipped, as in the reference rasterizer
DILATION_PX2 = 0.3  # added to the 2D covariance: the pixel's own footprint (3DGS, Kerbl et al. 2023)
ANTIALIASED_PX2 = 0.1  # the same for antialiased Gaussians: about the variance of a pixel's area (Yu et al. 2024)


SCENE_ALPHA_CUT = 1 / 255  # alpha below which fragments of the scene are skipped, as in the reference rasterizer

RAIN_ALPHA_CUT = 1 / 65536
"""Alpha below which fragments of rain are skipped: streaks of alpha 0.01 would hardly survive a cut at 1/255."""

LOG_SCENE_CUT, LOG_RAIN_CUT = float(np.log(SCENE_ALPHA_CUT)), float(np.log(RAIN_ALPHA_CUT))
"""Values of log_cut in `Splats.shapes`, by which rain is distinguished from the scene."""

MIN_SCENE_CUT = np.float32(LOG_SCENE_CUT - 1)  # threshold between the logarithms of rain (below) and scene (above)

TINT, TINT_SHARE = (1.0, 0.82, 0.15), 0.5
"""Display color of the selection, a warm yellow that is rare in streets, and its share; as in common_tint.glsl."""

CHUNK = 512  # Gaussians that one thread processes at a time


@dataclass(frozen=True, slots=True, eq=False)
class Splats:
    """Gaussians that may be visible to one camera, in their own order.

    A row of `shapes` holds x, y, shear, sharpness_x, sharpness_y, log_opacity, log_cut, reach_x. With the pixel center
    (u, v) and dx = u - x,
        ln alpha = log_opacity + sharpness_x * dx^2 + sharpness_y * (v - y - shear * dx)^2, cut below log_cut,
    where shear = cov_xy / cov_xx, sharpness_x = -1 / (2 cov_xx), sharpness_y = -cov_xx / (2 det), |dx| <= reach_x: the
    2D Gaussian column by column. Both terms are negative, so that long needles suffer no cancellation. Columns suit
    rain: a falling streak touches few of them.
    """

    shapes: Float32[np.ndarray, "m 8"]
    colors: Float32[np.ndarray, "m 4"]
    """Display color, never negative, and depth along the view axis in meters. All 0 for the few that turn out to be
    invisible; they are not drawn.
    """
    indices: Int64[np.ndarray, " m"]
    """Index of the Gaussian, counted through all parts in order; those beyond a part's limit count too.

    Rising from part to part, and inside a part, unless its `members` are in another order.
    """
    points: Float32[np.ndarray, "m 3"] | None = None
    """Means in the camera's frame at the time of their rows; None for a pinhole, whose pixels and depths tell them."""

    def __len__(self) -> int:
        return len(self.indices)

    def nearest_first(self) -> Int32[np.ndarray, " drawn"]:
        return nearest_first(self.colors[:, 3])


def nearest_first(depths: Float[np.ndarray, " m"]) -> Int32[np.ndarray, " drawn"]:
    """Rows with a depth above 0, sorted by it as float32; equal depths keep their order."""
    return _nearest_first(np.ascontiguousarray(depths, np.float32).view(np.uint32))


_DIGIT_BITS, _DIGITS = 11, 3
_DIGIT = np.uint32((1 << _DIGIT_BITS) - 1)


@numba.njit(cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _nearest_first(words):
    """Sort by radix, from the lowest digit on: the bits of a positive float32 sort like the number itself."""
    counts = np.zeros((_DIGITS, 1 << _DIGIT_BITS), np.int64)
    keys, rows, drawn = np.empty(len(words), np.uint32), np.empty(len(words), np.int32), 0
    for row in range(len(words)):
        word = words[row]
        if word != 0:
            keys[drawn], rows[drawn] = word, row
            drawn += 1
            for digit in range(_DIGITS):
                counts[digit, (word >> np.uint32(digit * _DIGIT_BITS)) & _DIGIT] += 1
    keys, rows = keys[:drawn], rows[:drawn]
    next_keys, next_rows = np.empty(drawn, np.uint32), np.empty(drawn, np.int32)
    for digit in range(_DIGITS):
        places, total = counts[digit], 0
        for value in range(len(places)):
            count = places[value]
            places[value] = total
            total += count
        shift = np.uint32(digit * _DIGIT_BITS)
        for n in range(drawn):
            value = (keys[n] >> shift) & _DIGIT
            next_keys[places[value]], next_rows[places[value]] = keys[n], rows[n]
            places[value] += 1
        keys, next_keys, rows, next_rows = next_keys, keys, next_rows, rows
    return rows


def mask_words(mask: BitMask | None) -> UInt32[np.ndarray, " w"]:
    """Bits of a mask, empty without a mask; writable, since read-only arrays would need separate kernels."""
    return np.zeros(0, np.uint32) if mask is None else np.require(mask.words, np.uint32, ("C", "W"))


def eye_in_object(camera: Camera, part: DrawItem) -> Float64[np.ndarray, "3"]:
    """Center of projection in the part's own frame, in which its spherical harmonics are defined."""
    return np.linalg.solve(part.to_world[:3, :3], camera.position - part.to_world[:3, 3])


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def has_bit(words, i):
    return (words[i >> 5] >> np.uint32(i & 31)) & np.uint32(1) == np.uint32(1)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def rotation_columns(w, x, y, z):
    """Columns of the rotation of a unit quaternion."""
    first = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    second = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)
    third = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    return first, second, third


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def write_shape(u, v, xx, xy, yy, opacity, is_rain, as_point, antialiased, width, height, shape):
    """Write the shape of a splat by its center and covariance in pixels; return whether it is drawn."""
    before = max(xx * yy - xy * xy, 0.0)
    footprint = ANTIALIASED_PX2 if antialiased else DILATION_PX2
    xx += footprint
    yy += footprint
    if as_point:
        xx, xy, yy, opacity = 1.0, 0.0, 1.0, np.float32(1)
    determinant = xx * yy - xy * xy
    if not (0 < determinant < np.inf):
        return False
    alpha = min(np.float64(opacity), 1.0)
    log_cut = LOG_SCENE_CUT
    if is_rain or (antialiased and not as_point):
        alpha *= np.sqrt(before / determinant)
    if is_rain:
        log_cut = LOG_RAIN_CUT
    log_alpha = np.log(alpha)
    if not (log_alpha > log_cut):
        return False
    extent = np.sqrt(2 * (log_alpha - log_cut))  # exact: alpha is the cut at the edge
    reach_x, reach_y = extent * np.sqrt(xx), extent * np.sqrt(yy)
    if not (u + reach_x > 0 and u - reach_x < width and v + reach_y > 0 and v - reach_y < height):
        return False
    by_xx = 1 / xx
    shape[0], shape[1] = u, v
    shape[2] = xy * by_xx
    shape[3] = -0.5 * by_xx
    shape[4] = -0.5 * xx / determinant
    shape[5], shape[6] = log_alpha, log_cut
    shape[7] = reach_x
    return True


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def color_of(mean, sh, wet_sh, i, wetness, eye, change, basis, color):
    """Write the display color, max(0, change of (sum of harmonics + 0.5)); return whether it is finite.

    Harmonics are those of row i. If there are wet ones, they are blended in before the change.
    """
    x, y, z = mean[0] - eye[0], mean[1] - eye[1], mean[2] - eye[2]
    by_length = 1 / np.sqrt(x * x + y * y + z * z)
    coefficients = sh.shape[1]
    sh_basis(np.float32(x * by_length), np.float32(y * by_length), np.float32(z * by_length), coefficients, basis)
    red = green = blue = np.float32(0.5)
    for k in range(coefficients):
        red += basis[k] * sh[i, k, 0]
        green += basis[k] * sh[i, k, 1]
        blue += basis[k] * sh[i, k, 2]
    if len(wet_sh) > 0:
        r = g = b = np.float32(0.5)
        for k in range(coefficients):
            r += basis[k] * wet_sh[i, k, 0]
            g += basis[k] * wet_sh[i, k, 1]
            b += basis[k] * wet_sh[i, k, 2]
        dry = np.float32(1) - wetness
        red, green, blue = dry * red + wetness * r, dry * green + wetness * g, dry * blue + wetness * b
    if len(change) > 0:
        r, g, b = red, green, blue
        red = change[0, 0] * r + change[0, 1] * g + change[0, 2] * b + change[0, 3]
        green = change[1, 0] * r + change[1, 1] * g + change[1, 2] * b + change[1, 3]
        blue = change[2, 0] * r + change[2, 1] * g + change[2, 2] * b + change[2, 3]
    color[0], color[1], color[2] = max(red, np.float32(0)), max(green, np.float32(0)), max(blue, np.float32(0))
    return np.isfinite(red) and np.isfinite(green) and np.isfinite(blue)
