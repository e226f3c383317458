"""Threads of this process and of its workers, which share the processor's cores."""

import os
from collections.abc import Generator
from contextlib import contextmanager

_VARIABLES = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables with the number of threads of Numba, OpenMP (torch), OpenBLAS (NumPy) and MKL (torch)."""


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cores_with_jobs() -> int:
    """Number of cores for the window's kernels while jobs run: three of four, so that jobs always get some."""
    return max(1, 3 * usable_cores() // 4)


@contextmanager
def thread_limit(count: int) -> Generator[None]:
    """Processes that the block starts use `count` threads in each library, unless the environment sets a number."""
    added = [name for name in _VARIABLES if name not in os.environ]
    os.environ.update(dict.fromkeys(added, str(count)))
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]
