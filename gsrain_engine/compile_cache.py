"""Where compiled kernels outlive the process: one folder for each state of the sources they were compiled from."""

import hashlib
import os
import pickle
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterable
from contextlib import suppress
from importlib import metadata
from pathlib import Path

import platformdirs

_HERE = Path(__file__).parent

_SOURCES = _HERE / "raster", _HERE / "rain"
"""Where kernels call those of other files."""

_FRAME_SOURCES = *_SOURCES, _HERE / "scene"
"""Where all kernels of a frame are."""

_CACHED_VERSIONS = 2

_UNUSED_S = 3600.0
"""A folder from which no process has started for so long may go; one that still runs compiles again, no more."""

_ROOM_BYTES = 32 << 20
"""Kernels take a fifth of it."""


def use_kernel_cache() -> None:
    """Point Numba to this version's cache folder; Numba reads the setting at its first import.

    A folder that the user has set stays; one that a parent process of ours has set is looked up again.
    """
    root = Path(platformdirs.user_cache_dir("gsrain", appauthor=False)) / "numba"
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen is None or Path(chosen).parent == root:
        version = metadata.version("gsrain")
        folder = kernel_cache(root, version, _SOURCES)
        if not _has_room(folder) and (other := _temporary_root()) is not None:
            folder = kernel_cache(other, version, _SOURCES)
        _remove_torn(folder)
        os.environ["NUMBA_CACHE_DIR"] = str(folder)


def has_any_kernel() -> bool:
    """Whether the cache folder holds anything yet: before that, a first frame takes a minute or two."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    return folder is not None and _holds_any(Path(folder))


def has_kernels() -> bool:
    """Whether all kernels of a frame have been compiled into the cache folder, so that loading them takes no second."""
    mark = _mark()
    return mark is not None and mark.is_file()


def mark_kernels() -> None:
    """Keep beside the kernels that all of a frame's are there; where the disk can't be written, nothing is kept."""
    mark = _mark()
    if mark is not None:
        with suppress(OSError):
            mark.touch()


def kernel_cache(root: Path, version: str, sources: Iterable[Path]) -> Path:
    """Make the cache folder that belongs to the sources as they are, and remove those of older ones.

    Numba looks at a compiled function's own file, not at the files of what it calls: a change there has to lead to
    another folder. Python files in the folders `sources` count by path, time and size. The two cache folders that were
    used last stay. Any number of processes may do this at once. Where the disk can't be written, Numba finds its own
    place.
    """
    folder = root / _key(version, sources)
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        _remove_old(root)
    return folder


def _mark() -> Path | None:
    """File that stands for all kernels of a frame as Numba would find them: for another processor it compiles anew."""
    from llvmlite import binding  # with Numba, whose first import has to come after this module's

    folder = os.environ.get("NUMBA_CACHE_DIR")
    if folder is None:
        return None
    versions = f"{metadata.version('gsrain')} {metadata.version('numba')} {sys.implementation.cache_tag}"
    return Path(folder) / f"{_key(f'{versions} {binding.get_host_cpu_name()}', _FRAME_SOURCES)}.complete"


def _has_room(folder: Path) -> bool:
    """Whether kernels can be kept there, or are already: compiling them fails where they can't."""
    try:
        has_room = _holds_any(folder) or shutil.disk_usage(folder).free > _ROOM_BYTES
        return has_room and os.access(folder, os.W_OK)
    except OSError:
        return False


def _holds_any(folder: Path) -> bool:
    return any(folder.rglob("*.nbi"))


def _temporary_root() -> Path | None:
    """Folder for kernels among the temporary files; None where somebody else could put some into it."""
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
    """Remove what a machine that went down has left half: Numba would end every later start over it."""
    for file in folder.rglob("*.nb[ic]"):
        with suppress(OSError), file.open("rb") as opened:
            opened.seek(max(0, file.stat().st_size - 1))
            if opened.read(1) != pickle.STOP:
                file.unlink(missing_ok=True)
                for mark in folder.glob("*.complete"):
                    mark.unlink(missing_ok=True)


def _key(version: str, sources: Iterable[Path]) -> str:
    digest = hashlib.sha256(version.encode())
    for file in sorted(file for folder in sources for file in folder.glob("[!.]*.py")):
        status = file.stat()
        digest.update(f"\n{file} {status.st_mtime_ns} {status.st_size}".encode())
    return digest.hexdigest()[:16]


def _remove_old(root: Path) -> None:
    used = {folder: folder.stat().st_mtime for folder in root.iterdir() if folder.is_dir()}
    for folder in sorted(used, key=used.__getitem__, reverse=True)[_CACHED_VERSIONS:]:
        if time.time() - used[folder] > _UNUSED_S:
            shutil.rmtree(folder, ignore_errors=True)  # another process may be at it too


# § How long threads of OpenMP (our kernels, torch) stay awake while they wait for each other.

_SPINS = "20000"
"""GCC's OpenMP waits 300,000 spins before it sleeps, time that another process on the same cores lacks. With 5,000 and
fewer torch's threads are woken anew for every small product of matrices (docs/performance.md)."""


def wait_briefly() -> None:
    """Let waiting threads sleep soon, unless the user has said how they wait.

    OpenMP reads it when the first library with threads is loaded.
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", _SPINS)
