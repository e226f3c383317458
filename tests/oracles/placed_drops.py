"""Readable reference of the compiled drop field, in NumPy."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from gsrain_engine.rain.air import CALM, DropAir
from gsrain_engine.rain.drop_field import CLASS_STRIDE, DropPhases
from gsrain_engine.rain.pcg_hash import pcg4d
from gsrain_engine.rain.properties import CLASSES

_FRACTION, _HALF_PERIOD, _ONE = np.float32(2.0**-24), np.float32(0.5), np.float32(1)
_BELOW_ONE, _STEPS_OF_FRACTION = np.float32(1 - 2.0**-24), np.float32(2.0**24)
_SINE = np.float32(-1 / 6), np.float32(1 / 120), np.float32(-1 / 5040)
_COSINE = np.float32(-1 / 2), np.float32(1 / 24), np.float32(-1 / 720), np.float32(1 / 40320)


class ReferenceDrops(NamedTuple):
    """Drops of the field, in the order of their numbers."""

    class_index: np.ndarray
    fractions: np.ndarray
    own_steps: np.ndarray
    """Velocity of its own along x and y, in `OWN_STEPS` to a standard deviation."""
    air_velocity_m_s: np.ndarray


def reference_drops(numbers: np.ndarray, seed: int, where: DropPhases) -> ReferenceDrops:
    """Place drops by their numbers."""
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
    return ReferenceDrops(classes, np.stack([x, y, z], axis=1), steps, _velocities(where.air, classes, x, z, steps))


def _own_steps_of(drawn: np.ndarray) -> np.ndarray:
    """Sum of the four bytes less its mean: nearly a normal distribution with a standard deviation of `OWN_STEPS`."""
    return np.ascontiguousarray(drawn).view(np.uint8).reshape(-1, 4).sum(axis=1, dtype=np.int32) - np.int32(510)


def _split_offset(periods: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whole periods, and the rest in 2^-32 of a period."""
    whole = np.floor(periods)
    part = (np.minimum(periods - whole, _BELOW_ONE) * _STEPS_OF_FRACTION).astype(np.uint32) << np.uint32(8)
    return whole.astype(np.int32).view(np.uint32), part


def offsets_x(air: DropAir, classes: np.ndarray, z: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Offset along x in periods of drops at heights z in the cell, by mean wind, gusts and their own velocity."""
    slow, gust, own = air.by_class[classes].T
    row, height = _air_at(air, z)
    return (row(0) * slow + row(2) * gust + steps.astype(np.float32) * own * height) * air.numbers[4]


def offsets_y(
    air: DropAir,
    classes: np.ndarray,
    z: np.ndarray,
    steps: np.ndarray,
    x: np.ndarray,
) -> np.ndarray:
    """The same along y, which depends on the drop's x, too."""
    slow, gust, own = air.by_class[classes].T
    row, height = _air_at(air, z)
    sine, cosine = _sine_and_cosine(air, x)
    gusts = (row(3) * sine + row(4) * cosine) * gust
    return (row(1) * slow + gusts + steps.astype(np.float32) * own * height) * air.numbers[4]


def _air_at(air: DropAir, z: np.ndarray) -> tuple[Callable[[int], np.ndarray], np.ndarray]:
    """Rows of the air at heights in the cell, and the heights above the ground in m."""
    node, share = z >> np.uint32(24), (z & np.uint32(0xFFFFFF)).astype(np.float32) * _FRACTION
    height = air.numbers[0] + (z >> np.uint32(8)).astype(np.float32) * _FRACTION * air.numbers[1]
    return lambda row: air.rows[row][node] + share * (air.rows[row][node + 1] - air.rows[row][node]), height


def _sine_and_cosine(air: DropAir, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the gusts' wavenumber times x from the middle of the cell, to 6e-5 for angles up to 1.4."""
    turn = ((x >> np.uint32(8)).astype(np.float32) * _FRACTION - _HALF_PERIOD) * air.numbers[3] * air.numbers[2]
    square = turn * turn
    sine = turn * (_ONE + square * (_SINE[0] + square * (_SINE[1] + square * _SINE[2])))
    cosine = _ONE + square * (_COSINE[0] + square * (_COSINE[1] + square * (_COSINE[2] + square * _COSINE[3])))
    return sine, cosine


def _velocities(air: DropAir, classes: np.ndarray, x: np.ndarray, z: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Velocities of drops along x and y in m/s: mean wind, gusts and their own; derivatives of their positions."""
    if air is CALM:
        return np.zeros((len(classes), 2))
    slow, gust, own = air.by_class[classes].T
    row, _ = _air_at(air, z)
    sine, cosine = _sine_and_cosine(air, x)
    across = -own / slow  # velocity for each step
    along_x = row(5) + row(7) + across * steps[:, 0]
    carried = (along_x - air.numbers[5]) * air.numbers[2] * gust * (row(3) * cosine - row(4) * sine)
    along_y = row(6) + row(8) * cosine + row(9) * sine + carried + across * steps[:, 1]
    return np.stack([along_x, along_y], axis=1)
