"""Atomic writes, locks between processes, and JSON input.

Files and folders are written next to their path, then renamed to it; the remains of killed writers are removed when the
next process writes there.
"""

import errno
import json
import os
import platform
import re
import secrets
import shlex
import shutil
import stat
import sys
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .errors import SceneFormatError
from .file_names import shortened
from .limits import read_input, reader_of_pipe
from .text_files import printable_line

_PART = re.compile(r"\..*\.[0-9a-f]{8}\.part", re.DOTALL)  # names that only this program uses
_LONGEST_NAME = 200  # bytes of a file's name in the name of its partial file; file systems accept 255
_ABANDONED_S = 600.0  # age after which an unlocked partial file counts as abandoned
_HALF_WRITTEN = re.compile(r"\d+ requested and \d+ written|encoder error")
"""Messages of NumPy and Pillow for a full disk: their libraries omit the cause."""

_tidied: set[Path] = set()  # folders already cleared of abandoned partial files by this process; once is enough


@contextmanager
def whole_file(path: Path) -> Generator[Path]:
    """Yield a path next to `path` to write to; it replaces `path` when the block ends without an error.

    Until then, and if the block fails, the old file stays untouched; the new one inherits its permissions. If `path` is
    a link, its target is replaced. A device or a pipe is written directly. Creates missing folders.

    Raises `OSError` that names `path` if the file system refuses.
    """
    path = path.resolve() if path.is_symlink() else path
    if _is_special(path):
        with reader_of_pipe(path) if path.is_fifo() else nullcontext():
            yield path
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_abandoned(path.parent)
    beside = _temporary_path(path)
    try:
        with naming_path(path, beside):
            yield beside
            sync(beside)
            with suppress(OSError):  # a new file has no permissions to inherit
                beside.chmod(stat.S_IMODE(path.stat().st_mode))
            beside.replace(path)
    finally:
        with suppress(OSError):  # the earlier error is more informative
            beside.unlink(missing_ok=True)
    sync(path.parent)


@contextmanager
def whole_folder(path: Path, *, shared: bool = False) -> Generator[Path]:
    """Yield a new folder next to `path`; when the block ends, it becomes `path`, which must be missing or empty.

    Raises `OSError` that names `path` if the file system refuses, and `PathInUseError` if another process writes it;
    with `shared`, several processes may write it, and the first to finish wins.
    """
    with hold_for_writing(path, shared=shared):
        remove_abandoned(path.parent)
        beside = _temporary_path(path)
        try:
            with naming_path(path, beside):
                beside.mkdir()
                with lock_path(beside):
                    yield beside
                    sync(beside)
                    beside.rename(path)
        finally:
            shutil.rmtree(beside, ignore_errors=True)
        sync(path.parent)


@contextmanager
def naming_path(path: Path, part: Path) -> Generator[None]:
    """Make I/O errors in the block name `path` instead of no file, of `part`, or of a file inside it."""
    try:
        yield
    except OSError as error:
        if error.errno is None and _HALF_WRITTEN.search(str(error)):
            raise OSError(
                errno.ENOSPC, "the disk took only a part of it; is there no space left?", str(path)
            ) from error
        named = str(part) if error.filename is None else str(error.filename)
        if error.errno is None or not named.startswith(str(part)):
            raise
        raise OSError(error.errno, error.strerror or os.strerror(error.errno), str(path)) from error


def remove_abandoned(folder: Path) -> None:
    """Remove partial files of killed writers from a folder; once per process."""
    if folder in _tidied:
        return
    _tidied.add(folder)
    with suppress(OSError):
        for entry in list(os.scandir(folder)):
            if _PART.fullmatch(entry.name):
                _remove_if_abandoned(folder / entry.name)


def sync(path: Path) -> None:
    """Flush a file's bytes, or a folder's entries, to the disk."""
    if path.is_dir() and os.name != "posix":
        return  # folders can't be opened on Windows
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _temporary_path(path: Path) -> Path:
    # Drop characters outside the locale's character set: such a name could not be written.
    name = os.fsencode(path.name)[:_LONGEST_NAME].decode(sys.getfilesystemencoding(), errors="ignore")
    return path.with_name(f".{name}.{secrets.token_hex(4)}.part")


def _is_special(path: Path) -> bool:
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _remove_if_abandoned(part: Path) -> None:
    with lock_path(part, waiting=False) as is_free:
        touched = [each.stat().st_mtime for each in (part, *part.rglob("*"))]
        if not is_free or time.time() - max(touched) < _ABANDONED_S:
            return
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        else:
            part.unlink(missing_ok=True)


# Locks between processes
# The system releases them when their holder dies for any reason.

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

_WITHOUT_WAITING = getattr(os, "O_NONBLOCK", 0)
"""Opening a pipe of that name would otherwise block until its other end is opened."""


class FileLock:
    """A lock held from `take` until `release`, or until the process ends."""

    def __init__(self, path: Path, handle: int) -> None:
        self._path = path
        self._handle = handle

    @staticmethod
    def take(path: Path) -> "FileLock | None":
        """Lock a file, which is created if missing; None while it is locked elsewhere, in this process too.

        Raises `OSError` if the file can't be created.
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
        if self._handle < 0:
            return
        if fcntl is not None:  # Windows can't remove an open file
            self._path.unlink(missing_ok=True)
        os.close(self._handle)
        self._handle = -1


class PathInUseError(OSError):
    """A path that another process writes to; the message names that process and its command."""


@dataclass
class _HeldPath:
    """A path that this process writes to, with the count of its nested holds."""

    handle: int | None
    made: tuple[Path, ...]
    """Folders created for the lock, innermost first; removed with it if nothing was written."""
    count: int = 1


_guard, _holdings = threading.Lock(), dict[Path, _HeldPath]()


@contextmanager
def hold_for_writing(path: Path, *, shared: bool = False) -> Generator[None]:
    """Reserve a file or folder, which need not exist, for writing by this process while the block runs.

    The lock is a file next to it, `.NAME.lock`, with the process's id and command; it is removed in the end, and one
    left by a killed process is taken over. A process may hold a path several times. Processes that write to one path
    together, as the shares of a sweep, hold it `shared`.

    Raises `PathInUseError` at once if another process holds it.
    """
    place = path.resolve()
    with _guard:
        if place in _holdings:
            _holdings[place].count += 1
        else:
            missing = tuple(each for each in place.parents if not each.exists())
            _holdings[place] = _HeldPath(_try_lock(place, shared), missing)
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
    return path.with_name(f".{shortened(path.name, _LONGEST_NAME)}.lock")


_LONGEST_NOTE = 4096


def _try_lock(place: Path, shared: bool) -> int | None:
    """Lock a path; None if the file system accepts no lock file, as the write that follows then reports the reason."""
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
            raise PathInUseError(f"{printable_line(place)}: {holder}; wait for it, stop it, or choose another place")
        if _is_still(path, handle):
            break
        os.close(handle)  # its last holder has just removed it
    note = {"pid": os.getpid(), "host": platform.node(), "command": _command(), "since": time.strftime("%H:%M:%S")}
    with suppress(OSError):  # on a full disk the lock holds without its text
        os.ftruncate(handle, 0)
        os.lseek(handle, 0, os.SEEK_SET)
        os.write(handle, json.dumps(note).encode()[:_LONGEST_NOTE])
    return handle


def _opened(path: Path) -> int:
    """Open a lock file without following links: in a shared folder anybody could place one there.

    Raises OSError for anything but a regular file with one name.
    """
    flags = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | flags, 0o644)
    except PermissionError:  # another user's lock can still be tested
        handle = os.open(path, os.O_RDONLY | flags)
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
        os.close(handle)
        raise OSError(f"{path}: not a lock's file")
    return handle


def _let_go(path: Path, held: _HeldPath) -> None:
    if held.handle is None:
        return
    # Shared locks stay until the last holder releases them. Windows can't remove an open file.
    if fcntl is not None and _lock(held.handle, waiting=False):
        with suppress(OSError):
            path.unlink(missing_ok=True)
    os.close(held.handle)
    with suppress(OSError):
        for folder in held.made:
            folder.rmdir()


def _command() -> str:
    program, *arguments = sys.argv or [""]
    return shlex.join([Path(program).name or "python", *arguments])[: _LONGEST_NOTE // 2]


def _holder(handle: int) -> str:
    """Describe a path's holder from its lock file: "process 4711 (gsrain street out) writes it since ..."."""
    try:
        note = json.loads(os.read(handle, _LONGEST_NOTE))
        pid, command, since, host = (note[name] for name in ("pid", "command", "since", "host"))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return "another process is writing it"
    where = "" if host == platform.node() else f" on {printable_line(host, 60)}"
    told = f"process {printable_line(pid, 20)}{where} ({printable_line(command, 200)})"
    return f"{told} has been writing it since {printable_line(since, 20)}"


@contextmanager
def lock_path(path: Path, *, waiting: bool = True) -> Generator[bool]:
    """Lock an existing file or folder; yields True.

    Waits for other holders, or, without `waiting`, yields False if there is one. No effect on operating systems and
    file systems without locks.
    """
    if fcntl is None and (path.is_dir() or not waiting):
        yield True
        return
    flags = os.O_RDWR if waiting and not path.is_dir() else os.O_RDONLY
    handle = os.open(path, flags | _WITHOUT_WAITING)
    try:
        yield _lock(handle, waiting=waiting)
    finally:
        os.close(handle)


def _lock(handle: int, *, waiting: bool, shared: bool = False) -> bool:
    """Lock an open file; False if it is locked elsewhere. Always succeeds on file systems without locks."""
    try:
        if fcntl is not None:
            kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
            fcntl.flock(handle, kind if waiting else kind | fcntl.LOCK_NB)
        else:
            import msvcrt  # pyright: ignore

            msvcrt.locking(handle, msvcrt.LK_LOCK if waiting else msvcrt.LK_NBLCK, 1)  # pyright: ignore
    except BlockingIOError:
        return False
    except PermissionError:  # Windows' error for a locked file
        return False
    except OSError:
        return True
    return True


def _is_still(path: Path, handle: int) -> bool:
    try:
        return path.stat().st_ino == os.fstat(handle).st_ino
    except OSError:
        return False


# JSON input

_MAX_BYTES = 1 << 28  # an hour's path with a keyframe for each of 30 frames per second takes 30 MB


def read_json(path: Path | str) -> Any:
    """Read a JSON file or pipe; `SceneFormatError` if it is missing, invalid, too deeply nested or too large."""
    try:
        return json.loads(read_input(path, _MAX_BYTES).decode("utf-8-sig"))
    except OSError as error:
        raise SceneFormatError(path, f"can't be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:  # also invalid UTF-8, and integers of thousands of digits
        raise SceneFormatError(path, f"not a JSON file: {error}") from None
