"""Compiled kernels: their decorator, their cache, which processes share, and a report of compilation."""

import logging
from collections.abc import Callable
from contextlib import ExitStack, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, config, event

from .compile_cache import compiled_kernels, is_first_to_compile, kernel_names
from .safe_io.files import lock_path
from .threads import usable_cores

logger = logging.getLogger("gsrain")


def _take_concurrent_calls() -> bool:
    """Return whether two threads may run parallel kernels at once; Numba's own layer, `workqueue`, ends the process."""
    if getattr(config, "THREADING_LAYER", "") == "workqueue":
        return False
    for pool in ("tbbpool", "omppool"):
        with suppress(ImportError):  # its library, such as libgomp, is missing
            import_module(f"numba.np.ufunc.{pool}")
            return True
    return False


NOGIL = _take_concurrent_calls()
"""Option `nogil` of kernels. Without it Python's lock, held while a kernel runs, keeps them from running at once."""


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a compiled function that Python calls; the options are those of `numba.njit`.

    It lets other threads run, and is compiled once for all processes. Functions that only kernels call are compiled as
    parts of these, by `numba.njit`.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        compiled: Any = numba.njit(nogil=NOGIL, **options)(function)
        compiled._cache = KernelCache(function)
        return compiled

    return decorate


class KernelCache(caching.FunctionCache):
    """Cache of one kernel, which one process at a time compiles: others wait for it, and then read it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        """Begin without a lock; `function` is what is compiled."""
        super().__init__(function)
        self.function = function
        self._lock: ExitStack | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel for some types of arguments; None if this process has to compile it."""
        found = super().load_overload(sig, target_context)
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
        own = Path(py_file).resolve().relative_to(_PROGRAM).parent
        self._cache_path = str(Path(_CONFIG.CACHE_DIR, *own.parts))

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        if not Path(py_file).resolve().is_relative_to(_PROGRAM):
            return None
        return super().from_function(py_func, py_file)


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


_KERNEL_S = 2.3  # mean time of a core for a kernel of a picture
_FURTHER_S = 10  # time of a core for the few kernels of an effect
event.register("numba:compile", CompilationReport())
