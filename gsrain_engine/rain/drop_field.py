"""The drop field: where every drop is, as a function of (seed, t).

Drops live on a lattice cell with periodic faces. A position is a 32-bit fraction of the cell's edge on each axis, so
adding is exact and every implementation agrees in every bit. The cell is centred on the streak region and moves with
it; what moves the cell and what moves the drop enter as one offset a class and axis, split into whole wraps and a
32-bit fraction. A drop that wraps is drawn anew on the axes that come later in the order z, x, y; it therefore jumps
only at a face of the cell.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float64, Int32, Int64, UInt32

from .drop_sizes import CLASSES
from .random_bits import pcg4d, pcg4d_scalar

CLASS_STRIDE = 10125
"""Odd, about CLASSES / golden ratio: i -> i * stride mod CLASSES visits every class once in CLASSES drops, evenly."""

FIRST_OF_CLASS = pow(CLASS_STRIDE, -1, CLASSES)
"""Class c belongs to the drops c * this mod CLASSES, that plus CLASSES, and so on."""

_CLASSES_BY_CHUNK = 64


class Offsets(NamedTuple):
    """How far the cell and the drops of each class are apart: whole periods and the 32-bit rest."""

    wraps: Int32[np.ndarray, "classes 3"]
    fractions: UInt32[np.ndarray, "classes 3"]


class Drops(NamedTuple):
    """Some drops of the field."""

    numbers: Int64[np.ndarray, " m"]
    """Rising; a drop exists when its number is below the cell's count."""
    class_index: Int64[np.ndarray, " m"]
    fractions: UInt32[np.ndarray, "m 3"]
    """Position in the cell: 0 is the lower face, 2^32 the upper one."""

    def positions(self, period_m: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "m 3"]:
        """Positions in metres from the centre of the cell."""
        return (self.fractions * 2.0**-32 - 0.5) * period_m


class Culling(NamedTuple):
    """Which drops are worth drawing: cheap, generous tests in the cell's frame, in metres."""

    region_rotation: Float64[np.ndarray, "2 2"]
    """Cell x, y to region x, y."""
    region_half: Float64[np.ndarray, "3"]
    """Half the edges of the streak region, which shares its centre with the cell."""
    camera_position: Float64[np.ndarray, "3"]
    """Camera relative to the centre of the cell."""
    cell_to_camera: Float64[np.ndarray, "3 3"]
    slopes: Float64[np.ndarray, "4"]
    """Edges of the view: lowest and highest x/z, lowest and highest y/z."""
    class_margin_m: Float64[np.ndarray, " classes"]
    """How far a streak reaches beyond its drop."""
    class_far_m: Float64[np.ndarray, " classes"]
    """View depth beyond which drops of a class are left to the haze."""


def offsets(
    displacement_m: Float64[np.ndarray, "classes 3"],
    cell_center_m: Float64[np.ndarray, "3"],
    period_m: Float64[np.ndarray, "3"],
) -> Offsets:
    """Split (drop displacement - cell centre) / period + 1/2 into whole wraps and a 32-bit fraction."""
    periods = (displacement_m - cell_center_m) / period_m + 0.5
    wraps = np.floor(periods)
    return Offsets(wraps.astype(np.int32), ((periods - wraps) * 2.0**32).astype(np.uint64).astype(np.uint32))


def drops_at(numbers: Int64[np.ndarray, " m"], seed: int, where: Offsets) -> Drops:
    """Place drops by their numbers: the readable reference of the compiled search below."""
    classes = (numbers * CLASS_STRIDE) % CLASSES
    i, s = numbers.astype(np.uint32), np.full(len(numbers), seed, np.uint32)
    zero = np.zeros_like(i)
    fractions = np.empty((len(numbers), 3), np.uint32)
    wrap_z = _place(pcg4d(i, zero, zero, s)[2], where, classes, 2, fractions)
    wrap_x = _place(pcg4d(i, wrap_z, zero + 1, s)[0], where, classes, 0, fractions)
    _place(pcg4d(i, wrap_z, wrap_x * 2 + 2, s)[1], where, classes, 1, fractions)
    return Drops(numbers, classes, fractions)


def _place(
    start: UInt32[np.ndarray, " m"],
    where: Offsets,
    classes: Int64[np.ndarray, " m"],
    axis: int,
    fractions: UInt32[np.ndarray, "m 3"],
) -> UInt32[np.ndarray, " m"]:
    """Write the fraction on one axis and return how often each drop has wrapped there (modulo 2^32)."""
    moved = start + where.fractions[classes, axis]
    fractions[:, axis] = moved
    return where.wraps[classes, axis].view(np.uint32) + (moved < start)


def find_drops(count: int, seed: int, where: Offsets, period_m: Float64[np.ndarray, "3"], culling: Culling) -> Drops:
    """Find the drops below a number that the camera may see, in rising order."""
    return drops_at(_search(count, seed, where, period_m, culling, only_seen=True), seed, where)


def count_in_region(count: int, seed: int, where: Offsets, period_m: Float64[np.ndarray, "3"], culling: Culling) -> int:
    """Count the drops that are inside the streak region, seen or not."""
    return len(_search(count, seed, where, period_m, culling, only_seen=False))


def _search(
    count: int, seed: int, where: Offsets, period_m: Float64[np.ndarray, "3"], culling: Culling, *, only_seen: bool
) -> Int64[np.ndarray, " m"]:
    lowest, span = _windows(period_m, culling)
    if not only_seen:
        lowest, span = np.zeros_like(lowest), np.full_like(span, 0xFFFFFFFF)
    found = np.zeros((CLASSES, -(-count // CLASSES)), np.bool_)
    _mark(np.uint32(seed), count, where.wraps, where.fractions, lowest, span, period_m, *culling, only_seen, found)
    class_index, turn = np.divmod(np.flatnonzero(found), found.shape[1])
    return np.sort(turn * CLASSES + class_index * FIRST_OF_CLASS % CLASSES)


def _windows(
    period_m: Float64[np.ndarray, "3"], culling: Culling
) -> tuple[UInt32[np.ndarray, "classes 3"], UInt32[np.ndarray, "classes 3"]]:
    """Fractions of the cell between which a drop of each class can be seen on each axis: the first, and how many."""
    slopes = np.abs(culling.slopes)
    reach = np.sqrt(1 + max(slopes[:2]) ** 2 + max(slopes[2:]) ** 2)  # distance over depth, at most, within the view
    away = (reach * culling.class_far_m + 2 * culling.class_margin_m)[:, None] / period_m
    center = culling.camera_position / period_m + 0.5
    lowest = np.floor(np.clip(center - away, 0, 1) * (2.0**32 - 1))
    highest = np.ceil(np.clip(center + away, 0, 1) * (2.0**32 - 1))
    return lowest.astype(np.uint32), (highest - lowest).astype(np.uint32)


@numba.njit(parallel=True, cache=True)
@no_type_check
def _mark(
    seed, count, wraps, fractions, lowest, span, period, region_rotation, region_half, camera, rotation, slopes,
    margins, far, only_seen, found,
):  # fmt: skip
    """Mark drops by class and turn."""
    half = np.float64(2.0**-32)
    turns = found.shape[1]
    for chunk in numba.prange(CLASSES // _CLASSES_BY_CHUNK):
        at = np.empty((3, turns), np.uint32)
        for c in range(chunk * _CLASSES_BY_CHUNK, (chunk + 1) * _CLASSES_BY_CHUNK):
            first = (c * FIRST_OF_CLASS) % CLASSES
            members = max(0, (count - first + CLASSES - 1) // CLASSES)
            row, margin = found[c], margins[c]
            _place_class(np.uint32(first), members, seed, wraps[c], fractions[c], lowest[c], span[c], at, row)
            for k in range(members):
                if not row[k]:
                    continue
                row[k] = False
                x = (at[0, k] * half - 0.5) * period[0]
                y = (at[1, k] * half - 0.5) * period[1]
                z = (at[2, k] * half - 0.5) * period[2]
                if abs(z) > region_half[2]:
                    continue
                if abs(region_rotation[0, 0] * x + region_rotation[0, 1] * y) > region_half[0]:
                    continue
                if abs(region_rotation[1, 0] * x + region_rotation[1, 1] * y) > region_half[1]:
                    continue
                if only_seen:
                    dx, dy, dz = x - camera[0], y - camera[1], z - camera[2]
                    depth = rotation[2, 0] * dx + rotation[2, 1] * dy + rotation[2, 2] * dz
                    if depth < 0 or depth > far[c]:
                        continue
                    u = rotation[0, 0] * dx + rotation[0, 1] * dy + rotation[0, 2] * dz
                    v = rotation[1, 0] * dx + rotation[1, 1] * dy + rotation[1, 2] * dz
                    if u < slopes[0] * depth - margin or u > slopes[1] * depth + margin:
                        continue
                    if v < slopes[2] * depth - margin or v > slopes[3] * depth + margin:
                        continue
                row[k] = True


@numba.njit
@no_type_check
def _place_class(first, members, seed, wraps, fractions, lowest, span, at, near):
    """Place a class' drops as `drops_at` does, and mark those inside the windows: integers and no branch, so SIMD."""
    zero, one, two = np.uint32(0), np.uint32(1), np.uint32(2)
    wraps_x, wraps_z = np.uint32(wraps[0]), np.uint32(wraps[2])
    moved_x, moved_y, moved_z = fractions[0], fractions[1], fractions[2]
    low_x, low_y, low_z = lowest[0], lowest[1], lowest[2]
    span_x, span_y, span_z = span[0], span[1], span[2]
    for k in range(members):
        i = np.uint32(first + np.uint32(k) * np.uint32(CLASSES))
        _, _, start_z, _ = pcg4d_scalar(i, zero, zero, seed)
        z = np.uint32(start_z + moved_z)
        wrap_z = np.uint32(wraps_z + np.uint32(z < start_z))
        start_x, _, _, _ = pcg4d_scalar(i, wrap_z, one, seed)
        x = np.uint32(start_x + moved_x)
        wrap_x = np.uint32(wraps_x + np.uint32(x < start_x))
        _, start_y, _, _ = pcg4d_scalar(i, wrap_z, np.uint32(wrap_x * two + two), seed)
        y = np.uint32(start_y + moved_y)
        at[0, k], at[1, k], at[2, k] = x, y, z
        near[k] = (np.uint32(x - low_x) <= span_x) & (np.uint32(y - low_y) <= span_y) & (np.uint32(z - low_z) <= span_z)
