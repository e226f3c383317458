"""Gaussians that hang together with the one under the mouse and look like it."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.scene import Scene

from .candidates import candidates
from .colors import alike, base_color
from .world_points import by_member, world_points

NEIGHBOURS = 8
"""The distance to so many neighbours is what spacing means here."""

_ROOM = 1 << 40
"""More than any member has Gaussians: place of the member and own index are one number."""

_EDGE = 1 << 20
"""Cells from the seed to where nobody looks any more: three numbers of 21 bits are one key."""


def flooded(scene: Scene, time_s: float, key: str, index: int, tolerance: float, reach: float) -> dict[str, Mask]:
    """Find what a flood reaches that starts at a Gaussian.

    It runs over Gaussians whose base colour differs from that one's by at most `tolerance` (0..1, each channel), and
    from each cell of a grid to the 26 around it. A cell is `reach` times as wide as the alike are apart where it
    starts: the distance to the eighth nearest of them.
    """
    own = candidates(scene, time_s)
    seed = next(each for each in own if each.key == key)
    similar = alike(scene, time_s, base_color(seed.part, index), tolerance)
    points, owners = world_points(own, similar)
    at = int(np.searchsorted(owners[:, 0] * _ROOM + owners[:, 1], own.index(seed) * _ROOM + index))
    side = reach * _spacing(points, at)
    cells = np.floor((points - points[at]) / side + 0.5)
    flags = np.zeros(len(points), np.bool_)
    near = np.flatnonzero(np.abs(cells).max(axis=1) < _EDGE)
    flags[near] = _connected(cells[near].astype(np.int64), int(np.searchsorted(near, at)))
    return by_member(own, owners[flags])


def _spacing(points: Float64[np.ndarray, "m 3"], at: int) -> float:
    """Distance in metres from one point to its eighth nearest; never 0."""
    squares = ((points - points[at]) ** 2).sum(axis=1)
    nearest = min(NEIGHBOURS, len(points) - 1)
    return max(float(np.sqrt(np.partition(squares, nearest)[nearest])), 1e-6)


@numba.njit(cache=True)
@no_type_check
def _connected(cells: Int64[np.ndarray, "m 3"], seed: int) -> Bool[np.ndarray, " m"]:
    """Flag the points whose cells are reached from the seed's, from cell to neighbouring cell.

    Cells lie in a hash table with open addressing, at most half full.
    """
    size = 16
    while size < 2 * len(cells):
        size *= 2
    keys, slots = np.full(size, -1, np.int64), np.empty(len(cells), np.int64)
    for i in range(len(cells)):
        key = _key(cells[i, 0], cells[i, 1], cells[i, 2])
        slot = _slot(keys, key)
        keys[slot] = key
        slots[i] = slot
    reached, waiting, count = np.zeros(size, np.bool_), np.empty(size, np.int64), 1
    reached[slots[seed]] = True
    waiting[0] = slots[seed]
    while count:
        count -= 1
        key = keys[waiting[count]]
        x, y, z = (key >> 42) - _EDGE, ((key >> 21) & 0x1FFFFF) - _EDGE, (key & 0x1FFFFF) - _EDGE
        for step in range(27):
            slot = _slot(keys, _key(x + step // 9 - 1, y + step // 3 % 3 - 1, z + step % 3 - 1))
            if keys[slot] >= 0 and not reached[slot]:
                reached[slot] = True
                waiting[count] = slot
                count += 1
    return reached[slots]


@numba.njit(cache=True)
@no_type_check
def _key(x, y, z):
    return ((x + _EDGE) << 42) | ((y + _EDGE) << 21) | (z + _EDGE)


@numba.njit(cache=True)
@no_type_check
def _slot(keys, key):
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    slot = np.int64((mixed ^ (mixed >> np.uint64(32))) & np.uint64(len(keys) - 1))
    while keys[slot] >= 0 and keys[slot] != key:
        slot = (slot + 1) & (len(keys) - 1)
    return slot
