"""Memory that is free goes back to the system once work has ended."""

import ctypes
import sys
import time
from concurrent.futures import Executor

_REST_S = 1.0
"""What work leaves behind is let go of in the frames after it."""


def return_freed_memory() -> None:
    """Give memory that was freed back to the system; does nothing where the C library is not glibc.

    glibc keeps what lies below something that is still in use, in an arena for every thread: hundreds of megabytes
    after some large scenes and jobs. malloc_trim(3) returns all whole pages, in some 20 ms.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


class FreedMemory:
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
            self._thread.submit(return_freed_memory)
