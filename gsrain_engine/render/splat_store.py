"""Where projected splats lie on the GPU: records in blocks, their keys, and how many of them can be seen."""

import moderngl

from .shaders import Switches

SLOTS_BY_BLOCK = 256
"""Slots that one workgroup of a projection fills, from the front; each dispatch starts with a new such block."""

SPLAT_BYTES = 32
_MOST_RECORD_BLOCKS = 4
_RECORDS, _SPARSE_KEYS, _COUNTS, _WORK = 8, 4, 5, 7
_WORK_BYTES = 4 * 9
COUNT_OFFSET, SORT_GROUPS_OFFSET = 20, 24
"""Where the number of visible splats and the sort's workgroups stand in `work`, in bytes; the draw's command is first."""


class SplatStore:
    """Buffers for a number of slots; `switches` tell the shaders how they are split."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._limit = int(context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
        self.slots = 0
        self.work = context.buffer(reserve=_WORK_BYTES)
        """The draw's command (5 numbers), the number of visible splats, the sort's workgroups (3)."""
        self._block_shift = (self._limit // SPLAT_BYTES).bit_length() - 1
        self._records: list[moderngl.Buffer] = []
        self._sparse_keys: moderngl.Buffer | None = None
        self._counts: moderngl.Buffer | None = None

    @property
    def switches(self) -> Switches:
        """How the shaders are to be compiled."""
        return {"SPLAT_BLOCKS": max(1, len(self._records)), "BLOCK_SHIFT": self._block_shift}

    def reserve(self, slots: int) -> None:
        """Make room for so many slots, a multiple of 256.

        Raises `MemoryError` when the driver's storage blocks can't hold them.
        """
        if slots <= self.slots:
            return
        by_block = 1 << self._block_shift
        if slots > _MOST_RECORD_BLOCKS * by_block:
            raise MemoryError(
                f"{slots} Gaussians need {SPLAT_BYTES * slots >> 20} MiB of storage blocks; "
                f"this OpenGL driver allows {_MOST_RECORD_BLOCKS} of {self._limit >> 20} MiB"
            )
        self._release()
        wanted = min(slots + slots // 8 // SLOTS_BY_BLOCK * SLOTS_BY_BLOCK, _MOST_RECORD_BLOCKS * by_block)
        for first in range(0, wanted, by_block):
            self._records.append(self._context.buffer(reserve=SPLAT_BYTES * min(by_block, wanted - first)))
        self._sparse_keys = self._context.buffer(reserve=4 * wanted)
        self._counts = self._context.buffer(reserve=4 * (wanted // SLOTS_BY_BLOCK))
        self.slots = wanted

    def bind(self) -> None:
        """Bind everything at its place."""
        assert self._sparse_keys is not None, "reserve slots before binding"
        assert self._counts is not None
        for number, records in enumerate(self._records):
            records.bind_to_storage_buffer(_RECORDS + number)
        self._sparse_keys.bind_to_storage_buffer(_SPARSE_KEYS)
        self._counts.bind_to_storage_buffer(_COUNTS)
        self.work.bind_to_storage_buffer(_WORK)

    def _release(self) -> None:
        for buffer in (*self._records, self._sparse_keys, self._counts):
            if buffer is not None:
                buffer.release()
        self._records.clear()
