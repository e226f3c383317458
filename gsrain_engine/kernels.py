"""Whether compiled kernels let other threads run: the interface is drawn while a kernel works on a picture."""

from contextlib import suppress
from importlib import import_module

from numba.core import config


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
