"""Sorts the visible splats by depth on the GPU: a radix sort by reduce, scan and scatter."""

import moderngl

from .growing_buffer import GrowingBuffer
from .shaders import load_compute_shader
from .visible_scan import GROUPS_OFFSET

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
        self._pairs = [(GrowingBuffer(context), GrowingBuffer(context)) for _ in range(2)]
        self._counts = GrowingBuffer(context)

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
