"""Settings of glibc's malloc: keep the memory of a frame for the next one, return it when work has ended."""

import ctypes
import sys
import time
from collections.abc import Callable

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8  # from glibc's malloc.h
_LARGEST = 32 << 20  # Bytes; glibc's maximum. Larger blocks are always mapped from the system and returned to it.
_RETAINED_BYTES = 256 << 20
_REST_S = 1.0  # seconds to wait after work: frames after it release what it left


def tune_malloc() -> None:
    """Make malloc keep up to 256 MiB of freed memory, on Linux with glibc; does nothing elsewhere.

    A frame needs some 30 MB for a while. By default glibc now and then returns them and requests them again in the next
    frame: thousands of page faults, which can cost a third of the frame.
    """
    _call("mallopt", _MMAP_THRESHOLD, _LARGEST)
    _call("mallopt", _TRIM_THRESHOLD, _RETAINED_BYTES)


def use_one_arena() -> None:
    """Allocate for all threads in one arena, which `trim_memory` can empty; call it before threads start.

    glibc gives each thread an arena of its own, and returns the free end of the first one only: a window that ran ten
    jobs in threads grew from 560 to 770 MB, with 140 MB in use.
    """
    _call("mallopt", _ARENA_MAX, 1)


def trim_memory() -> None:
    """Return freed memory to the system; does nothing if the C library is not glibc.

    glibc keeps the memory below any block in use: hundreds of megabytes after some large scenes and jobs.
    malloc_trim(3) returns all whole pages, in some 20 ms.
    """
    _call("malloc_trim", 0)


def _call(name: str, *values: int) -> None:
    function = getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None  # absent in musl
    if function is not None:
        function(*values)


class MemoryTrimmer:
    """Returns freed memory in a thread, one second after work has ended."""

    def __init__(self, submit: Callable[[Callable[[], None]], object]) -> None:
        """`submit` calls a function in a thread."""
        self._submit = submit
        self._due_s: float | None = None

    def note_work(self) -> None:
        """Record that large data is, or was, in use."""
        self._due_s = time.monotonic() + _REST_S

    def poll(self) -> None:
        """Return memory when it is time. Call it once a frame."""
        if self._due_s is not None and time.monotonic() > self._due_s:
            self._due_s = None
            self._submit(trim_memory)
