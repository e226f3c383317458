"""Compiled kernels: an option that lets other threads run, their place in the cache, and a report of compilation."""

import logging
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from numba.core import caching, config, event

from .compile_cache import KERNELS, compiled_kernels, is_first_to_compile

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
        missing = KERNELS - compiled_kernels()
        if missing > 0:
            which, seconds = f"up to {missing} kernels", round(_KERNEL_S * missing)
        else:
            which, seconds = f"kernels of {module}, 1 or more,", _FURTHER_S
        logger.warning("Compiling %s for this processor, once: about %d s of one core.", which, seconds)

    def on_end(self, event: Any) -> None:
        pass


_KERNEL_S = 1.5  # mean time of a core for a kernel of a picture
_FURTHER_S = 10  # time of a core for the few kernels of an effect
event.register("numba:compile", CompilationReport())
