"""Drop field: position of every drop as a function of (seed, t).

Drops live on a lattice cell with periodic faces. A position is a 32-bit fraction of the cell's edge on each axis, so
addition is exact and all implementations agree in every bit. The cell is centered on the streak region and moves with
it. The motions of cell and drops enter as one offset per class and axis, split into whole wraps and a 32-bit fraction.
A drop that wraps is redrawn on the axes that come later in the order z, x, y; it therefore jumps only at a face of the
cell.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float64, Int32, Int64, UInt32

from .drop_motion import DropMotion
from .pcg_hash import pcg4d, pcg4d_scalar
from .properties import CLASSES

CLASS_STRIDE = 10125
"""Odd, about CLASSES / golden ratio: i -> i * stride mod CLASSES visits every class once in CLASSES drops, evenly."""

FIRST_OF_CLASS = pow(CLASS_STRIDE, -1, CLASSES)
"""Inverse of `CLASS_STRIDE`: class c has the drops (c * this mod CLASSES) + k CLASSES."""

_CLASSES_BY_CHUNK = 64
LANES = 16


class DropPhases(NamedTuple):
    """Offset between the cell and the drops of each class: whole periods and the 32-bit fraction."""

    wraps: Int32[np.ndarray, "classes 3"]
    fractions: UInt32[np.ndarray, "classes 3"]


class Drops(NamedTuple):
    """Drops of the field by number, with class and position."""

    numbers: Int64[np.ndarray, " m"]
    """Rising; a drop exists if its number is below the cell's count."""
    class_index: Int64[np.ndarray, " m"]
    fractions: UInt32[np.ndarray, "m 3"]
    """Position in the cell: 0 is the lower face, 2^32 the upper one."""

    def positions(self, period_m: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "m 3"]:
        """In meters from the center of the cell."""
        return (self.fractions * 2.0**-32 - 0.5) * period_m


class DropCulling(NamedTuple):
    """Parameters of the cheap, conservative visibility tests. Cell frame, meters."""

    region_rotation: Float64[np.ndarray, "2 2"]
    """Cell x, y to region x, y."""
    region_half: Float64[np.ndarray, "3"]
    """Half the edges of the streak region, which shares its center with the cell."""
    camera_position: Float64[np.ndarray, "3"]
    """Camera relative to the center of the cell."""
    cell_to_camera: Float64[np.ndarray, "3 3"]
    slopes: Float64[np.ndarray, "4"]
    """Edges of the view: lowest and highest x/z, lowest and highest y/z."""
    class_margin_m: Float64[np.ndarray, " classes"]
    """Maximum distance of a streak's fragments from its drop."""
    class_far_m: Float64[np.ndarray, " classes"]
    """View depth beyond which haze represents the drops of a class."""


def drop_phases(
    motion: DropMotion, time_s: float, cell_center_m: Float64[np.ndarray, "3"], period_m: Float64[np.ndarray, "3"]
) -> DropPhases:
    """Split (drop displacement - cell center) / period + 1/2 into whole wraps and a 32-bit fraction."""
    drift, fallen = motion.drift(time_s), motion.fallen(time_s)
    wraps, fractions = np.empty((len(fallen), 3), np.int32), np.empty((len(fallen), 3), np.uint32)
    for axis in range(2):  # all classes drift alike
        _split(drift[axis : axis + 1], cell_center_m[axis], period_m[axis], wraps[:1, axis], fractions[:1, axis])
        wraps[1:, axis], fractions[1:, axis] = wraps[0, axis], fractions[0, axis]
    _split(-fallen, cell_center_m[2], period_m[2], wraps[:, 2], fractions[:, 2])
    return DropPhases(wraps, fractions)


@numba.njit(cache=True)
@no_type_check
def _split(displacement, center, period, wraps, fractions):
    for c in range(len(displacement)):
        periods = (displacement[c] - center) / period + 0.5
        whole = np.floor(periods)
        wraps[c] = np.int32(whole)
        fractions[c] = np.uint32(np.uint64((periods - whole) * 2.0**32))


@numba.njit(parallel=True, cache=True)
@no_type_check
def mark_drops(seed, count, wraps, fractions, geometry, margins, far, everywhere, found):
    """Mark the drops with numbers below `count` that may be visible to the camera, by class and turn.

    `geometry` is the cell's period and the first five fields of `DropCulling`. Where `everywhere` is true all drops in
    the streak region are marked.
    """
    for chunk in numba.prange(CLASSES // _CLASSES_BY_CHUNK):
        for c in range(chunk * _CLASSES_BY_CHUNK, (chunk + 1) * _CLASSES_BY_CHUNK):
            first, row = np.uint32((c * FIRST_OF_CLASS) % CLASSES), found[c]
            _mark_class(first, count, seed, wraps[c], fractions[c], geometry, margins[c], far[c], everywhere, row)


@numba.njit
@no_type_check
def _mark_class(first, count, seed, wraps, fractions, geometry, margin, far, everywhere, found):
    """Place the drops of a class as `place_drops` does and test them, branch-free for LLVM's vectorizer."""
    # Copied to locals: the compiler can't prove that writes to `found` leave `geometry` unchanged.
    period_x, period_y, period_z = geometry[0], geometry[1], geometry[2]
    turn_xx, turn_xy, turn_yx, turn_yy = geometry[3], geometry[4], geometry[5], geometry[6]
    region_x, region_y, region_z = geometry[7], geometry[8], geometry[9]
    camera_x, camera_y, camera_z = geometry[10], geometry[11], geometry[12]
    right_x, right_y, right_z = geometry[13], geometry[14], geometry[15]
    down_x, down_y, down_z = geometry[16], geometry[17], geometry[18]
    ahead_x, ahead_y, ahead_z = geometry[19], geometry[20], geometry[21]
    left, right, top, bottom = geometry[22], geometry[23], geometry[24], geometry[25]
    half = np.float64(2.0**-32)
    zero, one, two = np.uint32(0), np.uint32(1), np.uint32(2)
    wraps_x, wraps_z = np.uint32(wraps[0]), np.uint32(wraps[2])
    moved_x, moved_y, moved_z = fractions[0], fractions[1], fractions[2]
    for k in range(len(found)):
        i = np.uint32(first + np.uint32(k) * np.uint32(CLASSES))
        _, _, start_z, _ = pcg4d_scalar(i, zero, zero, seed)
        fraction_z = np.uint32(start_z + moved_z)
        wrap_z = np.uint32(wraps_z + np.uint32(fraction_z < start_z))
        start_x, _, _, _ = pcg4d_scalar(i, wrap_z, one, seed)
        fraction_x = np.uint32(start_x + moved_x)
        wrap_x = np.uint32(wraps_x + np.uint32(fraction_x < start_x))
        _, start_y, _, _ = pcg4d_scalar(i, wrap_z, np.uint32(wrap_x * two + two), seed)
        fraction_y = np.uint32(start_y + moved_y)
        x = (fraction_x * half - 0.5) * period_x
        y = (fraction_y * half - 0.5) * period_y
        z = (fraction_z * half - 0.5) * period_z
        in_region = (
            (abs(z) <= region_z)
            & (abs(turn_xx * x + turn_xy * y) <= region_x)
            & (abs(turn_yx * x + turn_yy * y) <= region_y)
        )
        dx, dy, dz = x - camera_x, y - camera_y, z - camera_z
        u = right_x * dx + right_y * dy + right_z * dz
        v = down_x * dx + down_y * dy + down_z * dz
        depth = ahead_x * dx + ahead_y * dy + ahead_z * dz
        in_view = (
            (depth >= 0)
            & (depth <= far)
            & (u >= left * depth - margin)
            & (u <= right * depth + margin)
            & (v >= top * depth - margin)
            & (v <= bottom * depth + margin)
        )
        found[k] = (i < count) & in_region & (in_view | everywhere)


def place_drops(numbers: Int64[np.ndarray, " m"], seed: int, where: DropPhases) -> Drops:
    """Place drops by their numbers: readable reference of `_mark_class`."""
    classes = (numbers * CLASS_STRIDE) % CLASSES
    i, s = numbers.astype(np.uint32), np.full(len(numbers), seed, np.uint32)
    zero = np.zeros_like(i)
    fractions = np.empty((len(numbers), 3), np.uint32)

    def wraps_on(axis: int, start: UInt32[np.ndarray, " m"]) -> UInt32[np.ndarray, " m"]:
        fractions[:, axis] = start + where.fractions[classes, axis]
        return where.wraps[classes, axis].view(np.uint32) + (fractions[:, axis] < start)

    wrap_z = wraps_on(2, pcg4d(i, zero, zero, s)[2])
    wrap_x = wraps_on(0, pcg4d(i, wrap_z, zero + 1, s)[0])
    wraps_on(1, pcg4d(i, wrap_z, wrap_x * 2 + 2, s)[1])
    return Drops(numbers, classes, fractions)
