"""Locks between processes: the system lets go of them when their holder dies, however it dies."""

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


_WITHOUT_WAITING = getattr(os, "O_NONBLOCK", 0)
"""A pipe of that name would keep whoever opens it until somebody comes to its other end."""


class FileLock:
    """A lock that is held from `take` until `release`, or until the process ends."""

    def __init__(self, path: Path, handle: int) -> None:
        self._path = path
        self._handle = handle

    @staticmethod
    def take(path: Path) -> "FileLock | None":
        """Lock a file, which is made where it is missing; None while somebody else has it, in this process too.

        Raises:
            OSError: When the file can't be made.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | _WITHOUT_WAITING, 0o600)
            if not _lock(handle, waiting=False):
                os.close(handle)
                return None
            if _is_still(path, handle):
                return FileLock(path, handle)
            os.close(handle)  # its last holder has just removed it

    def release(self) -> None:
        """Let others have it, and remove the file."""
        if self._handle < 0:
            return
        if fcntl is not None:  # Windows removes no file that is open
            self._path.unlink(missing_ok=True)
        os.close(self._handle)
        self._handle = -1


@contextmanager
def locked(path: Path) -> Generator[None]:
    """Hold the lock of a file or folder that exists; waits for whoever has it. Without effect where disks know none."""
    if fcntl is None and path.is_dir():
        yield
        return
    handle = os.open(path, (os.O_RDONLY if path.is_dir() else os.O_RDWR) | _WITHOUT_WAITING)
    try:
        _lock(handle, waiting=True)
        yield
    finally:
        os.close(handle)


@contextmanager
def locked_if_free(path: Path) -> Generator[bool]:
    """Hold the lock of a file or folder that exists, unless somebody else does; says which.

    Where the system or the disk knows no locks, it looks free.
    """
    if fcntl is None:
        yield True
        return
    handle = os.open(path, os.O_RDONLY | _WITHOUT_WAITING)
    try:
        yield _lock(handle, waiting=False)
    finally:
        os.close(handle)


def _lock(handle: int, *, waiting: bool) -> bool:
    """Lock an open file; False when somebody else has it. A disk that knows no locks lets everybody in."""
    try:
        if fcntl is not None:
            fcntl.flock(handle, fcntl.LOCK_EX if waiting else fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            import msvcrt  # pyright: ignore

            msvcrt.locking(handle, msvcrt.LK_LOCK if waiting else msvcrt.LK_NBLCK, 1)  # pyright: ignore
    except BlockingIOError:
        return False
    except PermissionError:  # what Windows says when it is taken
        return False
    except OSError:
        return True
    return True


def _is_still(path: Path, handle: int) -> bool:
    """Whether an open file still stands at its path."""
    try:
        return path.stat().st_ino == os.fstat(handle).st_ino
    except OSError:
        return False
