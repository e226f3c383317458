"""Files and folders that appear whole or not at all: written beside their place, then renamed into it.

What writers that were killed have left beside a place goes when the next process writes there.
"""

import errno
import os
import re
import secrets
import shutil
import stat
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from .file_lock import holding, locked, locked_if_free

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
    beside = _beside(path)
    try:
        with telling_of(path, beside):
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

    Raises `OSError` that names `path` where the disk refuses, and `HeldError` where another process writes it; with
    `shared`, several may, and the first that is done has it.
    """
    with holding(path, shared=shared):
        yield from _renamed_in_the_end(path)


def _renamed_in_the_end(path: Path) -> Generator[Path]:
    remove_abandoned(path.parent)
    beside = _beside(path)
    try:
        with telling_of(path, beside):
            beside.mkdir()
            with locked(beside):
                yield beside
                sync(beside)
                beside.rename(path)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    sync(path.parent)


@contextmanager
def telling_of(path: Path, part: Path) -> Generator[None]:
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


def _beside(path: Path) -> Path:
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
    with locked_if_free(part) as is_free:
        touched = [each.stat().st_mtime for each in (part, *part.rglob("*"))]
        if not is_free or time.time() - max(touched) < _ABANDONED_S:
            return
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        else:
            part.unlink(missing_ok=True)
