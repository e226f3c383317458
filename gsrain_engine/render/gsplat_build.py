"""First use of gsplat: it is installed without compiled kernels and builds them once, which takes over a minute."""

import threading
import time
from collections.abc import Callable, Generator
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..scene.progress import Progress

BUILD_S = 75.0
"""Time of the build on 16 cores, measured with gsplat 1.5.3 and one architecture; fewer cores take longer."""

ANNOUNCEMENT = f"gsplat compiles its kernels, about {BUILD_S:.0f} s, once"
_INTERVAL_S = 1.0


class GsplatBuildError(ValueError):
    """Raised if gsplat's kernels can't be compiled or loaded; the message quotes the reason."""


def gsplat_is_built() -> bool:
    """Return whether gsplat's kernels are compiled: installed with it, or built by an earlier run."""
    with suppress(ModuleNotFoundError):
        if find_spec("gsplat.csrc") is not None:
            return True
    # gsplat asks torch for this folder in the same way; TORCH_EXTENSIONS_DIR moves it.
    extension: Any = import_module("torch.utils.cpp_extension")
    folder = Path(extension._get_build_directory("gsplat_cuda", False))
    return any((folder / f"gsplat_cuda{ending}").is_file() for ending in (".so", ".lib"))


def build_gsplat(
    load: Callable[[], Any] | None = None, is_built: Callable[[], bool] = gsplat_is_built,
    interval_s: float = _INTERVAL_S,
) -> Generator[Progress]:  # fmt: skip
    """Load gsplat's kernels; if they have to be compiled, yield one line before that and one a second during it.

    `load` imports the kernels and returns them, by default those of gsplat, or None without a CUDA toolkit. Raises
    `GsplatBuildError` if that fails. A stopped job leaves the build to itself: the next one starts it again.
    """
    load = load or _load
    if is_built():
        _checked(load)
        return
    yield Progress(0.0, ANNOUNCEMENT)
    failures: list[GsplatBuildError] = []
    done = threading.Event()

    def work() -> None:
        try:
            _checked(load)
        except GsplatBuildError as error:
            failures.append(error)
        finally:
            done.set()

    began = time.perf_counter()
    threading.Thread(target=work, name="gsplat build", daemon=True).start()
    while not done.wait(interval_s):
        seconds = time.perf_counter() - began
        yield Progress(min(seconds / BUILD_S, 0.99), f"{ANNOUNCEMENT}: {seconds:.0f} s so far")
    if failures:
        raise failures[0]
    yield Progress(1.0, f"gsplat compiled its kernels in {time.perf_counter() - began:.0f} s")


def _load() -> Any:
    return import_module("gsplat.cuda._backend")._C


def _checked(load: Callable[[], Any]) -> None:
    try:
        kernels = load()
    except Exception as error:  # compilers and drivers raise errors of many types: the message quotes them
        raise GsplatBuildError(f"gsplat can't compile its kernels: {error}") from error
    if kernels is None:
        raise GsplatBuildError("gsplat can't compile its kernels: it needs the CUDA toolkit (nvcc) of torch's version")
