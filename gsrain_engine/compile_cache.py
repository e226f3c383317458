"""Cache of compiled Numba kernels, in a folder for each state of their sources; the spin count of OpenMP threads."""

import hashlib
import os
import pickle
import platform
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path

import platformdirs

_HERE = Path(__file__).parent
FRAME_SOURCES = tuple(
    _HERE / each
    for each in (
        "fast_math.py", "kernels.py", "rain", "render/autodiff", "render/cpu", "water", "scene/ground_water.py",
        "scene/lens_kernels.py", "scene/water_surface.py",
    )
)  # fmt: skip
"""Folders and files with kernels that others call, and with the constants in them."""
KERNEL_TABLE = _HERE / "kernel_table.txt"
"""Kernels of pictures, with their types of arguments, in the order of need: packaging/kernel_table.py writes it."""
SHIPPED_KERNELS = _HERE / "compiled_kernels"
"""Kernels of a wheel that was built with them (packaging/wheel_hook.py), for any processor with `BASELINES`."""
BASELINES = {
    "x86_64": ("x86-64-v3", frozenset({"avx2", "bmi2", "f16c", "fma", "lzcnt", "movbe"})),  # Intel 2013, AMD 2015
    "aarch64": ("generic", frozenset[str]()),
}
"""Processor, as LLVM names it, that shipped kernels are compiled for, with the features to test, by architecture."""
_CACHED_VERSIONS = 2
_UNUSED_S = 3600.0  # age after which an unused folder may be removed; a process that still uses it only compiles again
ROOM_BYTES = 32 << 20  # free space to require; the kernels take a fifth of it


def use_kernel_cache() -> None:
    """Point Numba to this version's cache folder; Numba reads the setting at its first import.

    A folder set by the user stays; one set by a parent process of this program is looked up again.
    """
    root = Path(platformdirs.user_cache_dir("gsrain", appauthor=False)) / "numba"
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen is None or Path(chosen).parent == root:
        version = metadata.version("gsrain")
        folder = kernel_cache(root, version, FRAME_SOURCES)
        if not _has_room(folder) and (other := _temporary_root()) is not None:
            folder = kernel_cache(other, version, FRAME_SOURCES)
        _remove_torn(folder)
        os.environ["NUMBA_CACHE_DIR"] = str(folder)


def has_kernels() -> bool:
    """Return whether all kernels of a frame are compiled, so that loading them takes less than a second."""
    mark = _mark()
    return (mark is not None and mark.is_file()) or shipped_processor() is not None


@cache
def shipped_processor() -> str | None:
    """Return the processor that shipped kernels are for; None without any, or where these don't fit."""
    if not SHIPPED_KERNELS.is_dir():
        return None
    from llvmlite import binding  # imports Numba, whose first import must follow this module's

    name, features = BASELINES.get(architecture(), ("", frozenset()))
    found = binding.get_host_cpu_features()
    fits = all(found.get(each) for each in features) and (SHIPPED_KERNELS / _mark_name(name)).is_file()
    return name if fits else None


def architecture() -> str:
    """Return the name of this machine's instructions among `BASELINES`."""
    machine = platform.machine().lower()
    return {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)


@cache
def kernel_rows() -> tuple[str, ...]:
    """Return the rows of the table of kernels."""
    return tuple(KERNEL_TABLE.read_text("utf-8").splitlines())


@cache
def kernel_names() -> frozenset[str]:
    """Return the kernels of the table, as "module.function": a first start compiles them; some effects have more."""
    return frozenset(".".join(row.partition("(")[0].split(".")[-2:]) for row in kernel_rows())


def compiled_kernels() -> int:
    """Return how many of `kernel_names` are in the cache folder, also while other processes compile."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    files = () if folder is None else Path(folder).rglob("*.nbi")
    return len({each.name.partition("-")[0] for each in files} & kernel_names())


def is_first_to_compile() -> bool:
    """Return whether no other process of this command, such as another worker, compiles: the first one reports it.

    A lock in the cache folder, which ends with this process, tells the others.
    """
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if folder is None or os.name != "posix":
        return True
    import fcntl

    try:
        lock = os.open(Path(folder) / f"{os.getpgrp()}.compiling", os.O_CREAT | os.O_RDWR, 0o600)
    except OSError:
        return True
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        return False
    return True


def stores_kernels() -> bool:
    """Return whether kernels that another process compiles can be read from the cache folder."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    return folder is not None and _has_room(Path(folder))


def mark_kernels() -> None:
    """Mark the cache folder as holding all kernels of a frame; does nothing if the disk can't be written."""
    if (mark := _mark()) is not None:
        with suppress(OSError):
            mark.touch()


def kernel_cache(root: Path, version: str, sources: Iterable[Path]) -> Path:
    """Create the cache folder for the current sources, and remove outdated ones.

    Numba checks only a compiled function's own file, not the files of the functions that it calls: a change there has
    to lead to another folder. Python files, and those in folders, count by name and contents, wherever the program is
    installed. The two most recently used cache folders stay. Any number of processes may call this at once. If the disk
    can't be written, Numba selects a folder itself.
    """
    folder = root / _key(version, sources)
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        used = {each: each.stat().st_mtime for each in root.iterdir() if each.is_dir()}
        for old in sorted(used, key=used.__getitem__, reverse=True)[_CACHED_VERSIONS:]:
            if time.time() - used[old] > _UNUSED_S:
                shutil.rmtree(old, ignore_errors=True)  # another process may be removing it too
    return folder


def _mark() -> Path | None:
    """File that marks all kernels of a frame as compiled for this processor; Numba recompiles for another one."""
    from llvmlite import binding  # imports Numba, whose first import must follow this module's

    folder = os.environ.get("NUMBA_CACHE_DIR")
    if folder is None:
        return None
    return Path(folder) / _mark_name(os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name())


def _mark_name(processor: str) -> str:
    versions = f"{metadata.version('gsrain')} {metadata.version('numba')} {sys.implementation.cache_tag}"
    return f"{_key(f'{versions} {processor}', FRAME_SOURCES)}.complete"


def _has_room(folder: Path) -> bool:
    """Return whether the folder holds kernels or has room for them: compilation fails on a full disk."""
    try:
        has_room = _holds_any(folder) or shutil.disk_usage(folder).free > ROOM_BYTES
        return has_room and os.access(folder, os.W_OK)
    except OSError:
        return False


def _holds_any(folder: Path) -> bool:
    return any(folder.rglob("*.nbi"))


def _temporary_root() -> Path | None:
    """Folder for kernels among the temporary files; None if another user could write to it."""
    if os.name != "posix":
        return None
    root = Path(tempfile.gettempdir()) / f"gsrain-kernels-{os.getuid()}"
    try:
        root.mkdir(mode=0o700, exist_ok=True)
        status = root.lstat()
    except OSError:
        return None
    is_own = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o077
    return root if is_own else None


def _remove_torn(folder: Path) -> None:
    """Remove files truncated by a crash of the machine: Numba would fail on them at every later start."""
    for file in folder.rglob("*.nb[ic]"):
        with suppress(OSError), file.open("rb") as opened:
            opened.seek(max(0, file.stat().st_size - 1))
            if opened.read(1) != pickle.STOP:
                file.unlink(missing_ok=True)
                for mark in folder.glob("*.complete"):
                    mark.unlink(missing_ok=True)


def _key(version: str, sources: Iterable[Path]) -> str:
    digest = hashlib.sha256(version.encode())
    for file in sorted(
        each for source in sources for each in (source.glob("[!.]*.py") if source.is_dir() else [source])
    ):
        contents = file.read_bytes()
        digest.update(f"\n{file.parent.name}/{file.name} {len(contents)}\n".encode() + contents)
    return digest.hexdigest()[:16]


# OpenMP threads

_SPINS = "20000"
"""Spins of GCC's OpenMP before a thread sleeps. Its default of 300,000 takes time from other processes on the same
cores; with 5,000 and fewer, torch's threads are woken anew for every small matrix product (docs/performance.md).
"""


def wait_briefly() -> None:
    """Let waiting OpenMP threads sleep soon, unless the user has configured them.

    OpenMP reads the setting when the first library with threads is loaded.
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", _SPINS)
