"""Threads of this process and of its workers, which share the processor's cores."""

import os
from collections.abc import Generator
from contextlib import contextmanager

_VARIABLES = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables with the number of threads of Numba, OpenMP (torch), OpenBLAS (NumPy) and MKL (torch)."""


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share_cores(*, with_jobs: bool) -> None:
    """Let Numba's kernels that this thread calls use all cores, or leave every fourth one to jobs: at least one of two.

    Jobs have a lower priority, and would get next to nothing while the window plays on all cores.
    """
    import numba  # loads slowly: not before the first job

    count = numba.config.NUMBA_NUM_THREADS
    numba.set_num_threads(max(1, 3 * count // 4) if with_jobs else count)


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
