"""Drop field: position of every drop as a function of (seed, t).

Drops live on a lattice cell with periodic faces. A position is a 32-bit fraction of the cell's edge on each axis, so
addition is exact and all implementations agree in every bit. The cell is centered on the streak region and moves with
it. The motions of cell and drops enter as one offset per class and axis, split into whole wraps and a 32-bit fraction.
Wind over height, gusts and turbulence add an offset on x and y that depends on the axes before (`DropAir`), in float32
without any function but sums and products, so that all implementations agree in every bit there, too. A drop that wraps
is redrawn on the axes that come later in the order z, x, y; it therefore jumps only at a face of the cell.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float64, Int32, Int64, UInt32

from ..kernels import kernel, range_of
from .air import CALM, DropAir
from .drop_motion import DropMotion
from .pcg_hash import pcg4d_scalar
from .properties import CLASSES

CLASS_STRIDE = 10125
"""Odd, about CLASSES / golden ratio: i -> i * stride mod CLASSES visits every class once in CLASSES drops, evenly."""

FIRST_OF_CLASS = pow(CLASS_STRIDE, -1, CLASSES)
"""Inverse of `CLASS_STRIDE`: class c has the drops (c * this mod CLASSES) + k CLASSES."""

_CLASSES_BY_CHUNK = 64
_LANES = 16


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
    air_velocity_m_s: Float64[np.ndarray, "m 2"]
    """Velocity along x and y: mean wind, gusts and the drop's own; the derivative of its position."""

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


@kernel()
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
    """Velocity of its own that a drop draws, in `OWN_STEPS` to a standard deviation.

    It is the sum of the four bytes less its mean: nearly a normal distribution.
    """
    pairs = (drawn & np.uint32(0x00FF00FF)) + ((drawn >> np.uint32(8)) & np.uint32(0x00FF00FF))
    return np.int32((pairs & np.uint32(0xFFFF)) + (pairs >> np.uint32(16))) - np.int32(510)


@numba.njit(inline="always")
@no_type_check
def _between(rows, row, node, share):
    return rows[row, node] + share * (rows[row, node + 1] - rows[row, node])


@numba.njit(inline="always")
@no_type_check
def _at_height(fraction_z, numbers):
    """Node below a height in the cell, share of the way to the next one, and the height above the ground in m."""
    share = np.float32(fraction_z & np.uint32(0xFFFFFF)) * _FRACTION
    height = numbers[0] + np.float32(fraction_z >> np.uint32(8)) * _FRACTION * numbers[1]
    return np.uint32(fraction_z >> np.uint32(24)), share, height


@numba.njit(inline="always")
@no_type_check
def _sine_and_cosine(fraction_x, numbers):
    """Of the gusts' wavenumber times x from the middle of the cell, to 6e-5 for angles up to 1.4."""
    turn = (np.float32(fraction_x >> np.uint32(8)) * _FRACTION - _HALF_PERIOD) * numbers[3] * numbers[2]
    square = turn * turn
    sine = turn * (_ONE + square * (_SINE[0] + square * (_SINE[1] + square * _SINE[2])))
    cosine = _ONE + square * (_COSINE[0] + square * (_COSINE[1] + square * (_COSINE[2] + square * _COSINE[3])))
    return sine, cosine


@numba.njit(inline="always")
@no_type_check
def _split_offset(periods):
    """Whole periods of an offset, and the rest in 2^-32 of a period."""
    whole = np.floor(periods)
    return whole, np.uint32(np.int32(min(_BELOW_ONE, periods - whole) * _STEPS_OF_FRACTION)) << np.uint32(8)


@numba.njit(inline="always")
@no_type_check
def _place_x(rows, numbers, air, fraction_z, start_x, drawn_x, moved_x, wraps_x):
    """Place along x of a drop at a height, and how often it has wrapped there; `air` is its class's."""
    node, share, height = _at_height(fraction_z, numbers)
    x = _between(rows, 0, node, share) * air[0] + _between(rows, 2, node, share) * air[1]
    whole, part = _split_offset((x + np.float32(own_steps(drawn_x)) * air[2] * height) * numbers[4])
    lattice_x = np.uint32(start_x + moved_x)
    fraction_x = np.uint32(lattice_x + part)
    wrap_x = np.uint32(wraps_x + np.uint32(lattice_x < start_x) + np.uint32(fraction_x < part))
    return fraction_x, np.uint32(wrap_x + np.uint32(np.int32(whole)))


@numba.njit(inline="always")
@no_type_check
def _place_y(rows, numbers, air, i, seed, fraction_z, wrap_z, fraction_x, wrap_x, drawn_y, moved_y):
    """Place along y of a drop."""
    node, share, height = _at_height(fraction_z, numbers)
    sine, cosine = _sine_and_cosine(fraction_x, numbers)
    y = _between(rows, 1, node, share) * air[0]
    y = y + (_between(rows, 3, node, share) * sine + _between(rows, 4, node, share) * cosine) * air[1]
    _, part = _split_offset((y + np.float32(own_steps(drawn_y)) * air[2] * height) * numbers[4])
    two = np.uint32(2)
    _, start_y, _, _ = pcg4d_scalar(i, wrap_z, np.uint32(wrap_x * two + two), seed)
    return np.uint32(start_y + moved_y + part)


@numba.njit(inline="always")
@no_type_check
def _air_velocity(rows, numbers, air, fraction_z, fraction_x, steps_x, steps_y):
    """Velocity of a drop along x and y in m/s."""
    slow, gust, own = air
    node, share, _ = _at_height(fraction_z, numbers)
    sine, cosine = _sine_and_cosine(fraction_x, numbers)
    across = -own / slow if slow > 0 else own  # velocity for each step; all are 0 in still air
    along_x = _between(rows, 5, node, share) + _between(rows, 7, node, share) + across * np.float64(steps_x)
    bend = _between(rows, 3, node, share) * cosine - _between(rows, 4, node, share) * sine
    carried = (along_x - numbers[5]) * numbers[2] * gust * bend
    along_y = _between(rows, 6, node, share) + _between(rows, 8, node, share) * cosine
    along_y = along_y + _between(rows, 9, node, share) * sine
    return along_x, along_y + carried + across * np.float64(steps_y)


def search_drops(
    count: int,
    seed: int,
    where: DropPhases,
    culling: DropCulling,
    period_m: Float64[np.ndarray, "3"],
    *,
    everywhere: bool = False,
    smallest_class: int = 0,
) -> Int64[np.ndarray, " m"]:
    """Find the drops with numbers below `count` that may be visible to the camera; with `everywhere` in all the region.

    Returns their numbers, rising.
    """
    turns = -(-count // (CLASSES * _LANES)) * _LANES  # whole SIMD vectors: a remainder would run one by one
    chunks = CLASSES // _CLASSES_BY_CHUNK
    numbers, counts = np.empty((chunks, _CLASSES_BY_CHUNK * turns), np.int64), np.empty(chunks, np.int64)
    geometry = np.concatenate([np.ravel(each) for each in (period_m, *culling[:5])])
    _search_drops(
        np.uint32(seed), np.uint32(count), smallest_class, where.wraps, where.fractions, geometry,
        culling.class_margin_m, culling.class_far_m, everywhere, numbers, counts, *where.air,
    )  # fmt: skip
    return np.sort(np.concatenate([row[:n] for row, n in zip(numbers, counts, strict=True)]))


@kernel(parallel=True)
@no_type_check
def _search_drops(
    portion, seed, count, first_class, wraps, fractions, geometry, margins, far, everywhere, numbers, counts, air_rows,
    air_classes, air_numbers,
):  # fmt: skip
    """Write the numbers that `search_drops` finds, for each chunk of classes, and how many they are to `counts`."""
    turns = numbers.shape[1] // _CLASSES_BY_CHUNK
    for chunk in range_of(portion, CLASSES // _CLASSES_BY_CHUNK):
        drawn, found = np.empty((5, turns), np.uint32), np.empty(turns, np.bool_)
        n = 0
        for c in range(max(chunk * _CLASSES_BY_CHUNK, first_class), (chunk + 1) * _CLASSES_BY_CHUNK):
            first = (c * FIRST_OF_CLASS) % CLASSES
            _mark_class(
                np.uint32(first), count, seed, wraps[c], fractions[c], geometry, margins[c], far[c], everywhere, found,
                drawn, air_rows, air_classes[c], air_numbers,
            )  # fmt: skip
            for k in range(turns):
                if found[k]:
                    numbers[chunk, n] = first + k * CLASSES
                    n += 1
        counts[chunk] = n


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
    zero, one = np.uint32(0), np.uint32(1)
    wraps_x, wraps_z = np.uint32(wraps[0]), np.uint32(wraps[2])
    moved_x, moved_y, moved_z = fractions[0], fractions[1], fractions[2]
    slow, gust, own = air_class[0], air_class[1], air_class[2]
    air = slow, gust, own
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
        fraction_x, wrap_x = _place_x(air_rows, air_numbers, air, fraction_z, start_x, drawn_x, moved_x, wraps_x)
        x = (fraction_x * half - 0.5) * period_x
        found[k] = (x >= low_x) & (x <= high_x)
        if not found[k]:
            continue
        fraction_y = _place_y(
            air_rows, air_numbers, air, i, seed, fraction_z, wrap_z, fraction_x, wrap_x, drawn_y, moved_y
        )
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
    """Place drops by their numbers, each as `_mark_class` does."""
    classes, placed = np.empty(len(numbers), np.int64), np.empty((len(numbers), 3), np.uint32)
    velocities = np.empty((len(numbers), 2))
    _place_drops(numbers, np.uint32(seed), where.wraps, where.fractions, *where.air, classes, placed, velocities)
    return Drops(numbers, classes, placed, velocities)


@kernel(parallel=True)
@no_type_check
def _place_drops(portion, numbers, seed, wraps, moved, rows, by_class, air_numbers, classes, placed, velocities):
    zero, one, chunk_size = np.uint32(0), np.uint32(1), 512
    for chunk in range_of(portion, (len(numbers) + chunk_size - 1) // chunk_size):
        for m in range(chunk * chunk_size, min(len(numbers), (chunk + 1) * chunk_size)):
            c, i = (numbers[m] * CLASS_STRIDE) % CLASSES, np.uint32(numbers[m])
            air = by_class[c, 0], by_class[c, 1], by_class[c, 2]
            _, _, start_z, _ = pcg4d_scalar(i, zero, zero, seed)
            z = np.uint32(start_z + moved[c, 2])
            wrap_z = np.uint32(np.uint32(wraps[c, 2]) + np.uint32(z < start_z))
            start_x, drawn_x, drawn_y, _ = pcg4d_scalar(i, wrap_z, one, seed)
            x, wrap_x = _place_x(rows, air_numbers, air, z, start_x, drawn_x, moved[c, 0], np.uint32(wraps[c, 0]))
            y = _place_y(rows, air_numbers, air, i, seed, z, wrap_z, x, wrap_x, drawn_y, moved[c, 1])
            classes[m], placed[m, 0], placed[m, 1], placed[m, 2] = c, x, y, z
            velocities[m, 0], velocities[m, 1] = _air_velocity(
                rows, air_numbers, air, z, x, own_steps(drawn_x), own_steps(drawn_y)
            )
