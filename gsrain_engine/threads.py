"""Threads of this process and of its workers, which share the processor's cores."""

import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_KERNEL_THREADS = "NUMBA_NUM_THREADS"
_VARIABLES = (_KERNEL_THREADS, "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables with the number of threads of kernels, OpenMP (torch), OpenBLAS (NumPy) and MKL (torch)."""

WORKER_NICENESS = 10
"""Priority of workers below the window, as `os.nice` counts: each step is a quarter less of a contested core.

A worker beside a window that plays on all cores gets 1 part of them in 10.
"""

PICTURE_NICENESS = 1
"""Priority of the thread that draws the viewport: between those of the interface and a job; that gets a quarter."""


def lower_thread_priority() -> None:
    """Give the calling thread and those that it starts `PICTURE_NICENESS`; only Linux has priorities of threads."""
    if sys.platform == "linux":
        niceness = os.getpriority(os.PRIO_PROCESS, os.getpid()) + PICTURE_NICENESS
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), niceness)


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


_MAX_WAITING = 256  # items that wait for an earlier one


def results_in_order(
    calls: Iterable[tuple[_Item, Callable[[], _Result] | None]], threads: int
) -> Generator[tuple[_Item, _Result | None]]:
    """Yield items in their order, each with the result of its call; as many calls as `threads` run at once.

    Calls are taken one ahead of the threads, so that memory is bounded, and each uses one thread of compiled kernels.
    An item without a call waits for those before it. An error, and closing, drops calls that have not begun and waits
    for the others. With one thread, calls run in the caller's, with all threads of kernels.
    """
    if threads == 1:
        for item, call in calls:
            yield item, None if call is None else call()
        return
    waiting = deque[tuple[_Item, Future[_Result] | None]]()
    with ThreadPoolExecutor(threads, "ordered", initializer=_use_one_thread) as pool:
        try:
            ahead = 0
            for item, call in calls:
                waiting.append((item, None if call is None else pool.submit(call)))
                ahead += call is not None
                while waiting and (waiting[0][1] is None or ahead > threads or len(waiting) > _MAX_WAITING):
                    first, future = waiting.popleft()
                    ahead -= future is not None
                    yield first, None if future is None else future.result()
            for item, future in waiting:
                yield item, None if future is None else future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _use_one_thread() -> None:
    _own.kernels = 1


class _Own(threading.local):
    """Settings of each thread."""

    kernels: int | None = None


_own = _Own()


def kernel_threads() -> int:
    """Number of threads that share a kernel which the calling thread calls; `NUMBA_NUM_THREADS` sets it for a process.

    The default is the number of cores.
    """
    return _own.kernels or _process_threads()


@cache
def _process_threads() -> int:
    try:
        return max(1, int(os.environ[_KERNEL_THREADS]))
    except (KeyError, ValueError):
        return usable_cores()


@contextmanager
def limited_kernels(threads: int) -> Generator[None]:
    """Kernels that the block calls in this thread use `threads`, at least 1."""
    before, _own.kernels = _own.kernels, threads
    try:
        yield
    finally:
        _own.kernels = before


@contextmanager
def half_of_cores() -> Generator[None]:
    """Kernels that the block calls use half of the cores, for the interface and jobs need the others.

    With more threads than free cores each kernel waits for the thread that is served last.
    """
    with limited_kernels(max(min(usable_cores() // 2, kernel_threads()), 1)):
        yield


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
