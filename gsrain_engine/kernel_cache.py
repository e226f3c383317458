"""Where compiled kernels outlive the process: one folder for each state of the sources they were compiled from."""

import hashlib
import os
import shutil
import time
from collections.abc import Iterable
from contextlib import suppress
from importlib import metadata
from pathlib import Path

import platformdirs

_KEPT = 2
_UNUSED_S = 3600.0
"""A folder from which no process has started for so long may go; one that still runs compiles again, no more."""


def use_kernel_cache() -> None:
    """Point Numba to this version's cache folder; Numba reads the setting at its first import.

    A folder that the user has set stays; one that a parent process of ours has set is looked up again.
    """
    root = Path(platformdirs.user_cache_dir("gsrain", appauthor=False)) / "numba"
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen is None or Path(chosen).parent == root:
        here = Path(__file__).parent
        folder = kernel_cache(root, metadata.version("gsrain"), [here / "raster", here / "rain"])
        os.environ["NUMBA_CACHE_DIR"] = str(folder)


def has_kernels() -> bool:
    """Whether kernels have been compiled into the cache folder before, so that loading them takes no second."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    return folder is not None and any(Path(folder).rglob("*.nbi"))


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


def _key(version: str, sources: Iterable[Path]) -> str:
    digest = hashlib.sha256(version.encode())
    for file in sorted(file for folder in sources for file in folder.glob("[!.]*.py")):
        status = file.stat()
        digest.update(f"\n{file} {status.st_mtime_ns} {status.st_size}".encode())
    return digest.hexdigest()[:16]


def _remove_old(root: Path) -> None:
    used = {folder: folder.stat().st_mtime for folder in root.iterdir() if folder.is_dir()}
    for folder in sorted(used, key=used.__getitem__, reverse=True)[_KEPT:]:
        if time.time() - used[folder] > _UNUSED_S:
            shutil.rmtree(folder, ignore_errors=True)  # another process may be at it too
