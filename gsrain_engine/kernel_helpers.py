"""Processes that compile the kernels of pictures ahead, on all cores, while this one compiles what it needs next."""

import ast
import atexit
import multiprocessing
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from importlib import import_module
from multiprocessing.context import SpawnProcess
from typing import Any

import psutil

from .compile_cache import has_kernels, kernel_rows, stores_kernels
from .optional_packages import is_frozen
from .threads import usable_cores

_HELPER_BYTES = 500 << 20  # memory that a compiler needs
_NICENESS = 5  # of helpers: what the user waits for next, such as the scene, comes first
_MOST = 8  # helpers: the largest kernel takes a twentieth of the time of all
_OWN = f"{__package__}."
_IS_HELPER = "GSRAIN_COMPILES_KERNELS"
"""Variable of the environment of helpers, which start none themselves."""


class KernelHelpers:
    """Processes that compile the kernels of the table, in its order, each by one of them; they end with this one."""

    def __init__(self, spare_cores: int = 0) -> None:
        """Start as many as the cores, but some of them, and the free memory allow; none where kernels can't be stored.

        Raises:
            OSError: When no process can be started.
        """
        self._programs = list[subprocess.Popen[bytes]]()
        self._process: SpawnProcess | None = None
        count = min(usable_cores() - spare_cores, psutil.virtual_memory().available // _HELPER_BYTES, _MOST)
        if _IS_HELPER in os.environ or not stores_kernels() or count < 1:
            return
        if is_frozen():  # there is no Python to start
            self._process = multiprocessing.get_context("spawn").Process(target=compile_table, daemon=True)
            self._process.start()
            return
        command, none = [sys.executable, "-P", "-m", __name__], subprocess.DEVNULL
        for _ in range(count if os.name == "posix" else 1):  # elsewhere no lock keeps two from the same kernel
            helper = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=none, stderr=none)
            threading.Thread(target=helper.wait, daemon=True).start()  # an ended one doesn't stay as a zombie
            self._programs.append(helper)

    @property
    def are_running(self) -> bool:
        """True until all have ended."""
        is_running = self._process is not None and self._process.is_alive()
        return is_running or any(each.poll() is None for each in self._programs)

    def end(self) -> None:
        """End them; what they have not finished is lost."""
        for each in self._programs:
            each.communicate()  # closes what they read


@cache
def help_with(kernel: str) -> None:
    """Start helpers, once in a process, if a missing kernel is one of the table: others of it will be needed too."""
    if not has_kernels() and any(row.startswith(f"{kernel}(") for row in kernel_rows()):
        _help()


@cache
def _help() -> None:
    with suppress(OSError):  # no process can be started
        atexit.register(KernelHelpers(spare_cores=1).end)


def compile_table() -> None:
    """Compile the kernels of the table that are missing and that no other process compiles, as a helper does."""
    os.environ[_IS_HELPER] = "1"
    while compile_another():
        pass


def compile_another() -> bool:
    """Compile, or load, the next kernel of the table that no other process compiles; return False after the last."""
    for row in _rows():
        name, types = parse_row(row)
        module, _, function = name.rpartition(".")
        found = getattr(import_module(f"{_OWN}{module}"), function)
        kernel = getattr(found, "compiled", found)  # of a `ParallelKernel`
        if kernel._cache.lock(waiting=False):  # a `KernelCache`
            kernel.compile(types)
            kernel._cache.release()
            return True
    return False


@cache
def _rows() -> Iterator[str]:
    """Rows that this process has not tried."""
    return iter(kernel_rows())


# Rows of the table


def parse_row(row: str) -> tuple[str, tuple[Any, ...]]:
    """Return the name and the types of arguments of a kernel: "render.cpu.tiles.f(float32[:, ::1], int64)"."""
    call = ast.parse(row, mode="eval").body
    assert isinstance(call, ast.Call)
    return ast.unparse(call.func), tuple(map(_type_of, call.args))


def _type_of(node: ast.expr) -> Any:
    from numba import types

    match node:
        case ast.Name(id=name):
            return getattr(types, name)
        case ast.Subscript(value=ast.Name() as element, slice=slices):
            axes = slices.elts if isinstance(slices, ast.Tuple) else [slices]
            steps = [isinstance(each, ast.Slice) and each.step is not None for each in axes]
            layout = "A" if not any(steps) else "C" if steps[-1] else "F"
            return types.Array(_type_of(element), len(steps), layout)
        case ast.Call(func=ast.Name(id="const"), args=[array]):
            return _type_of(array).copy(readonly=True)
        case ast.Tuple(elts=elements):
            return types.BaseTuple.from_types(tuple(map(_type_of, elements)))
        case ast.Call(func=ast.Attribute() as name, args=elements):
            module, _, kind = ast.unparse(name).rpartition(".")
            made = getattr(import_module(f"{_OWN}{module}"), kind)
            return types.BaseTuple.from_types(tuple(map(_type_of, elements)), made)
        case _:
            raise ValueError(f"no type of Numba: {ast.unparse(node)}")


def _end_with_parent() -> None:
    with suppress(OSError):
        os.read(sys.stdin.fileno(), 1)
    os._exit(0)


if __name__ == "__main__":
    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    compile_table()
