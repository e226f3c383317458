"""Which files of scene folders hold which Gaussians or wet colours: what has not changed need not be written again."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from ..gaussians import Gaussians

Contents = Gaussians | Float32[np.ndarray, "_ _ 3"]
"""What one file holds: Gaussians, or harmonics by themselves. Both are values."""


class _Kept(NamedTuple):
    contents: Contents
    path: Path
    state: tuple[int, int, int]


class KnownFiles:
    """What was last read from, or written to, each folder. For one thread at a time.

    The very same value has the very same bytes; a file that someone else has changed since is not trusted. Holds on to
    the values, which their scene does anyway, until the folder is written again.
    """

    def __init__(self) -> None:
        self._folders: dict[Path, list[_Kept]] = {}

    def remember(self, folder: Path, kept: list[tuple[Contents, Path]]) -> None:
        """Say which files of a folder hold which values; what was said of this folder before is forgotten."""
        self._folders[folder.resolve()] = [_Kept(contents, path, _state(path)) for contents, path in kept]

    def forget(self, folder: Path) -> None:
        """Trust no file of a folder any more."""
        self._folders.pop(folder.resolve(), None)

    def file_in(self, folder: Path, contents: Contents, taken: set[Path]) -> Path | None:
        """File of this folder with these very values, but for those that are taken; None where there is none."""
        files = self._files(self._folders.get(folder.resolve(), []), contents)
        return next((path for path in files if path not in taken), None)

    def file_anywhere(self, contents: Contents) -> Path | None:
        """File of any folder with these very values; None where there is none."""
        return next((path for kept in self._folders.values() for path in self._files(kept, contents)), None)

    def _files(self, kept: list[_Kept], contents: Contents) -> list[Path]:
        return [each.path for each in kept if each.contents is contents and _is_as_it_was(each)]


def _is_as_it_was(kept: _Kept) -> bool:
    try:
        return _state(kept.path) == kept.state
    except OSError:
        return False


def _state(path: Path) -> tuple[int, int, int]:
    status = path.stat()
    return status.st_mtime_ns, status.st_size, status.st_ino
