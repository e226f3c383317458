"""Arrays that are mapped from a file: what is not used takes no memory."""

import mmap
from collections.abc import Iterable, Sequence
from io import BufferedReader
from typing import Any

import numpy as np

ArrayPlace = tuple[tuple[int, ...], "np.dtype[Any]", int]
"""Shape, type, and byte offset in a file."""


def map_arrays(file: BufferedReader, places: Iterable[ArrayPlace]) -> list[np.ndarray]:
    """Map arrays of an open file: writable for kernels, but private, so that the file stays as it is.

    Without MAP_NORESERVE the system would refuse a file larger than the memory.
    """
    if hasattr(mmap, "MAP_PRIVATE"):
        flags = mmap.MAP_PRIVATE | getattr(mmap, "MAP_NORESERVE", 0)
        mapped = mmap.mmap(file.fileno(), 0, flags=flags, prot=mmap.PROT_READ | mmap.PROT_WRITE)
    else:
        mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    return [np.frombuffer(mapped, dtype, int(np.prod(shape)), offset).reshape(shape) for shape, dtype, offset in places]


def is_mapped(array: np.ndarray) -> bool:
    """Return whether an array is a view of a mapped file."""
    return _file_of(array) is not None


def release_pages(arrays: Sequence[np.ndarray]) -> None:
    """Release the memory of mapped files, which the system reads again when it is used; others stay as they are."""
    if hasattr(mmap, "MADV_DONTNEED"):
        for file in {id(file): file for file in map(_file_of, arrays) if file is not None}.values():
            file.madvise(mmap.MADV_DONTNEED)


def _file_of(array: np.ndarray) -> mmap.mmap | None:
    owner: Any = array
    while isinstance(owner, np.ndarray | memoryview):
        owner = owner.base if isinstance(owner, np.ndarray) else owner.obj
    return owner if isinstance(owner, mmap.mmap) else None
