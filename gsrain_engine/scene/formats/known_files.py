"""Which files of scene folders hold which Gaussians: what has not changed since need not be written again."""

from pathlib import Path
from typing import NamedTuple

from ..gaussians import Gaussians


class _Kept(NamedTuple):
    gaussians: Gaussians
    path: Path
    state: tuple[int, int, int]


class KnownFiles:
    """The Gaussians that were last read from, or written to, each folder. For one thread at a time.

    Gaussians are values, so the very same value has the very same bytes; a file that someone else has changed since is
    not trusted. Holds on to the Gaussians, which their scene does anyway, until the folder is written again.
    """

    def __init__(self) -> None:
        self._folders: dict[Path, list[_Kept]] = {}

    def remember(self, folder: Path, kept: list[tuple[Gaussians, Path]]) -> None:
        """Say which files of a folder hold which Gaussians; what was said of this folder before is forgotten."""
        self._folders[folder.resolve()] = [_Kept(gaussians, path, _state(path)) for gaussians, path in kept]

    def forget(self, folder: Path) -> None:
        """Trust no file of a folder any more."""
        self._folders.pop(folder.resolve(), None)

    def file_in(self, folder: Path, gaussians: Gaussians, taken: set[Path]) -> Path | None:
        """File of this folder with these very Gaussians, but for those that are taken; None where there is none."""
        files = self._files(self._folders.get(folder.resolve(), []), gaussians)
        return next((path for path in files if path not in taken), None)

    def file_anywhere(self, gaussians: Gaussians) -> Path | None:
        """File of any folder with these very Gaussians; None where there is none."""
        return next((path for kept in self._folders.values() for path in self._files(kept, gaussians)), None)

    def _files(self, kept: list[_Kept], gaussians: Gaussians) -> list[Path]:
        return [each.path for each in kept if each.gaussians is gaussians and _is_as_it_was(each)]


def _is_as_it_was(kept: _Kept) -> bool:
    try:
        return _state(kept.path) == kept.state
    except OSError:
        return False


def _state(path: Path) -> tuple[int, int, int]:
    status = path.stat()
    return status.st_mtime_ns, status.st_size, status.st_ino
