"""Depth sort of visible splats, a radix sort on the GPU or a CPU sort for software rasterizers; and the prefix sum."""

from typing import NamedTuple

import moderngl
import numpy as np
from jaxtyping import UInt32

from ..cpu.splats import NEAR_M
from .buffers import COUNT_OFFSET, TOTAL_OFFSET, WORK_BYTES, GrowableBuffer
from .context import is_software
from .shaders import load_compute_shader

KEY_BITS = 28
DIGIT_BITS = 7  # as in common_radix.glsl and radix_scan.comp
KEYS_BY_GROUP = 2048  # keys per workgroup; as in common_radix.glsl
KEYS, SLOTS, SORTED_KEYS, SORTED_SLOTS, COUNTS, WORK = 0, 1, 2, 3, 4, 7  # storage bindings of the shaders
_TOTALS = 5


class RadixSort:
    """Stable GPU sort of (key, slot) pairs whose number only the GPU has (Merrill and Grimshaw's reduce-then-scan).

    It needs no look-back, so it runs on every driver with OpenGL 4.3, including software rasterizers; subgroups of 32
    threads make it faster.

    Args:
        context: OpenGL 4.3 or later.
        max_bytes: Limit of a buffer, for the driver's storage blocks.
    """

    def __init__(self, context: moderngl.Context, max_bytes: int | None = None) -> None:
        self._context = context
        variant = "_subgroups" if has_subgroups_of_32(context) else ""
        self._count, self._scatter = (
            load_compute_shader(context, f"radix_{name}{variant}.comp") for name in ("count", "scatter")
        )
        self._scan = load_compute_shader(context, "radix_scan.comp")
        self._max_bytes = max_bytes
        self._pairs = [(GrowableBuffer(context), GrowableBuffer(context)) for _ in range(2)]
        self._counts = GrowableBuffer(context)
        self._totals = context.buffer(np.zeros(2 << DIGIT_BITS, np.uint32))
        self._groups = 0
        self._turn = 0

    def reserve(self, capacity: int) -> None:
        """Make room for `capacity` pairs; raises `MemoryError` if the graphics card is full."""
        for pair in self._pairs:
            for buffer in pair:
                buffer.reserve(4 * capacity, at_most=self._max_bytes)
        self._groups = -(-capacity // KEYS_BY_GROUP)
        self._counts.reserve(4 * self._groups << DIGIT_BITS)

    @property
    def unsorted(self) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        """Input buffers of keys and slots."""
        keys, slots = self._pairs[0]
        return keys.buffer, slots.buffer

    def sort(self, work: moderngl.Buffer) -> moderngl.Buffer:
        """Sort by rising key; `work` contains the number of keys. Returns the sorted slots."""
        return self.sort_pairs(work, KEY_BITS)[1]

    def sort_pairs(self, work: moderngl.Buffer, key_bits: int) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        """Sort by the lowest bits of each key; returns the sorted keys and slots."""
        here, there = self._pairs
        work.bind_to_storage_buffer(WORK)
        self._counts.bind(COUNTS)
        self._totals.bind_to_storage_buffer(_TOTALS)
        for shift in range(0, key_bits, DIGIT_BITS):
            for binding, buffer in zip((KEYS, SLOTS, SORTED_KEYS, SORTED_SLOTS), (*here, *there), strict=True):
                buffer.bind(binding)
            self._count.set(shift=shift, turn=self._turn)
            self._scan.set(turn=self._turn)
            self._scatter.set(shift=shift)
            self._count.run_all(self._groups)
            self._context.memory_barrier()
            self._scan.run(1 << DIGIT_BITS)
            self._context.memory_barrier()
            self._scatter.run_all(self._groups)
            self._context.memory_barrier()
            here, there = there, here
            self._turn = 1 - self._turn
        return here[0].buffer, here[1].buffer


_SUBGROUPS_OF_32 = """#version 430
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_KHR_shader_subgroup_arithmetic : require
layout(local_size_x = 256) in;
layout(std430, binding = 0) buffer Result { uint result[]; };
void main() {
    uint thread = gl_LocalInvocationIndex, whole = subgroupBallot(true).x;
    bool fits = gl_SubgroupSize == 32u && gl_SubgroupID == thread / 32u && gl_SubgroupInvocationID == thread % 32u;
    bool works = subgroupShuffle(thread, 5u) % 32u == 5u && subgroupInclusiveAdd(1u) == thread % 32u + 1u;
    if (fits && works && whole == 0xFFFFFFFFu) atomicAdd(result[0], 1u);
}
"""


def has_subgroups_of_32(context: moderngl.Context) -> bool:
    """Return whether a workgroup's threads run in subgroups of 32, in their order, which can exchange numbers."""
    if is_software(context) or "GL_KHR_shader_subgroup" not in context.extensions:
        return False
    try:
        probe = context.compute_shader(_SUBGROUPS_OF_32)
    except moderngl.Error:
        return False
    counted = context.buffer(np.zeros(1, np.uint32))
    counted.bind_to_storage_buffer(0)
    probe.run()
    context.memory_barrier()
    return int(np.frombuffer(counted.read(), np.uint32)[0]) == 256


class SortCheck(NamedTuple):
    """Faults in a GPU's order of splats; all 0 if it is correct."""

    splats: int
    missing: int
    """Slots missing from the order: others are duplicated or invalid."""
    inversions: int
    """Neighbors of which the second belongs before the first, by key or, for equal keys, by slot."""
    changed: int
    """Positions with a different slot when the same keys are sorted a second time."""

    @property
    def is_right(self) -> bool:
        return not (self.missing or self.inversions or self.changed)

    def __str__(self) -> str:
        return (
            f"of {self.splats:,} splats {self.missing:,} are lost, {self.inversions:,} out of order, "
            f"and {self.changed:,} elsewhere in a second try"
        )


def check_sort(context: moderngl.Context, count: int) -> SortCheck:
    """Sort `count` depths twice on the current context and compare the result with the keys.

    A barrier missing in a shader or driver appears as a fault on a GPU, not on a software rasterizer. Raises
    `MemoryError` if the graphics card has no room for 18 bytes per key.
    """
    rng = np.random.default_rng(count)
    depths_m = (NEAR_M + rng.lognormal(2.0, 1.0, count)).astype(np.float32)
    depths_m[::2] = np.ceil(depths_m[::2])  # makes many keys equal
    keys, slots = depths_m.view(np.uint32) - np.float32(NEAR_M).view(np.uint32), np.arange(count, dtype=np.uint32)
    numbers = np.zeros(WORK_BYTES // 4, np.uint32)
    numbers[COUNT_OFFSET // 4] = count
    work, sorter = context.buffer(numbers), RadixSort(context)
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
    """Count the faults of an order of slots 0 to n - 1 with these keys; a second order should be identical."""
    held = order[order < len(keys)].astype(np.int64)
    ranks = keys[held].astype(np.int64) * len(keys) + held  # by key, then by slot
    return SortCheck(
        splats=len(keys),
        missing=len(keys) - len(np.unique(held)),
        inversions=int(np.count_nonzero(ranks[1:] < ranks[:-1])),
        changed=int(np.count_nonzero(order != second)),
    )


class CpuSort:
    """Sorts on the CPU in the same order as `RadixSort`, bit for bit; faster for software rasterizers."""

    def __init__(self, context: moderngl.Context) -> None:
        self._pair = GrowableBuffer(context), GrowableBuffer(context)

    def reserve(self, capacity: int) -> None:
        for buffer in self._pair:
            buffer.reserve(4 * capacity)

    @property
    def unsorted(self) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        return self._pair[0].buffer, self._pair[1].buffer

    def sort(self, work: moderngl.Buffer) -> moderngl.Buffer:
        keys, slots = self.unsorted
        count = count_in(work)
        if count:
            slots.write(nearest_first(*(np.frombuffer(each.read(4 * count), np.uint32) for each in (keys, slots))))
        return slots


def nearest_first(keys: UInt32[np.ndarray, " n"], slots: UInt32[np.ndarray, " n"]) -> UInt32[np.ndarray, " n"]:
    """Slots by rising key; for equal keys the lower slot comes first."""
    # One 64-bit number per splat, key above slot: all are distinct, so any fast sort is stable.
    pairs = (keys.astype(np.uint64) << np.uint64(32)) | slots
    pairs.sort()
    return (pairs & np.uint64(0xFFFFFFFF)).astype(np.uint32)


def count_in(work: moderngl.Buffer) -> int:
    """Read the number of elements; waits for the GPU."""
    return int(np.frombuffer(work.read(4, offset=COUNT_OFFSET), np.uint32)[0])


def total_in(work: moderngl.Buffer) -> int:
    """Read the number of elements including those beyond the limit; waits for the GPU."""
    return int(np.frombuffer(work.read(4, offset=TOTAL_OFFSET), np.uint32)[0])


# Prefix sum
# Over blocks of 256 counts; it also writes the arguments of the indirect draw.

_COUNTS, _FOUND_WORK, _WORK = 5, 6, 7


class PrefixSum:
    """Runs visible_scan.comp."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._shader = load_compute_shader(context, "visible_scan.comp")
        self._nothing_found = context.buffer(np.zeros(WORK_BYTES // 4, np.uint32))

    def run(
        self,
        counts: moderngl.Buffer,
        work: moderngl.Buffer,
        blocks: int,
        *,
        max_elements: int = 0xFFFFFFFF,
        found: tuple[moderngl.Buffer, int, int] | None = None,
    ) -> None:
        """Scan the counts of blocks in place and fill in `work`.

        Elements beyond `max_elements` are only counted. `found` consists of the work buffer of other elements, such as
        found drops, the first of their blocks, and the number of blocks for each 256 of them: all other blocks are
        empty.
        """
        found_work, fixed, copies = found or (self._nothing_found, blocks, 0)
        self._shader.set(blocks=blocks, fixed_blocks=fixed, found_copies=copies, max_elements=max_elements)
        for binding, buffer in ((_COUNTS, counts), (_FOUND_WORK, found_work), (_WORK, work)):
            buffer.bind_to_storage_buffer(binding)
        self._shader.run()
        self._context.memory_barrier()
