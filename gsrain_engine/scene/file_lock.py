"""Locks between processes: the system lets go of them when their holder dies, however it dies."""

import hashlib
import json
import os
import platform
import shlex
import stat
import sys
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from gsrain_engine.untrusted.printable import printable

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


class HeldError(OSError):
    """A place that another process writes to: says which process that is, and what it was called with."""


@dataclass
class _Holding:
    """A place that this process writes to, and how often it has begun to."""

    handle: int | None
    made: tuple[Path, ...]
    """Folders that were made for the lock, the innermost first; they go with it where nothing was written."""
    count: int = 1


_guard, _holdings = threading.Lock(), dict[Path, _Holding]()


@contextmanager
def holding(path: Path, *, shared: bool = False) -> Generator[None]:
    """Have a file or folder that is written to for this process, for as long as the block runs; it need not be there.

    The lock is a file beside it, `.NAME.lock`, in which the process writes down what it is; it goes in the end, and one
    that a process left which was killed is taken over. In this process it may be held several times. Processes that
    write to one place together, as the shares of a sweep, hold it `shared`.

    Raises:
        HeldError: At once, where another process has it.
    """
    place = path.resolve()
    with _guard:
        if place in _holdings:
            _holdings[place].count += 1
        else:
            missing = tuple(each for each in place.parents if not each.exists())
            _holdings[place] = _Holding(_taken(place, shared), missing)
    try:
        yield
    finally:
        with _guard:
            own = _holdings[place]
            own.count -= 1
            if own.count == 0:
                del _holdings[place]
                _let_go(lock_file(place), own)


def lock_file(path: Path) -> Path:
    """Return the file by which a place is held."""
    name = path.name.encode(errors="surrogateescape")
    if len(name) <= _LONGEST_NAME:
        return path.with_name(f".{path.name}.lock")
    short = name[:_LONGEST_NAME].decode(errors="ignore")
    return path.with_name(f".{short}.{hashlib.sha256(name).hexdigest()[:8]}.lock")


_LONGEST_NAME = 200
"""Bytes of a name that go into that of its lock; disks take 255."""
_LONGEST_NOTE = 4096


def _taken(place: Path, shared: bool) -> int | None:
    """Lock a place; None where the disk takes no file there: what is written next says why."""
    path = lock_file(place)
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = _opened(path)
        except OSError:
            return None
        if not _lock(handle, waiting=False, shared=shared):
            holder = _holder(handle)
            os.close(handle)
            raise HeldError(f"{printable(place)}: {holder}; wait for it, stop it, or choose another place")
        if _is_still(path, handle):
            break
        os.close(handle)  # its last holder has just removed it
    note = {"pid": os.getpid(), "host": platform.node(), "command": _command(), "since": time.strftime("%H:%M:%S")}
    with suppress(OSError):  # a full disk: it is held all the same
        os.ftruncate(handle, 0)
        os.lseek(handle, 0, os.SEEK_SET)
        os.write(handle, json.dumps(note).encode()[:_LONGEST_NOTE])
    return handle


def _opened(path: Path) -> int:
    """Open a lock's file: never what a link leads to, for in a folder of several people anybody can put one there.

    Raises OSError where there is anything but a plain file of one name.
    """
    flags = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | flags, 0o644)
    except PermissionError:  # somebody else's: it can be asked all the same
        handle = os.open(path, os.O_RDONLY | flags)
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
        os.close(handle)
        raise OSError(f"{path}: not a lock's file")
    return handle


def _let_go(path: Path, held: _Holding) -> None:
    if held.handle is None:
        return
    # Shared ones stay until the last of them goes. Windows removes no file that is open.
    if fcntl is not None and _lock(held.handle, waiting=False):
        with suppress(OSError):
            path.unlink(missing_ok=True)
    os.close(held.handle)
    with suppress(OSError):
        for folder in held.made:
            folder.rmdir()


def _command() -> str:
    """What this process was called with, as it is typed."""
    program, *arguments = sys.argv or [""]
    return shlex.join([Path(program).name or "python", *arguments])[: _LONGEST_NOTE // 2]


def _holder(handle: int) -> str:
    """Say who has a place, by what stands in its lock file: "process 4711 (gsrain street out) writes it since ..."."""
    try:
        note = json.loads(os.read(handle, _LONGEST_NOTE))
        pid, command, since, host = (note[name] for name in ("pid", "command", "since", "host"))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return "another process is writing it"
    where = "" if host == platform.node() else f" on {printable(host, 60)}"
    told = f"process {printable(pid, 20)}{where} ({printable(command, 200)})"
    return f"{told} has been writing it since {printable(since, 20)}"


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


def _lock(handle: int, *, waiting: bool, shared: bool = False) -> bool:
    """Lock an open file; False when somebody else has it. A disk that knows no locks lets everybody in."""
    try:
        if fcntl is not None:
            kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
            fcntl.flock(handle, kind if waiting else kind | fcntl.LOCK_NB)
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
    try:
        return path.stat().st_ino == os.fstat(handle).st_ino
    except OSError:
        return False
