"""Sorts the visible splats by depth on the processor, where a software rasterizer would do it there anyway, slower."""

import moderngl
import numpy as np
from jaxtyping import UInt32

from .growing_buffer import GrowingBuffer
from .visible_scan import COUNT_OFFSET


class HostSort:
    """The same order as `DepthSort`, bit for bit."""

    def __init__(self, context: moderngl.Context) -> None:
        self._keys, self._slots = GrowingBuffer(context), GrowingBuffer(context)

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
