"""Compiled kernels: their decorator, their cache, which processes share, and a report of compilation."""

import inspect
import logging
import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from functools import cache, update_wrapper
from pathlib import Path
from typing import Any, no_type_check

import numba
import numpy as np
from numba.core import caching, config, event

from .compile_cache import (
    SHIPPED_KERNELS,
    compiled_kernels,
    is_first_to_compile,
    kernel_names,
    shipped_processor,
)
from .safe_io.files import lock_path
from .threads import kernel_threads, usable_cores

logger = logging.getLogger("gsrain")


def kernel(*, parallel: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a compiled function that Python calls; the other options are those of `numba.njit`.

    It lets other threads run, and is compiled once for all processes. Functions that only kernels call are compiled as
    parts of these, by `numba.njit`.

    With `parallel`, threads share the work, as `ParallelKernel` says.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        compiled: Any = numba.njit(nogil=True, **options)(function)
        compiled._cache = KernelCache(function)
        return ParallelKernel(compiled) if parallel else compiled

    return decorate


class ParallelKernel:
    """A kernel that several threads call at once, each time with another portion of its loop.

    The portion is its first parameter, which callers leave out, and its loop runs over `range_of(portion, count)`. The
    portions must not depend on each other, nor the result on their number. It returns nothing: callers give it what it
    is to fill. Numba's own `parallel=True` makes code that takes 2.5 to 6 times as long to compile.
    """

    def __init__(self, compiled: Any) -> None:
        """Wrap a compiled function."""
        self.compiled = compiled
        update_wrapper(self, compiled.py_func)

    def __call__(self, *arguments: Any) -> None:
        """Do the work; the calling thread takes part in it, and does it alone where the others are busy."""
        threads = kernel_threads()
        if threads == 1:
            self.compiled((0, 1), *arguments)
            return
        count = _PORTIONS_A_THREAD * threads
        numbers, others = iter(range(count)), list[Future[None]]()

        def work() -> None:
            # Each wakes two more, so that little work is done before many threads are awake.
            with suppress(RuntimeError):  # as the program ends, no thread begins: this one does the work
                for _ in range(min(2, threads - 1 - len(others))):
                    others.append(helpers().submit(work))
            for number in numbers:
                self.compiled((number, count), *arguments)

        try:
            work()
        finally:
            for each in others:  # which may become more meanwhile
                if not each.cancel():
                    each.result()


_PORTIONS_A_THREAD = 4  # more balance the threads, and each costs some microseconds


@cache
def helpers() -> ThreadPoolExecutor:
    """Return the threads that take portions of kernels beside those that call them."""
    return ThreadPoolExecutor(usable_cores(), "kernels")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=helpers.cache_clear)  # threads do not live on in a forked process


@numba.njit(inline="always")
@no_type_check
def range_of(portion, count):
    """Return the portion's part of `range(count)`; a portion is its number and that of all portions."""
    number, portions = np.int64(portion[0]), np.int64(portion[1])
    # Indices without sign: they can't count from an array's end, and need no test for it.
    return range(np.uint64(np.int64(count) * number // portions), np.uint64(np.int64(count) * (number + 1) // portions))


class KernelCache(caching.FunctionCache):
    """Cache of one kernel, which one process at a time compiles: others wait for it, and then read it.

    Where the program was shipped with compiled kernels for this processor, it reads these.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        """Begin without a lock; `function` is what is compiled."""
        super().__init__(function)
        self.function = function
        self._lock: ExitStack | None = None
        stamp = self._impl.locator.get_source_stamp()
        own = _own_folder(inspect.getfile(function)) or "of others"
        self._shipped = caching.IndexDataCacheFile(SHIPPED_KERNELS / own, self._impl.filename_base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel for some types of arguments; None if this process has to compile it."""
        found = self._load_shipped(sig, target_context) or super().load_overload(sig, target_context)
        if found is None:
            from .kernel_helpers import compile_another, help_with  # rarely needed

            help_with(name_of(self.function))
            # Rather than wait for another process, compile what comes next; not within a kernel, for which it may wait.
            while not self.lock(waiting=False):
                if _locked or not compile_another():
                    self.lock(waiting=True)
            found = super().load_overload(sig, target_context)
        if found is not None:
            self.release()
        return found

    def _load_shipped(self, sig: Any, target_context: Any) -> Any:
        if (processor := shipped_processor()) is None:
            return None
        target_context.refresh()
        codegen = target_context.codegen()
        signature, _, function = self._index_key(sig, codegen)
        data = self._shipped.load((signature, (codegen.magic_tuple()[0], processor, ""), function))
        return None if data is None else self._impl.rebuild(target_context, data)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a kernel that this process has compiled."""
        try:
            super().save_overload(sig, data)
        finally:
            self.release()

    def lock(self, *, waiting: bool) -> bool:
        """Keep other processes from compiling this kernel; without `waiting` return False if one does."""
        if self._lock is None:
            stack, path = ExitStack(), Path(self.cache_path, f"{self._impl.filename_base}.lock")
            try:
                self._impl.locator.ensure_cache_path()
                path.touch()
                if not stack.enter_context(lock_path(path, waiting=waiting)):
                    stack.close()
                    return False
            except OSError:  # the disk can't be written: each process compiles for itself
                return True
            self._lock = stack
            _locked.add(self)
        return True

    def release(self) -> None:
        """Let other processes have this kernel."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None
            _locked.discard(self)


_locked = set[KernelCache]()
"""Caches of the kernels that this process compiles, one within the other."""


def name_of(function: Callable[..., Any]) -> str:
    """Return the name of a kernel within the engine."""
    return f"{function.__module__.removeprefix(f'{__package__}.')}.{function.__name__}"


class SharedCacheLocator(caching.UserProvidedCacheLocator):
    """Caches kernels of this program by their folder in it: all installations of one version share them."""

    def __init__(self, py_func: Any, py_file: str) -> None:
        super().__init__(py_func, py_file)
        self._cache_path = str(Path(_CONFIG.CACHE_DIR, _own_folder(py_file) or ""))

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        return None if _own_folder(py_file) is None else super().from_function(py_func, py_file)


def _own_folder(file: str) -> Path | None:
    """Folder of a file within the program; None if it is not of the program."""
    path = Path(file).resolve()
    return path.relative_to(_PROGRAM).parent if path.is_relative_to(_PROGRAM) else None


_CONFIG: Any = config  # its names are made at run time
_PROGRAM = Path(__file__).resolve().parent
if not _CONFIG.CACHE_LOCATOR_CLASSES:  # chosen by the user, by a variable of the environment
    _LOCATORS = "UserProvided", "InTree", "UserWide", "IPython", "Zip"
    _NAMES = f"{__name__}.{SharedCacheLocator.__name__}", *(f"{each}CacheLocator" for each in _LOCATORS)
    _CONFIG.CACHE_LOCATOR_CLASSES = ",".join(_NAMES)


class CompilationReport(event.Listener):
    """Logs once, at the first kernel of ours that a process compiles, how many are missing."""

    def __init__(self) -> None:
        """Begin with nothing compiled."""
        self._is_done = False

    def on_start(self, event: Any) -> None:
        module: str = event.data["dispatcher"].py_func.__module__
        if self._is_done or not module.startswith(f"{__package__}."):  # others are kernels of the user's program
            return
        self._is_done = True
        if not is_first_to_compile():
            return
        missing, cores = len(kernel_names()) - compiled_kernels(), usable_cores()
        if missing > 0:
            which, seconds = f"up to {missing} kernels", round(_KERNEL_S * missing / cores)
        else:
            which, seconds, cores = f"kernels of {module}, 1 or more,", _FURTHER_S, 1
        on = "1 core" if cores == 1 else f"{cores} cores"
        logger.warning("Compiling %s for this processor, once: about %d s on %s.", which, seconds, on)

    def on_end(self, event: Any) -> None:
        pass


_KERNEL_S = 1.6  # mean time of a core for a kernel of a picture
_FURTHER_S = 10  # time of a core for the few kernels of an effect
event.register("numba:compile", CompilationReport())
