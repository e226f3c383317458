"""Splats of one image: their shape, color and depth, as all projections write them, and their order."""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Float32, Float64, Int32, Int64, UInt32

from ...fast_math import sh_basis, stack_lines
from ...kernels import kernel, range_of
from ...scene.camera import Camera
from ...scene.flags import BitMask
from ...scene.scene import DrawItem

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

FEW = 8192  # number of Gaussians below which a single thread is faster than starting others
CHUNK = 512  # Gaussians that one thread processes at a time


def nearest_m(camera: Camera) -> float:
    """Depth from which on Gaussians are drawn; an orthographic camera draws none before its plane."""
    return max(NEAR_M, camera.plane_m)


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
    """Rows with a depth above 0, sorted by it as float32; equal depths keep their index.

    The bits of a positive float32 sort like the number itself. Sorting on one thread took longer than all of binning.
    """
    bits = np.ascontiguousarray(depths, np.float32).view(np.uint32)
    if len(bits) < FEW:
        rows = np.flatnonzero(bits)
        return rows[np.argsort(bits[rows], kind="stable")].astype(np.int32)
    return _radix_sort(bits)


_DIGITS, _PARTS = 3, 16  # passes of the sort; parts of the rows, which are processed in parallel


def _radix_sort(bits: UInt32[np.ndarray, " n"]) -> Int32[np.ndarray, " m"]:
    """Rows with bits other than 0, sorted by them: a stable radix sort from the lowest digit on.

    Parts of the rows are counted and moved in parallel; the result does not depend on their number. Digits share the
    bits in which depths differ: 9 bits each for depths from 0.5 to 50 m, whose 512 places stay in the nearest cache.
    """
    limits = np.empty((_PARTS, 3), np.uint32)
    _find_limits(bits, limits)
    lowest, highest, zeros = int(limits[:, 0].min()), int(limits[:, 1].max()), int(limits[:, 2].sum())
    if highest == 0:
        return np.empty(0, np.int32)
    width = max(1, -(-(highest - lowest).bit_length() // _DIGITS))
    # A number for each row: its depth above its index. Rows without depth come first.
    numbers, moved = np.empty(len(bits), np.uint64), np.empty(len(bits), np.uint64)
    _number(bits, np.uint32(lowest), numbers)
    places = np.empty((_PARTS, 1 << width), np.int64)
    for digit in range(_DIGITS):
        shift, mask = np.uint64(32 + digit * width), np.uint64((1 << width) - 1)
        _count_values(numbers, shift, mask, places)
        _to_places(places)
        _move(numbers, shift, mask, places, moved)
        numbers, moved = moved, numbers
    return numbers[zeros:].astype(np.uint32).view(np.int32)


@numba.njit(inline="always")
@no_type_check
def _part_of(count, part):
    size = (count + _PARTS - 1) // _PARTS
    return range(part * size, min(count, (part + 1) * size))


@kernel(parallel=True)
@no_type_check
def _find_limits(portion, bits, limits):
    """Write the lowest bits but 0, less 1, the highest, and the number of zeros of each part."""
    for part in range_of(portion, _PARTS):
        low, high, zeros = np.uint32(0xFFFFFFFF), np.uint32(0), np.uint32(0)
        for i in _part_of(len(bits), part):
            zeros += np.uint32(bits[i] == 0)
            low, high = min(low, bits[i] - np.uint32(1)), max(high, bits[i])  # 0 becomes the largest number
        limits[part, 0], limits[part, 1], limits[part, 2] = low, high, zeros


@kernel(parallel=True)
@no_type_check
def _number(portion, bits, lowest, numbers):
    for i in range_of(portion, len(bits)):
        depth = np.uint64(bits[i] - lowest) if bits[i] > 0 else np.uint64(0)
        numbers[i] = depth << np.uint64(32) | np.uint64(i)


@kernel(parallel=True)
@no_type_check
def _count_values(portion, numbers, shift, mask, places):
    for part in range_of(portion, _PARTS):
        place = places[part]
        place[:] = 0
        for i in _part_of(len(numbers), part):
            place[np.int64(numbers[i] >> shift & mask)] += 1


@kernel()
@no_type_check
def _to_places(places):
    """Change counts to places: all of a value after those of smaller ones, part by part."""
    first = 0
    for value in range(places.shape[1]):
        for part in range(_PARTS):
            here = places[part, value]
            places[part, value] = first
            first += here


@kernel(parallel=True)
@no_type_check
def _move(portion, numbers, shift, mask, places, moved):
    for part in range_of(portion, _PARTS):
        place = places[part]
        for i in _part_of(len(numbers), part):
            value = np.int64(numbers[i] >> shift & mask)
            moved[place[value]] = numbers[i]
            place[value] += 1


def mask_words(mask: BitMask | None) -> UInt32[np.ndarray, " w"]:
    """Bits of a mask, empty without a mask; writable, since read-only arrays would need separate kernels."""
    return np.zeros(0, np.uint32) if mask is None else np.require(mask.words, np.uint32, ("C", "W"))


def eye_in_object(camera: Camera, part: DrawItem) -> Float64[np.ndarray, "3"]:
    """Center of projection in the part's own frame, in which its spherical harmonics are defined."""
    turn = part.to_world[:3, :3]  # and scale
    return (camera.position - part.to_world[:3, 3]) @ turn / (turn[:, 0] @ turn[:, 0])


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
    xx, xy, yy, determinant, alpha = with_footprint(xx, xy, yy, opacity, is_rain, as_point, antialiased)
    is_drawn, numbers = shape_of(u, v, xx, xy, yy, determinant, np.log(alpha), is_rain, width, height)
    if is_drawn:
        for k in range(8):
            shape[k] = numbers[k]
    return is_drawn


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def with_footprint(xx, xy, yy, opacity, is_rain, as_point, antialiased):
    """Covariance of a splat with the pixel's own, its determinant, and alpha in the center.

    Without branches, as `shape_of`: LLVM vectorizes loops over both, which the logarithm between them would prevent.
    """
    before = max(xx * yy - xy * xy, 0.0)
    footprint = ANTIALIASED_PX2 if antialiased else DILATION_PX2
    xx, xy, yy = (1.0, 0.0, 1.0) if as_point else (xx + footprint, xy, yy + footprint)
    determinant = xx * yy - xy * xy
    alpha = min(np.float64(np.float32(1) if as_point else opacity), 1.0)
    loses = is_rain | (antialiased & (not as_point))
    return xx, xy, yy, determinant, alpha * (np.sqrt(before / determinant) if loses else 1.0)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def shape_of(u, v, xx, xy, yy, determinant, log_alpha, is_rain, width, height):
    """Return whether a splat is drawn, and its shape, from what `with_footprint` returns."""
    log_cut = LOG_RAIN_CUT if is_rain else LOG_SCENE_CUT
    extent = np.sqrt(2 * (log_alpha - log_cut))  # exact: alpha is the cut at the edge
    reach_x, reach_y = extent * np.sqrt(xx), extent * np.sqrt(yy)
    is_near_x = (u + reach_x > 0) & (u - reach_x < width)
    is_near_y = (v + reach_y > 0) & (v - reach_y < height)
    is_drawn = (determinant > 0) & (determinant < np.inf) & (log_alpha > log_cut) & is_near_x & is_near_y
    by_xx = 1 / xx
    return is_drawn, (u, v, xy * by_xx, -0.5 * by_xx, -0.5 * xx / determinant, log_alpha, log_cut, reach_x)


@numba.njit(error_model="numpy")
@no_type_check
def write_colors(first, last, members, directions, sh, wet_sh, wetness, change, selected, shapes, colors):
    """Write the display colors, max(0, change of (sum of harmonics + 0.5)), of splats with a depth.

    Splats whose color is not finite are removed. `directions` has those from the eye to the splats from `first` on. If
    there are wet harmonics, they are blended in before the change. A loop of its own: to pass these arrays for each
    splat, whose references are counted, would cost as much as to project it.
    """
    basis = stack_lines(1, 16, shapes.dtype)
    coefficients = sh.shape[1]
    for n in range(first, last):
        if not colors[n, 3] > 0:
            continue
        i, j = members[n], n - first
        sh_basis(directions[j, 0], directions[j, 1], directions[j, 2], coefficients, basis)
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
        if not (np.isfinite(red) and np.isfinite(green) and np.isfinite(blue)):
            shapes[n, :] = 0
            colors[n, :] = 0
            continue
        red, green, blue = max(red, np.float32(0)), max(green, np.float32(0)), max(blue, np.float32(0))
        if len(selected) > 0 and has_bit(selected, i):
            share = np.float32(TINT_SHARE)
            red += share * (np.float32(TINT[0]) - red)
            green += share * (np.float32(TINT[1]) - green)
            blue += share * (np.float32(TINT[2]) - blue)
        colors[n, 0], colors[n, 1], colors[n, 2] = red, green, blue


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def direction_to(mean, eye):
    """Unit vector from the eye to a mean; float32."""
    x, y, z = mean[0] - eye[0], mean[1] - eye[1], mean[2] - eye[2]
    by_length = 1 / np.sqrt(x * x + y * y + z * z)
    return np.float32(x * by_length), np.float32(y * by_length), np.float32(z * by_length)
