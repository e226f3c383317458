"""Files and folders that appear whole or not at all: written beside their place, then renamed into it.

What writers that were killed have left beside a place goes when the next process writes there.
"""

import errno
import hashlib
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
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..safe_io.limits import read_input
from ..safe_io.text_files import printable_line

_PART = re.compile(r"\..*\.[0-9a-f]{8}\.part", re.DOTALL)
"""Names that only we give."""

_LONGEST_NAME = 200
"""Bytes of a file's name that go into that of its part; disks take 255."""

_ABANDONED_S = 600.0
"""What nobody has touched for so long, and nobody holds, nobody writes any more."""

_HALF_WRITTEN = re.compile(r"\d+ requested and \d+ written|encoder error")
"""What NumPy and Pillow say of a disk that is full: their libraries don't tell them why."""

_tidied: set[Path] = set()
"""Folders that this process has rid of abandoned parts: to look once is enough."""


@contextmanager
def whole_file(path: Path) -> Generator[Path]:
    """Give a path beside `path` to write to; it takes the place of `path` once the block has ended without an error.

    What stood at `path` is untouched until then, and for good when the block fails; its permissions stay. Where a link
    stands there, what it leads to is replaced. A device or a pipe is written to as it is. Missing folders are made.

    Raises `OSError` that names `path` where the disk refuses.
    """
    path = path.resolve() if path.is_symlink() else path
    if _is_special(path):
        yield path
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_abandoned(path.parent)
    beside = _temporary_path(path)
    try:
        with naming_path(path, beside):
            yield beside
            sync(beside)
            with suppress(OSError):  # a new file has none to keep
                beside.chmod(stat.S_IMODE(path.stat().st_mode))
            beside.replace(path)
    finally:
        with suppress(OSError):  # what went wrong before says more
            beside.unlink(missing_ok=True)
    sync(path.parent)


@contextmanager
def whole_folder(path: Path, *, shared: bool = False) -> Generator[Path]:
    """Give a new folder beside `path`; it becomes `path`, which may not exist or be empty, once the block has ended.

    Raises `OSError` that names `path` where the disk refuses, and `PathInUseError` where another process writes it;
    with `shared`, several may, and the first that is done has it.
    """
    with hold_for_writing(path, shared=shared):
        yield from _renamed_in_the_end(path)


def _renamed_in_the_end(path: Path) -> Generator[Path]:
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
    """Let what a disk refuses in the block name `path`, where it names no file, or `part` and what is in it."""
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
    """Remove the parts in a folder that nobody goes on with, their writers having been killed; once a process."""
    if folder in _tidied:
        return
    _tidied.add(folder)
    with suppress(OSError):
        for entry in list(os.scandir(folder)):
            if _PART.fullmatch(entry.name):
                _remove_if_abandoned(folder / entry.name)


def sync(path: Path) -> None:
    """Wait until a file's bytes, or the names in a folder, are on the disk."""
    if path.is_dir() and os.name != "posix":
        return  # folders can't be opened there
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _temporary_path(path: Path) -> Path:
    # What a locale's character set can't say goes: a name made of it could not be written.
    name = os.fsencode(path.name)[:_LONGEST_NAME].decode(sys.getfilesystemencoding(), errors="ignore")
    return path.with_name(f".{name}.{secrets.token_hex(4)}.part")


def _is_special(path: Path) -> bool:
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _remove_if_abandoned(part: Path) -> None:
    with try_lock_path(part) as is_free:
        touched = [each.stat().st_mtime for each in (part, *part.rglob("*"))]
        if not is_free or time.time() - max(touched) < _ABANDONED_S:
            return
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        else:
            part.unlink(missing_ok=True)


# § Locks between processes: the system lets go of them when their holder dies, however it dies.

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


class PathInUseError(OSError):
    """A place that another process writes to: says which process that is, and what it was called with."""


@dataclass
class _HeldPath:
    """A place that this process writes to, and how often it has begun to."""

    handle: int | None
    made: tuple[Path, ...]
    """Folders that were made for the lock, the innermost first; they go with it where nothing was written."""
    count: int = 1


_guard, _holdings = threading.Lock(), dict[Path, _HeldPath]()


@contextmanager
def hold_for_writing(path: Path, *, shared: bool = False) -> Generator[None]:
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
    """Return the file by which a place is held."""
    name = path.name.encode(errors="surrogateescape")
    if len(name) <= _LONGEST_NAME:
        return path.with_name(f".{path.name}.lock")
    short = name[:_LONGEST_NAME].decode(errors="ignore")
    return path.with_name(f".{short}.{hashlib.sha256(name).hexdigest()[:8]}.lock")


_LONGEST_NOTE = 4096


def _try_lock(place: Path, shared: bool) -> int | None:
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
            raise PathInUseError(f"{printable_line(place)}: {holder}; wait for it, stop it, or choose another place")
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


def _let_go(path: Path, held: _HeldPath) -> None:
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
    where = "" if host == platform.node() else f" on {printable_line(host, 60)}"
    told = f"process {printable_line(pid, 20)}{where} ({printable_line(command, 200)})"
    return f"{told} has been writing it since {printable_line(since, 20)}"


@contextmanager
def lock_path(path: Path) -> Generator[None]:
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
def try_lock_path(path: Path) -> Generator[bool]:
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


# § Reads JSON that may be damaged, or made to exhaust who reads it; what is wrong with it is one sentence.

_MAX_BYTES = 1 << 28
"""A path of an hour with a key for each of 30 frames a second has 30 MB."""


def read_json(path: Path | str) -> Any:
    """Read a JSON file, or a pipe of one; `SceneFormatError` where it is missing, no JSON, nested without end, huge."""
    try:
        return json.loads(read_input(path, _MAX_BYTES).decode("utf-8"))
    except OSError as error:
        raise SceneFormatError(path, f"can't be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:  # also no UTF-8, and integers of thousands of digits
        raise SceneFormatError(path, f"not a JSON file: {error}") from None


# § What goes wrong with a scene, in one sentence that a person can act on.


class SceneFormatError(ValueError):
    """A scene file that can't be read: names the file, the field and what would be right."""

    def __init__(self, path: Path | str, problem: str) -> None:
        super().__init__(f"{printable_line(path)}: {printable_line(problem)}")
        self.path = Path(path)
        self.problem = problem


def sentence_of(error: BaseException) -> str:
    """What an error says; what a disk says without its number, and with the file first."""
    if isinstance(error, OSError) and error.strerror is not None:
        return error.strerror if error.filename is None else f"{printable_line(error.filename)}: {error.strerror}"
    return str(error) or type(error).__name__


# § Names of files to be written: those that a disk takes, and long ones that are derived from names of people's own.

DEFAULT_NAME_BYTES = 255
"""That a name may have on nearly all disks; some that encrypt take 143."""

_MAX_PATH_BYTES = 4096

_PART_BYTES = 64
"""Of a path that stay free for what is written for a while on the way to it, and for numbered files in it."""

_STEM_BYTES = 160
"""Of a derived name without its ending: passes, cameras and hashes may be added."""

_HASH_DIGITS = 8

_IMPOSSIBLE = re.compile(r'[\\/:*?"<>|\x00-\x1f\x7f]+')


def file_word(name: str, max_bytes: int = _STEM_BYTES) -> str:
    """Return a name as part of a file's: what would lead into another folder, or nowhere, becomes a dash.

    One of more than `max_bytes` is `shortened`.
    """
    return shortened(_IMPOSSIBLE.sub("-", name).lstrip(".") or "-", max_bytes)


def shortened(name: str, max_bytes: int = _STEM_BYTES) -> str:
    """Return a name of at most so many bytes: one that is longer is cut, and ends in a hash of the whole.

    Names of the same beginning stay apart, and the same name gives the same word everywhere.
    """
    whole = _bytes(name)
    if len(whole) <= max_bytes:
        return os.fsdecode(whole)
    digest = hashlib.blake2b(whole, digest_size=_HASH_DIGITS // 2).hexdigest()
    return f"{whole[: max_bytes - _HASH_DIGITS - 1].decode(sys.getfilesystemencoding(), errors='ignore')}-{digest}"


def name_problem(path: Path) -> str | None:
    """Return what a disk has against the name of a file or folder that is to be written; None where nothing."""
    if "\0" in str(path):
        return "a name can't hold a zero byte"
    try:
        os.fsencode(path)
    except UnicodeEncodeError as error:
        sign = repr(error.object[error.start : error.end])
        return f"the character set of this system ({error.encoding}) lacks {sign}; set LC_ALL=C.UTF-8"
    place = Path(os.path.abspath(path))  # noqa: PTH100  that of Path keeps `..`, which counts
    max_bytes = _max_name_bytes(place.parent)
    for part in place.parts[1:]:
        if (size := len(os.fsencode(part))) > max_bytes:
            return f"the name {printable_line(part[:24])}... has {size} bytes, and the disk takes {max_bytes}"
    if (size := len(os.fsencode(place))) > _MAX_PATH_BYTES - _PART_BYTES:
        return f"the path has {size} bytes, and the disk takes {_MAX_PATH_BYTES - _PART_BYTES}"
    return None


def _max_name_bytes(folder: Path) -> int:
    """Bytes that a name in a folder may have, by the next folder above it that is there."""
    for each in (folder, *folder.parents):
        try:
            return os.pathconf(each, "PC_NAME_MAX")
        except (OSError, ValueError, AttributeError):  # not there, or a system that has none
            continue
    return DEFAULT_NAME_BYTES


def _bytes(name: str) -> bytes:
    try:
        return os.fsencode(name)
    except UnicodeEncodeError:  # half of a pair of UTF-16, which no file's name can hold
        return name.encode(errors="replace")
