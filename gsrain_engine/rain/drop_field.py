"""Drop field: position of every drop as a function of (seed, t).

Drops live on a lattice cell with periodic faces. A position is a 32-bit fraction of the cell's edge on each axis, so
addition is exact and all implementations agree in every bit. The cell is centered on the streak region and moves with
it. The motions of cell and drops enter as one offset per class and axis, split into whole wraps and a 32-bit fraction.
Wind over height, gusts and turbulence add an offset on x and y that depends on the axes before (`DropAir`), in float32
without any function but sums and products, so that all implementations agree in every bit there, too. A drop that wraps
is redrawn on the axes that come later in the order z, x, y; it therefore jumps only at a face of the cell.
"""

from collections.abc import Callable
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64, UInt32

from ..kernels import NOGIL
from .air import CALM, DropAir
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
    """Offset between the cell and the drops of each class: whole periods and the 32-bit fraction; and the air."""

    wraps: Int32[np.ndarray, "classes 3"]
    fractions: UInt32[np.ndarray, "classes 3"]
    air: DropAir = CALM


class Drops(NamedTuple):
    """Drops of the field by number, with class and position."""

    numbers: Int64[np.ndarray, " m"]
    """Rising; a drop exists if its number is below the cell's count."""
    class_index: Int64[np.ndarray, " m"]
    fractions: UInt32[np.ndarray, "m 3"]
    """Position in the cell: 0 is the lower face, 2^32 the upper one."""
    own_steps: Int32[np.ndarray, "m 2"]
    """Velocity of its own along x and y, in `OWN_STEPS` to a standard deviation."""

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
    motion: DropMotion,
    time_s: float,
    cell_center_m: Float64[np.ndarray, "3"],
    period_m: Float64[np.ndarray, "3"],
    ground_m: float = 0.0,
) -> DropPhases:
    """Split (drop displacement - cell center) / period + 1/2 into whole wraps and a 32-bit fraction.

    `ground_m` is the height of the ground in the cell's frame.
    """
    drift, fallen = motion.drift(time_s), motion.fallen(time_s)
    wraps, fractions = np.empty((len(fallen), 3), np.int32), np.empty((len(fallen), 3), np.uint32)
    for axis in range(2):  # all classes drift alike
        _split(drift[axis : axis + 1], cell_center_m[axis], period_m[axis], wraps[:1, axis], fractions[:1, axis])
        wraps[1:, axis], fractions[1:, axis] = wraps[0, axis], fractions[0, axis]
    _split(-fallen, cell_center_m[2], period_m[2], wraps[:, 2], fractions[:, 2])
    air = motion.wind.air(time_s, motion.scales(time_s), drift, cell_center_m, period_m, ground_m)
    return DropPhases(wraps, fractions, air)


@numba.njit(cache=True, nogil=NOGIL)
@no_type_check
def _split(displacement, center, period, wraps, fractions):
    for c in range(len(displacement)):
        periods = (displacement[c] - center) / period + 0.5
        whole = np.floor(periods)
        wraps[c] = np.int32(whole)
        fractions[c] = np.uint32(np.uint64((periods - whole) * 2.0**32))


_FRACTION, _HALF_PERIOD = np.float32(2.0**-24), np.float32(0.5)
_BELOW_ONE, _STEPS_OF_FRACTION = np.float32(1 - 2.0**-24), np.float32(2.0**24)
_SINE = np.float32(-1 / 6), np.float32(1 / 120), np.float32(-1 / 5040)
_COSINE = np.float32(-1 / 2), np.float32(1 / 24), np.float32(-1 / 720), np.float32(1 / 40320)
_ONE = np.float32(1)


@numba.njit(inline="always")
@no_type_check
def own_steps(drawn):
    """Velocity of its own that a drop draws; readable form: `_own_steps_of`."""
    pairs = (drawn & np.uint32(0x00FF00FF)) + ((drawn >> np.uint32(8)) & np.uint32(0x00FF00FF))
    return np.int32((pairs & np.uint32(0xFFFF)) + (pairs >> np.uint32(16))) - np.int32(510)


@numba.njit(inline="always")
@no_type_check
def _between(rows, row, node, share):
    return rows[row, node] + share * (rows[row, node + 1] - rows[row, node])


@numba.njit(inline="always")
@no_type_check
def offset_x(rows, numbers, slow, gust, own, node, share, height, steps):
    """Offset along x in periods; readable form: `offsets_x`."""
    x = _between(rows, 0, node, share) * slow + _between(rows, 2, node, share) * gust
    return (x + np.float32(steps) * own * height) * numbers[4]


@numba.njit(inline="always")
@no_type_check
def offset_y(rows, numbers, slow, gust, own, node, share, height, steps, fraction_x):
    """Offset along y in periods; readable form: `offsets_y`."""
    turn = (np.float32(fraction_x >> np.uint32(8)) * _FRACTION - _HALF_PERIOD) * numbers[3] * numbers[2]
    square = turn * turn
    sine = turn * (_ONE + square * (_SINE[0] + square * (_SINE[1] + square * _SINE[2])))
    cosine = _ONE + square * (_COSINE[0] + square * (_COSINE[1] + square * (_COSINE[2] + square * _COSINE[3])))
    y = _between(rows, 1, node, share) * slow
    y = y + (_between(rows, 3, node, share) * sine + _between(rows, 4, node, share) * cosine) * gust
    return (y + np.float32(steps) * own * height) * numbers[4]


@numba.njit(parallel=True, cache=True, nogil=NOGIL)
@no_type_check
def mark_drops(
    seed, count, wraps, fractions, geometry, margins, far, everywhere, found, air_rows, air_classes, air_numbers
):
    """Mark the drops with numbers below `count` that may be visible to the camera, by class and turn.

    `geometry` is the cell's period and the first five fields of `DropCulling`. Where `everywhere` is true all drops in
    the streak region are marked.
    """
    for chunk in numba.prange(CLASSES // _CLASSES_BY_CHUNK):
        drawn = np.empty((5, found.shape[1]), np.uint32)
        for c in range(chunk * _CLASSES_BY_CHUNK, (chunk + 1) * _CLASSES_BY_CHUNK):
            first, row = np.uint32((c * FIRST_OF_CLASS) % CLASSES), found[c]
            _mark_class(
                first, count, seed, wraps[c], fractions[c], geometry, margins[c], far[c], everywhere, row, drawn,
                air_rows, air_classes[c], air_numbers,
            )  # fmt: skip


@numba.njit
@no_type_check
def _mark_class(
    first, count, seed, wraps, fractions, geometry, margin, far, everywhere, found, drawn, air_rows, air_class,
    air_numbers,
):  # fmt: skip
    """Place the drops of a class as `place_drops` does and test them.

    The first loop tests heights, and x as far as it is known without a table, branch-free for LLVM's vectorizer; the
    second tests all of the drops that are left, with what the first has `drawn` of them.
    """
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
    slow, gust, own = air_class[0], air_class[1], air_class[2]
    low, tall = air_numbers[0], air_numbers[1]
    low_x, high_x, low_z, high_z = -period_x, period_x, -region_z, region_z
    if not everywhere:  # heights and x between which the view is
        low_x, high_x = _bounds(right_x, down_x, ahead_x, left, right, top, bottom, far, margin)
        low_x, high_x = camera_x + low_x, camera_x + high_x
        below, above = _bounds(right_z, down_z, ahead_z, left, right, top, bottom, far, margin)
        low_z, high_z = max(low_z, camera_z + below), min(high_z, camera_z + above)
    uncertain = air_numbers[6] * slow + air_numbers[7] * gust + np.float32(0.01)  # m: by mean wind and gusts
    first_x = np.float32((low_x - uncertain) / period_x + 0.5)
    width_x = np.float32((high_x - low_x + 2 * uncertain) / period_x)
    own_x = own * air_numbers[4]
    for k in range(len(found)):
        i = np.uint32(first + np.uint32(k) * np.uint32(CLASSES))
        _, _, start_z, _ = pcg4d_scalar(i, zero, zero, seed)
        fraction_z = np.uint32(start_z + moved_z)
        z = (fraction_z * half - 0.5) * period_z
        wrap_z = np.uint32(wraps_z + np.uint32(fraction_z < start_z))
        start_x, drawn_x, drawn_y, _ = pcg4d_scalar(i, wrap_z, one, seed)
        drawn[0, k], drawn[1, k], drawn[2, k], drawn[3, k] = fraction_z, wrap_z, start_x, drawn_x
        drawn[4, k] = drawn_y
        height = low + np.float32(fraction_z >> np.uint32(8)) * _FRACTION * tall
        x = np.float32(np.uint32(start_x + moved_x) >> np.uint32(8)) * _FRACTION
        x = x + np.float32(own_steps(drawn_x)) * own_x * height - first_x
        x = x - np.floor(x)
        found[k] = (i < count) & (z >= low_z) & (z <= high_z) & (x <= width_x)
    for k in range(len(found)):
        if not found[k]:
            continue
        i = np.uint32(first + np.uint32(k) * np.uint32(CLASSES))
        fraction_z, wrap_z, start_x, drawn_x, drawn_y = (
            drawn[0, k], drawn[1, k], drawn[2, k], drawn[3, k], drawn[4, k],
        )  # fmt: skip
        node, share = np.uint32(fraction_z >> np.uint32(24)), np.float32(fraction_z & np.uint32(0xFFFFFF)) * _FRACTION
        height = low + np.float32(fraction_z >> np.uint32(8)) * _FRACTION * tall
        offset = offset_x(air_rows, air_numbers, slow, gust, own, node, share, height, own_steps(drawn_x))
        whole = np.floor(offset)
        part = np.uint32(np.int32(min(offset - whole, _BELOW_ONE) * _STEPS_OF_FRACTION)) << np.uint32(8)
        lattice_x = np.uint32(start_x + moved_x)
        fraction_x = np.uint32(lattice_x + part)
        x = (fraction_x * half - 0.5) * period_x
        found[k] = (x >= low_x) & (x <= high_x)
        if not found[k]:
            continue
        wrap_x = np.uint32(wraps_x + np.uint32(lattice_x < start_x) + np.uint32(fraction_x < part))
        wrap_x = np.uint32(wrap_x + np.uint32(np.int32(whole)))
        _, start_y, _, _ = pcg4d_scalar(i, wrap_z, np.uint32(wrap_x * two + two), seed)
        offset = offset_y(air_rows, air_numbers, slow, gust, own, node, share, height, own_steps(drawn_y), fraction_x)
        part = np.uint32(np.int32(min(offset - np.floor(offset), _BELOW_ONE) * _STEPS_OF_FRACTION)) << np.uint32(8)
        fraction_y = np.uint32(start_y + moved_y + part)
        y = (fraction_y * half - 0.5) * period_y
        z = (fraction_z * half - 0.5) * period_z
        in_region = (abs(turn_xx * x + turn_xy * y) <= region_x) & (abs(turn_yx * x + turn_yy * y) <= region_y)
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
        found[k] = in_region & (in_view | everywhere)


@numba.njit
@no_type_check
def _bounds(right_, down_, ahead_, left, right, top, bottom, far, margin):
    """Lowest and highest coordinate, from the camera, of a view widened by a margin, on an axis of the cell."""
    sides = min(right_ * left, right_ * right) + min(down_ * top, down_ * bottom) + ahead_
    other = max(right_ * left, right_ * right) + max(down_ * top, down_ * bottom) + ahead_
    return min(sides * far, 0.0) - 2 * margin, max(other * far, 0.0) + 2 * margin


def place_drops(numbers: Int64[np.ndarray, " m"], seed: int, where: DropPhases) -> Drops:
    """Place drops by their numbers: readable reference of `_mark_class`."""
    classes = (numbers * CLASS_STRIDE) % CLASSES
    i, s = numbers.astype(np.uint32), np.full(len(numbers), seed, np.uint32)
    zero = np.zeros_like(i)
    moved, wraps = where.fractions[classes], where.wraps[classes].view(np.uint32)

    start_z = pcg4d(i, zero, zero, s)[2]
    z = start_z + moved[:, 2]
    wrap_z = wraps[:, 2] + (z < start_z)
    start_x, *drawn, _ = pcg4d(i, wrap_z, zero + 1, s)
    steps = np.stack([_own_steps_of(each) for each in drawn], axis=1)
    whole, part = _split_offset(offsets_x(where.air, classes, z, steps[:, 0]))
    lattice_x = start_x + moved[:, 0]
    x = lattice_x + part
    wrap_x = wraps[:, 0] + (lattice_x < start_x) + (x < part) + whole
    _, part = _split_offset(offsets_y(where.air, classes, z, steps[:, 1], x))
    y = pcg4d(i, wrap_z, wrap_x * 2 + 2, s)[1] + moved[:, 1] + part
    return Drops(numbers, classes, np.stack([x, y, z], axis=1), steps)


def _own_steps_of(drawn: UInt32[np.ndarray, " m"]) -> Int32[np.ndarray, " m"]:
    """Sum of the four bytes less its mean: nearly a normal distribution with a standard deviation of `OWN_STEPS`."""
    return np.ascontiguousarray(drawn).view(np.uint8).reshape(-1, 4).sum(axis=1, dtype=np.int32) - np.int32(510)


def _split_offset(periods: Float32[np.ndarray, " m"]) -> tuple[UInt32[np.ndarray, " m"], UInt32[np.ndarray, " m"]]:
    """Whole periods, and the rest in 2^-32 of a period."""
    whole = np.floor(periods)
    part = (np.minimum(periods - whole, _BELOW_ONE) * _STEPS_OF_FRACTION).astype(np.uint32) << np.uint32(8)
    return whole.astype(np.int32).view(np.uint32), part


def offsets_x(
    air: DropAir, classes: Int64[np.ndarray, " m"], z: UInt32[np.ndarray, " m"], steps: Int32[np.ndarray, " m"]
) -> Float32[np.ndarray, " m"]:
    """Offset along x in periods of drops at heights z in the cell, by mean wind, gusts and their own velocity."""
    slow, gust, own = air.by_class[classes].T
    row, height = _air_at(air, z)
    return (row(0) * slow + row(2) * gust + steps.astype(np.float32) * own * height) * air.numbers[4]


def offsets_y(
    air: DropAir,
    classes: Int64[np.ndarray, " m"],
    z: UInt32[np.ndarray, " m"],
    steps: Int32[np.ndarray, " m"],
    x: UInt32[np.ndarray, " m"],
) -> Float32[np.ndarray, " m"]:
    """The same along y, which depends on the drop's x, too."""
    slow, gust, own = air.by_class[classes].T
    row, height = _air_at(air, z)
    sine, cosine = _sine_and_cosine(air, x)
    gusts = (row(3) * sine + row(4) * cosine) * gust
    return (row(1) * slow + gusts + steps.astype(np.float32) * own * height) * air.numbers[4]


def _air_at(
    air: DropAir, z: UInt32[np.ndarray, " m"]
) -> tuple[Callable[[int], Float32[np.ndarray, " m"]], Float32[np.ndarray, " m"]]:
    """Rows of the air at heights in the cell, and the heights above the ground in m."""
    node, share = z >> np.uint32(24), (z & np.uint32(0xFFFFFF)).astype(np.float32) * _FRACTION
    height = air.numbers[0] + (z >> np.uint32(8)).astype(np.float32) * _FRACTION * air.numbers[1]
    return lambda row: air.rows[row][node] + share * (air.rows[row][node + 1] - air.rows[row][node]), height


def _sine_and_cosine(
    air: DropAir, x: UInt32[np.ndarray, " m"]
) -> tuple[Float32[np.ndarray, " m"], Float32[np.ndarray, " m"]]:
    """Of the gusts' wavenumber times x from the middle of the cell, to 6e-5 for angles up to 1.4."""
    turn = ((x >> np.uint32(8)).astype(np.float32) * _FRACTION - _HALF_PERIOD) * air.numbers[3] * air.numbers[2]
    square = turn * turn
    sine = turn * (_ONE + square * (_SINE[0] + square * (_SINE[1] + square * _SINE[2])))
    cosine = _ONE + square * (_COSINE[0] + square * (_COSINE[1] + square * (_COSINE[2] + square * _COSINE[3])))
    return sine, cosine


def air_velocities(air: DropAir, drops: Drops) -> Float64[np.ndarray, "m 2"]:
    """Velocities of drops along x and y in m/s: mean wind, gusts and their own; derivatives of their positions."""
    if air is CALM:
        return np.zeros((len(drops.numbers), 2))
    x, z = drops.fractions[:, 0], drops.fractions[:, 2]
    slow, gust, own = air.by_class[drops.class_index].T
    row, _ = _air_at(air, z)
    sine, cosine = _sine_and_cosine(air, x)
    across = -own / slow  # velocity for each step
    along_x = row(5) + row(7) + across * drops.own_steps[:, 0]
    carried = (along_x - air.numbers[5]) * air.numbers[2] * gust * (row(3) * cosine - row(4) * sine)
    along_y = row(6) + row(8) * cosine + row(9) * sine + carried + across * drops.own_steps[:, 1]
    return np.stack([along_x, along_y], axis=1).astype(np.float64)
