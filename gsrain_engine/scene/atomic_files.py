"""Files and folders that appear whole or not at all: written beside their place, then renamed into it."""

import os
import secrets
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Generator[Path]:
    """Give a path beside `path` to write to; it takes the place of `path` once the block has ended without an error.

    What stood at `path` is untouched until then, and for good when the block fails.
    """
    beside = _beside(path)
    try:
        yield beside
        sync(beside)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
    sync(path.parent)


@contextmanager
def whole_folder(path: Path) -> Generator[Path]:
    """Give a new folder beside `path`; it becomes `path`, which may not exist or be empty, once the block has ended."""
    beside = _beside(path)
    beside.mkdir()
    try:
        yield beside
        sync(beside)
        beside.rename(path)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    sync(path.parent)


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
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
