"""Memory that a frame gives back stays with the process: the next frame wants as much."""

import ctypes
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h
_LARGEST = 32 << 20
"""Bytes; the most that glibc takes. What is larger still comes from the system and goes back to it."""
_KEPT = 256 << 20
"""Bytes."""


def keep_freed_memory() -> None:
    """Tell malloc to keep what is freed, up to 256 MiB, on Linux with glibc; elsewhere nothing changes.

    A frame needs some 30 MB for a while. By default glibc now and then returns them and fetches them again from the
    system in the next frame: thousands of page faults, which can cost a third of the frame.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST)
        mallopt(_TRIM_THRESHOLD, _KEPT)
