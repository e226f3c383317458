"""Memory that a frame gives back stays with the process: the next frame wants as much."""

import ctypes
import sys
import time
from concurrent.futures import Executor
from typing import Any

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h

_LARGEST = 32 << 20
"""Bytes; the most that glibc takes. What is larger still comes from the system and goes back to it."""

_RETAINED_BYTES = 256 << 20
"""Bytes."""


def tune_malloc() -> None:
    """Tell malloc to keep what is freed, up to 256 MiB, on Linux with glibc; elsewhere nothing changes.

    A frame needs some 30 MB for a while. By default glibc now and then returns them and fetches them again from the
    system in the next frame: thousands of page faults, which can cost a third of the frame.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST)
        mallopt(_TRIM_THRESHOLD, _RETAINED_BYTES)


# § Memory that is free goes back to the system once work has ended.

_REST_S = 1.0
"""What work leaves behind is let go of in the frames after it."""

_ARENA_MAX = -8  # of glibc's malloc.h


def use_one_arena() -> None:
    """Allocate for all threads in one place, which `trim_memory` can empty; to be called before threads start.

    glibc gives each thread an arena of its own, and never returns the free end of any but the first: a window that
    runs jobs in threads grew from 560 to 770 MB in ten of them, with 140 MB in use.
    """
    mallopt = _of_glibc("mallopt")
    if mallopt is not None:
        mallopt(_ARENA_MAX, 1)


def trim_memory() -> None:
    """Give memory that was freed back to the system; does nothing where the C library is not glibc.

    glibc keeps what lies below something that is still in use: hundreds of megabytes after some large scenes and jobs.
    malloc_trim(3) returns all whole pages, in some 20 ms.
    """
    trim = _of_glibc("malloc_trim")
    if trim is not None:
        trim(0)


def _of_glibc(function: str) -> Any:
    return getattr(ctypes.CDLL(None), function, None) if sys.platform == "linux" else None


class MemoryTrimmer:
    """Returns freed memory when work has ended and a second has passed, in a thread."""

    def __init__(self, thread: Executor) -> None:
        self._thread = thread
        self._due_s: float | None = None

    def note_work(self) -> None:
        """Take note that something large was, or is, being worked on."""
        self._due_s = time.monotonic() + _REST_S

    def poll(self) -> None:
        """Return memory when it is time. Once a frame."""
        if self._due_s is not None and time.monotonic() > self._due_s:
            self._due_s = None
            self._thread.submit(trim_memory)
