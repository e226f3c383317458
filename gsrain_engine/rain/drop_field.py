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

_CHUNK = 8192


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
    margin_m: float
    """How far a streak reaches beyond its drop."""
    reach: float
    """Longest distance that something in view can have for each metre of view depth."""
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
    seen = np.zeros(count, np.bool_)
    _mark_seen(np.uint32(seed), where.wraps, where.fractions, period_m, *culling, seen)
    return drops_at(np.flatnonzero(seen), seed, where)


def count_in_region(count: int, seed: int, where: Offsets, period_m: Float64[np.ndarray, "3"], culling: Culling) -> int:
    """Count the drops that are inside the streak region, seen or not."""
    everywhere = culling._replace(
        slopes=np.array([-np.inf, np.inf, -np.inf, np.inf]), class_far_m=np.full(CLASSES, np.inf)
    )
    seen = np.zeros(count, np.bool_)
    _mark_seen(np.uint32(seed), where.wraps, where.fractions, period_m, *everywhere, seen)
    return int(np.count_nonzero(seen))


@numba.njit(parallel=True, cache=True)
@no_type_check
def _mark_seen(
    seed, wraps, fractions, period, region_rotation, region_half, camera, rotation, slopes, margin, reach, far, seen
):  # fmt: skip
    half = np.float32(2.0**-32)
    everything = np.isinf(far[0])
    for chunk in numba.prange((len(seen) + _CHUNK - 1) // _CHUNK):
        for n in range(chunk * _CHUNK, min(len(seen), (chunk + 1) * _CHUNK)):
            i = np.uint32(n)
            c = (n * CLASS_STRIDE) % CLASSES
            zero, one, two = np.uint32(0), np.uint32(1), np.uint32(2)
            _, _, start_z, _ = pcg4d_scalar(i, zero, zero, seed)
            fraction_z = np.uint32(start_z + fractions[c, 2])
            z = (fraction_z * half - 0.5) * period[2]
            if abs(z) > region_half[2] or (not everything and abs(z - camera[2]) > reach * far[c] + margin):
                continue
            wrap_z = np.uint32(np.uint32(wraps[c, 2]) + np.uint32(fraction_z < start_z))
            start_x, _, _, _ = pcg4d_scalar(i, wrap_z, one, seed)
            fraction_x = np.uint32(start_x + fractions[c, 0])
            x = (fraction_x * half - 0.5) * period[0]
            wrap_x = np.uint32(np.uint32(wraps[c, 0]) + np.uint32(fraction_x < start_x))
            _, start_y, _, _ = pcg4d_scalar(i, wrap_z, np.uint32(wrap_x * two + two), seed)
            fraction_y = np.uint32(start_y + fractions[c, 1])
            y = (fraction_y * half - 0.5) * period[1]
            if abs(region_rotation[0, 0] * x + region_rotation[0, 1] * y) > region_half[0]:
                continue
            if abs(region_rotation[1, 0] * x + region_rotation[1, 1] * y) > region_half[1]:
                continue
            if everything:
                seen[n] = True
                continue
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
            seen[n] = True
