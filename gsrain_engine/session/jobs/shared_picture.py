"""A worker's newest picture, in memory that two processes share: the window looks when it likes, nobody waits."""

from multiprocessing.shared_memory import SharedMemory

import cv2
import numpy as np
from jaxtyping import Int64, UInt8

_MOST_PIXELS = 1024 * 768
_SLOT_BYTES = 3 * _MOST_PIXELS
_NUMBERS = 7
"""Number of the newest picture; then for each of two slots the number of its picture, its height and its width."""


class SharedPicture:
    """Two slots that a writer fills in turn; a reader takes the one that was filled last.

    The process that makes it frees it; another one attaches by `name`.
    """

    def __init__(self, name: str | None = None) -> None:
        size = 8 * _NUMBERS + 2 * _SLOT_BYTES
        self._memory = SharedMemory(name, create=name is None, size=size if name is None else 0)
        self._is_own, self._is_closed = name is None, False
        self._taken = 0

    @property
    def name(self) -> str:
        return self._memory.name

    def write(self, pixels: UInt8[np.ndarray, "h w 3"]) -> None:
        """Show a picture; one that is too large is shown smaller."""
        shrink = np.sqrt(pixels.shape[0] * pixels.shape[1] / _MOST_PIXELS)
        if shrink > 1:
            size = max(1, int(pixels.shape[1] / shrink)), max(1, int(pixels.shape[0] / shrink))
            pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
        numbers = self._numbers()
        number = int(numbers[0]) + 1
        slot = number % 2
        numbers[1 + 3 * slot] = 0  # whoever reads this slot now sees that it has changed
        self._pixels(slot, pixels.shape[0], pixels.shape[1])[:] = pixels
        numbers[1 + 3 * slot : 4 + 3 * slot] = number, pixels.shape[0], pixels.shape[1]
        numbers[0] = number

    def take(self) -> UInt8[np.ndarray, "h w 3"] | None:
        """Copy the newest picture; None where there is none that was not taken yet."""
        if self._is_closed:
            return None
        numbers = self._numbers()
        number = int(numbers[0])
        slot = number % 2
        found, height, width = numbers[1 + 3 * slot : 4 + 3 * slot].tolist()
        if number == self._taken:
            return None
        if found != number or not 0 < height * width <= _MOST_PIXELS:
            return None  # it is being written over: the next look finds a newer one
        pixels = self._pixels(slot, height, width).copy()
        if int(numbers[1 + 3 * slot]) != number:
            return None
        self._taken = number
        return pixels

    def close(self) -> None:
        """Let go of the memory; who has made it frees it. To be called once more does nothing."""
        if not self._is_closed:
            self._is_closed = True
            self._memory.close()
            if self._is_own:
                self._memory.unlink()

    @property
    def _bytes(self) -> memoryview:
        assert self._memory.buf is not None, "closed"
        return self._memory.buf

    def _numbers(self) -> Int64[np.ndarray, " numbers"]:
        # Made anew each time: memory that an array looks at can't be closed.
        return np.frombuffer(self._bytes, np.int64, _NUMBERS)

    def _pixels(self, slot: int, height: int, width: int) -> UInt8[np.ndarray, "h w 3"]:
        first = 8 * _NUMBERS + slot * _SLOT_BYTES
        flat = np.frombuffer(self._bytes, np.uint8, 3 * height * width, first)
        return flat.reshape(height, width, 3)
