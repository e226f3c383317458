"""Where projected splats lie on the GPU: records in blocks, their keys, and how many of them can be seen."""

import moderngl

from .growing_buffer import GrowingBuffer
from .shaders import Switches
from .visible_scan import WORK_BYTES

NEAR_M = 0.2
"""Gaussians whose centre is nearer than this are left out, as in the reference rasterizer."""

SLOTS_BY_BLOCK = 256
"""Slots that one workgroup of a projection fills, from the front; each dispatch starts with a new such block."""

_SPLAT_BYTES = 32
_MOST_RECORD_BLOCKS = 4
_RECORDS, _SPARSE_KEYS, _COUNTS, _WORK = 8, 4, 5, 7


class SplatStore:
    """Buffers for a number of slots; `switches` tell the shaders how they are split."""

    def __init__(self, context: moderngl.Context) -> None:
        self._limit = int(context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
        self._block_shift = (self._limit // _SPLAT_BYTES).bit_length() - 1
        self._records = [GrowingBuffer(context) for _ in range(_MOST_RECORD_BLOCKS)]
        self._record_blocks = 1
        self._sparse_keys = GrowingBuffer(context)
        self.counts = GrowingBuffer(context)
        """Visible splats of each block; after the scan, where they begin."""
        self.work = context.buffer(reserve=WORK_BYTES)
        """See `visible_scan`."""

    @property
    def switches(self) -> Switches:
        """How the shaders are to be compiled."""
        return {"SPLAT_BLOCKS": self._record_blocks, "BLOCK_SHIFT": self._block_shift}

    def reserve(self, slots: int) -> None:
        """Make room for so many slots, a multiple of 256.

        Raises `MemoryError` when the driver's storage blocks can't hold them.
        """
        by_block = 1 << self._block_shift
        if slots > _MOST_RECORD_BLOCKS * by_block:
            raise MemoryError(
                f"{slots} Gaussians need {_SPLAT_BYTES * slots >> 20} MiB of storage blocks; "
                f"this OpenGL driver allows {_MOST_RECORD_BLOCKS} of {self._limit >> 20} MiB"
            )
        self._record_blocks = max(1, -(-slots // by_block))
        for number in range(self._record_blocks):
            self._records[number].reserve(_SPLAT_BYTES * min(by_block, slots - number * by_block), at_most=self._limit)
        self._sparse_keys.reserve(4 * slots)
        self.counts.reserve(4 * (slots // SLOTS_BY_BLOCK))

    def bind(self) -> None:
        for number in range(self._record_blocks):
            self._records[number].bind(_RECORDS + number)
        self._sparse_keys.bind(_SPARSE_KEYS)
        self.counts.bind(_COUNTS)
        self.work.bind_to_storage_buffer(_WORK)
