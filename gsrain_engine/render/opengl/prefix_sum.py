"""Prefix sum over blocks of 256 counts, and the arguments of the indirect draw and dispatch."""

import moderngl
import numpy as np

from .shaders import load_compute_shader

WORK_BYTES = 4 * 9
"""The draw's command (5 numbers), the number of elements, an indirect dispatch (3)."""

COUNT_OFFSET, GROUPS_OFFSET = 20, 24
"""Byte offsets of the number of elements and of the dispatch; the draw's command is first."""

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
        by_group: int,
        most: int = 0xFFFFFFFF,
        found: tuple[moderngl.Buffer, int, int] | None = None,
    ) -> None:
        """Scan the counts of blocks in place and fill in `work`.

        Each workgroup of the dispatch processes `by_group` elements, of at most `most`. `found` consists of the work
        buffer of found drops, the first of their blocks, and the number of blocks per group of drops: all other blocks
        are empty.
        """
        found_work, fixed, copies = found or (self._nothing_found, blocks, 0)
        for name, value in {
            "blocks": blocks, "fixed_blocks": fixed, "found_copies": copies, "by_group": by_group, "most": most,
        }.items():  # fmt: skip
            self._shader[name] = value
        for binding, buffer in ((_COUNTS, counts), (_FOUND_WORK, found_work), (_WORK, work)):
            buffer.bind_to_storage_buffer(binding)
        self._shader.run()
        self._context.memory_barrier()
