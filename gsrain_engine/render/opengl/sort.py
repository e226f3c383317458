"""Sorts the visible splats by depth on the GPU: a radix sort by reduce, scan and scatter."""

from typing import NamedTuple

import moderngl
import numpy as np
from jaxtyping import UInt32

from .buffers import NEAR_M, GrowableBuffer
from .prefix_sum import COUNT_OFFSET, GROUPS_OFFSET, WORK_BYTES
from .shaders import load_compute_shader

KEY_BITS = 28

DIGIT_BITS = 4

KEYS_BY_GROUP = 4096
"""Keys that a workgroup takes; as in common_radix.glsl."""

KEYS, SLOTS, SORTED_KEYS, SORTED_SLOTS, COUNTS, WORK = 0, 1, 2, 3, 4, 7
"""Storage bindings of the shaders."""


class DepthSort:
    """A stable sort of (key, slot) pairs whose number only the GPU knows (Merrill and Grimshaw's reduce-then-scan).

    No subgroups and no look-back: it runs on every driver with OpenGL 4.3, software rasterizers included.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._count = load_compute_shader(context, "radix_count.comp")
        self._scan = load_compute_shader(context, "radix_scan.comp")
        self._scatter = load_compute_shader(context, "radix_scatter.comp")
        self._pairs = [(GrowableBuffer(context), GrowableBuffer(context)) for _ in range(2)]
        self._counts = GrowableBuffer(context)

    def reserve(self, capacity: int) -> None:
        """Make room for so many pairs."""
        for keys, slots in self._pairs:
            keys.reserve(4 * capacity)
            slots.reserve(4 * capacity)
        self._counts.reserve(4 * -(-capacity // KEYS_BY_GROUP) << DIGIT_BITS)

    @property
    def unsorted(self) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        """Where keys and slots are to be written to."""
        keys, slots = self._pairs[0]
        return keys.buffer, slots.buffer

    def sort(self, work: moderngl.Buffer) -> moderngl.Buffer:
        """Sort by rising key; `work` is a store's: it holds the number of keys. Returns the sorted slots."""
        here, there = self._pairs
        work.bind_to_storage_buffer(WORK)
        self._counts.bind(COUNTS)
        for shift in range(0, KEY_BITS, DIGIT_BITS):
            for binding, buffer in zip((KEYS, SLOTS, SORTED_KEYS, SORTED_SLOTS), (*here, *there), strict=True):
                buffer.bind(binding)
            self._count["shift"] = shift
            self._scatter["shift"] = shift
            self._count.run_indirect(work, GROUPS_OFFSET)
            self._context.memory_barrier()
            self._scan.run()
            self._context.memory_barrier()
            self._scatter.run_indirect(work, GROUPS_OFFSET)
            self._context.memory_barrier()
            here, there = there, here
        return here[1].buffer


class SortCheck(NamedTuple):
    """The faults of an order of so many splats that a GPU made; all 0 where it is right."""

    splats: int
    missing: int
    """Slots that the order does not hold: others are in it twice, or what is no slot."""
    inversions: int
    """Neighbors in it of which the second belongs before the first, by key or, of equal keys, by slot."""
    changed: int
    """Places that hold another slot when the same keys are sorted a second time."""

    @property
    def is_right(self) -> bool:
        """True where it has no fault."""
        return not (self.missing or self.inversions or self.changed)

    def __str__(self) -> str:
        return (
            f"of {self.splats:,} splats {self.missing:,} are lost, {self.inversions:,} out of order, "
            f"and {self.changed:,} elsewhere in a second try"
        )


def check_sort(context: moderngl.Context, count: int) -> SortCheck:
    """Sort so many depths twice on the context, which is current, and compare what comes back with the keys.

    A barrier that a shader or a driver lacks shows as a fault on a GPU, not on a software rasterizer. Raises
    `MemoryError` where the graphics card has no room for 18 bytes a key.
    """
    rng = np.random.default_rng(count)
    depths_m = (NEAR_M + rng.lognormal(2.0, 1.0, count)).astype(np.float32)
    depths_m[::2] = np.ceil(depths_m[::2])  # so that many are equal
    keys, slots = depths_m.view(np.uint32) - np.float32(NEAR_M).view(np.uint32), np.arange(count, dtype=np.uint32)
    numbers = np.zeros(WORK_BYTES // 4, np.uint32)
    numbers[COUNT_OFFSET // 4], numbers[GROUPS_OFFSET // 4 :] = count, (-(-count // KEYS_BY_GROUP), 1, 1)
    work, sorter = context.buffer(numbers), DepthSort(context)
    sorter.reserve(count)
    orders: list[UInt32[np.ndarray, " n"]] = []
    for _ in range(2):
        for buffer, values in zip(sorter.unsorted, (keys, slots), strict=True):
            buffer.write(values)
        orders.append(np.frombuffer(sorter.sort(work).read(4 * count), np.uint32))
    return sort_faults(keys, *orders)


def sort_faults(
    keys: UInt32[np.ndarray, " n"], order: UInt32[np.ndarray, " n"], second: UInt32[np.ndarray, " n"]
) -> SortCheck:
    """Count the faults of an order of slots 0 to n - 1, whose keys are given; a second order should be the same."""
    held = order[order < len(keys)].astype(np.int64)
    ranks = keys[held].astype(np.int64) * len(keys) + held  # by key, then by slot
    return SortCheck(
        splats=len(keys),
        missing=len(keys) - len(np.unique(held)),
        inversions=int(np.count_nonzero(ranks[1:] < ranks[:-1])),
        changed=int(np.count_nonzero(order != second)),
    )


# § Sorts the visible splats by depth on the processor, where a software rasterizer would do it there anyway, slower.


class CpuSort:
    """The same order as `DepthSort`, bit for bit."""

    def __init__(self, context: moderngl.Context) -> None:
        self._keys, self._slots = GrowableBuffer(context), GrowableBuffer(context)

    def reserve(self, capacity: int) -> None:
        """Make room for so many pairs."""
        self._keys.reserve(4 * capacity)
        self._slots.reserve(4 * capacity)

    @property
    def unsorted(self) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        """Where keys and slots are to be written to."""
        return self._keys.buffer, self._slots.buffer

    def sort(self, work: moderngl.Buffer) -> moderngl.Buffer:
        """Sort by rising key; `work` is a store's: it holds the number of keys. Returns the sorted slots."""
        keys, slots = self.unsorted
        count = int(np.frombuffer(work.read(4, offset=COUNT_OFFSET), np.uint32)[0])
        if count:
            found = [np.frombuffer(each.read(4 * count), np.uint32) for each in (keys, slots)]
            slots.write(nearest_first(*found))
        return slots


def nearest_first(keys: UInt32[np.ndarray, " n"], slots: UInt32[np.ndarray, " n"]) -> UInt32[np.ndarray, " n"]:
    """Slots by rising key; of equal keys the lower slot comes first."""
    # One 64-bit number a splat, key above slot: no two are equal, so any fast sort is a stable one.
    pairs = (keys.astype(np.uint64) << np.uint64(32)) | slots
    pairs.sort()
    return (pairs & np.uint64(0xFFFFFFFF)).astype(np.uint32)
