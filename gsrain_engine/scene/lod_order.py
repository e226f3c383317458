"""Level-of-detail (LOD) order of Gaussians in memory: largest contribution first, spatial neighbors together."""

import math
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt32, UInt64

from ..kernels import kernel, range_of
from .gaussians import Gaussians, scene_cache
from .scene import robust_bounds

LEVELS = (1 / 8, 1 / 4, 1 / 2, 1.0)
"""Fractions of all Gaussians at which the levels end."""

_CELLS = 1024  # cells along each axis: ten bits of a Morton code


def lod_level_ends(count: int) -> tuple[int, ...]:
    """Number of Gaussians up to the end of each level; the last is `count`."""
    return tuple(math.ceil(count * share) for share in LEVELS)


def lod_order(gaussians: Gaussians) -> UInt32[np.ndarray, " n"]:
    """Permutation of the Gaussians into LOD order: the index of the Gaussian at each position.

    A level is a weighted sample without replacement of the remaining Gaussians (Efraimidis and Spirakis 2006). The
    weight is opacity times s1 s2 + s2 s3 + s3 s1, proportional to the mean of the ellipsoid's three cross-sections, so
    that it is independent of the view. Large Gaussians come first, and every level gets an even share of a road of a
    thousand equal Gaussians instead of leaving a hole. Within a level they follow a Morton curve of 2^30 cells over the
    robust bounds (Morton 1966), for coherent memory access. Non-finite values have no weight. Deterministic for any
    number of threads. Memory: 12 bytes per Gaussian.
    """
    # One 64-bit key per Gaussian with its index in the lower half: no two are equal, so any sort is stable.
    keys = _keys(_contributions(gaussians))
    keys.sort()
    return _sorted_along_curve(gaussians, keys, lod_level_ends(len(keys)))


def morton_order(gaussians: Gaussians) -> UInt32[np.ndarray, " n"]:
    """Permutation of the Gaussians along the Morton curve of `lod_order`, without levels: neighbors are together."""
    return _sorted_along_curve(gaussians, np.arange(len(gaussians), dtype=np.uint64), (len(gaussians),))


def _sorted_along_curve(
    gaussians: Gaussians, keys: UInt64[np.ndarray, " n"], ends: tuple[int, ...]
) -> UInt32[np.ndarray, " n"]:
    """Sort keys, whose lower halves are indices, along the curve within each level; returns the indices."""
    box = robust_bounds(gaussians)
    cells_a_unit = _CELLS / np.maximum(box.high - box.low, np.finfo(np.float32).tiny)
    start = 0
    for end in ends:
        level = keys[start:end]
        _to_morton_keys(gaussians.means, np.ascontiguousarray(box.low), cells_a_unit, level)
        level.sort()
        start = end
    return keys.astype(np.uint32)  # the lower half: the index


def sort_into_lod_order(gaussians: Gaussians) -> None:
    """Sort the arrays of a set in place into LOD order, with 12 bytes per Gaussian of extra memory.

    Gaussians are immutable values: call this only on newly created arrays that nothing else references.

    Raises:
        ValueError: When an array can't be written.
    """
    for name in ("means", "scales", "quaternions", "opacities", "sh"):
        flags = getattr(gaussians, name).flags
        if not (flags.c_contiguous and flags.writeable):
            raise ValueError(f"Gaussians.{name} must be contiguous and writable to be reordered in place")
    sh = gaussians.sh.reshape(len(gaussians), 3 * gaussians.sh.shape[1])
    order = lod_order(gaussians)
    _permute(gaussians.means, gaussians.scales, gaussians.quaternions, gaussians.opacities[:, None], sh, order)


def lod_growth(gaussians: Gaussians, share: float) -> float:
    """Scale factor at which the first `share` of the Gaussians covers as much as all: 1 or more."""
    if share >= 1 or not len(gaussians):
        return 1.0
    contributions = _contributions(gaussians).astype(np.float64)
    kept = float(contributions[: math.ceil(share * len(gaussians))].sum())
    return math.sqrt(float(contributions.sum()) / kept) if kept > 0 else 1.0


def lod_sample(gaussians: Gaussians, share: float) -> tuple[Bool[np.ndarray, " n"], float]:
    """Mask of a weighted sample of the Gaussians in any order, as the levels of `lod_order`, and its `lod_growth`."""
    contributions = _contributions(gaussians)
    keys = _keys(contributions)
    keys.sort()
    sampled = np.zeros(len(keys), np.bool_)
    sampled[keys[: math.ceil(share * len(keys))].astype(np.uint32)] = True
    total, kept = contributions.sum(dtype=np.float64), contributions[sampled].sum(dtype=np.float64)
    return sampled, math.sqrt(total / kept) if kept > 0 else 1.0


def thinned(
    gaussians: Gaussians, to_camera: Float64[np.ndarray, "4 4"], intrinsics: tuple[float, ...], least_px2: float
) -> tuple[Int64[np.ndarray, " m"], Float32[np.ndarray, "n 3"]]:
    """Members in view, of those that cover less than `least_px2` only a sample, and the scales of all Gaussians.

    A Gaussian that covers the share r < 1 of that area is drawn if a number in (0, 1), its own for all images, is
    below r, and then with 1 / r times its area: the sample covers as much as all. As the camera comes nearer, it grows
    from nothing while r increases by a quarter, so that it does not pop up. Scales of those left out are 0. `to_camera`
    is a similarity, and `intrinsics` are focal lengths, principal point and size of a pinhole image.
    """
    fx, fy, cx, cy, width, height = intrinsics
    slopes = (max(cx, width - cx) + _BLUR_PX) / fx, (max(cy, height - cy) + _BLUR_PX) / fy
    members, scales = np.empty(len(gaussians), np.int64), np.zeros_like(gaussians.scales)
    to_camera = np.ascontiguousarray(to_camera, np.float64)
    count = _thin(_areas(gaussians), gaussians.scales, to_camera, fx * fy / least_px2, slopes, members, scales)
    return members[:count], scales


_BLUR_PX = 2.0  # reach of the smallest splat
_REACH = 3.4  # standard deviations to which an opaque splat reaches
_FADING = 4.0  # a Gaussian has faded in when it covers 1 + 1 / `_FADING` times the area from which it is drawn
_MEAN_FADE = _FADING * math.log(1 + 1 / _FADING)  # mean share that is faded in, over all that may be drawn


@scene_cache(maxsize=64)
def _areas(gaussians: Gaussians) -> Float32[np.ndarray, "5 n"]:
    """Mean area that each Gaussian hides; that over a number in (0, 1), hashed from its index; and its mean."""
    areas = np.float32(2 * math.pi / 3) * _contributions(gaussians)
    return np.ascontiguousarray(np.stack([areas, areas / _hashed(len(areas)), *gaussians.means.T]))


@kernel(error_model="numpy")
@no_type_check
def _thin(lines, scales, m, by_area, slopes, members, grown):
    slope_x, slope_y = slopes
    aside_x, aside_y = np.sqrt(1 + slope_x * slope_x), np.sqrt(1 + slope_y * slope_y)
    areas, ranks, xs, ys, zs = lines[0], lines[1], lines[2], lines[3], lines[4]
    # The camera's place among the Gaussians, whose unit is as long as the first column.
    square = m[0, 0] * m[0, 0] + m[1, 0] * m[1, 0] + m[2, 0] * m[2, 0]
    unit, by_area = np.sqrt(square), np.float32(by_area)
    eye_x = np.float32(-(m[0, 0] * m[0, 3] + m[1, 0] * m[1, 3] + m[2, 0] * m[2, 3]) / square)
    eye_y = np.float32(-(m[0, 1] * m[0, 3] + m[1, 1] * m[1, 3] + m[2, 1] * m[2, 3]) / square)
    eye_z = np.float32(-(m[0, 2] * m[0, 3] + m[1, 2] * m[1, 3] + m[2, 2] * m[2, 3]) / square)
    near = np.empty(len(areas), np.float32)
    for i in range(len(near)):  # vectorized
        x, y, z = xs[i] - eye_x, ys[i] - eye_y, zs[i] - eye_z
        near[i] = by_area / (x * x + y * y + z * z)
    found = 0
    for i in range(len(near)):  # without branches
        members[found] = i
        found += np.int64(ranks[i] * near[i] > np.float32(1))
    drawn = 0
    for k in range(found):
        i = members[k]
        faded = _FADING * (ranks[i] * near[i] - 1.0)
        growth = np.sqrt(min(faded, 1.0) / min(_MEAN_FADE * areas[i] * near[i], 1.0))
        reach = _REACH * unit * growth * max(scales[i, 0], scales[i, 1], scales[i, 2])
        x = m[0, 0] * xs[i] + m[0, 1] * ys[i] + m[0, 2] * zs[i] + m[0, 3]
        y = m[1, 0] * xs[i] + m[1, 1] * ys[i] + m[1, 2] * zs[i] + m[1, 3]
        z = m[2, 0] * xs[i] + m[2, 1] * ys[i] + m[2, 2] * zs[i] + m[2, 3]
        if abs(x) <= slope_x * z + aside_x * reach and abs(y) <= slope_y * z + aside_y * reach:
            for axis in range(3):
                grown[i, axis] = growth * scales[i, axis]
            members[drawn] = i
            drawn += 1
    return drawn


def _contributions(gaussians: Gaussians) -> Float32[np.ndarray, " n"]:
    values = np.empty(len(gaussians.opacities), np.float32)
    _write_contributions(gaussians.scales, gaussians.opacities, values)
    return values


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _write_contributions(portion, scales, opacities, values):
    for n in range_of(portion, len(opacities)):
        a, b, c = np.float64(scales[n, 0]), np.float64(scales[n, 1]), np.float64(scales[n, 2])
        value = np.float32(opacities[n] * (a * b + b * c + c * a))
        values[n] = value if 0 < value < np.inf else np.float32(0)


def _keys(contributions: Float32[np.ndarray, " n"]) -> UInt64[np.ndarray, " n"]:
    """Convert weights to sort keys of a weighted sample: w / -ln(u), u in (0, 1) hashed from the index."""
    ranks, keys = np.empty(len(contributions), np.float32), np.empty(len(contributions), np.uint64)
    _write_ranks(contributions, ranks)
    _write_keys(ranks.view(np.uint32), keys)
    return keys


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _write_ranks(portion, contributions, ranks):
    for n in range_of(portion, len(contributions)):
        ranks[n] = min(contributions[n] / -np.log(_uniform(np.uint64(n))), 3e38)


@kernel()
@no_type_check
def _hashed(count):
    """Numbers in (0, 1) hashed from the index; others than those of a weighted sample."""
    numbers = np.empty(count, np.float32)
    for n in range(count):
        numbers[n] = _uniform(~np.uint64(n))
    return numbers


@numba.njit(inline="always")
@no_type_check
def _uniform(n):
    """Number in (0, 1) hashed from an integer, by splitmix64 (Steele 2014)."""
    x = n * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    x ^= x >> np.uint64(31)
    return ((x >> np.uint64(11)) + 0.5) * 2.0**-53


@kernel(parallel=True)
@no_type_check
def _write_keys(portion, bits, keys):
    """Sort keys of positive float32 numbers, whose bits sort like the numbers themselves."""
    for n in range_of(portion, len(bits)):
        keys[n] = (np.uint64(0x7F800000 - bits[n]) << np.uint64(32)) | np.uint64(n)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _to_morton_keys(portion, means, low, cells_a_unit, keys):
    """Replace the upper half of each key by the Morton code of the Gaussian whose index is in the lower half."""
    for k in range_of(portion, len(keys)):
        n = keys[k] & np.uint64(0xFFFFFFFF)
        code = np.uint64(0)
        for axis in range(3):
            cell = (means[n, axis] - low[axis]) * cells_a_unit[axis]
            if not (cell > 0):  # also NaN
                cell = 0.0
            code |= _spread(np.uint64(min(_CELLS - 1.0, cell))) << np.uint64(axis)
        keys[k] = (code << np.uint64(32)) | n


@numba.njit(inline="always")
@no_type_check
def _spread(x):
    """Ten bits with two zeros before each."""
    x = (x | (x << np.uint64(16))) & np.uint64(0x030000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x0300F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x030C30C3)
    return (x | (x << np.uint64(2))) & np.uint64(0x09249249)


@kernel()
@no_type_check
def _permute(means, scales, quaternions, opacities, sh, order):
    """Move row order[n] of each array to row n, one cycle of the permutation after the other; overwrites `order`."""
    held = np.empty(11 + sh.shape[1], np.float32)
    for first in range(len(order)):
        if order[first] == first:
            continue
        _copy(means[first], held[0:3])
        _copy(scales[first], held[3:6])
        _copy(quaternions[first], held[6:10])
        _copy(opacities[first], held[10:11])
        _copy(sh[first], held[11:])
        place = first
        while order[place] != first:
            source = order[place]
            order[place] = place  # done
            _copy(means[source], means[place])
            _copy(scales[source], scales[place])
            _copy(quaternions[source], quaternions[place])
            _copy(opacities[source], opacities[place])
            _copy(sh[source], sh[place])
            place = source
        order[place] = place
        _copy(held[0:3], means[place])
        _copy(held[3:6], scales[place])
        _copy(held[6:10], quaternions[place])
        _copy(held[10:11], opacities[place])
        _copy(held[11:], sh[place])


@numba.njit(inline="always")
@no_type_check
def _copy(source, target):
    for i in range(len(source)):
        target[i] = source[i]
