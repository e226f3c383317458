"""Names of files that stand in files of captures: none may lead out of the capture's folder, unless that is allowed."""

import os
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from ..capture import CaptureError

_LONGEST_NAME = 200
"""Signs of a name in a sentence."""

_allowed: ContextVar[bool] = ContextVar("outside_allowed", default=False)


class OutsideError(CaptureError):
    """A file of a capture names a file outside the capture's folder."""


def allow_outside(allowed: bool) -> None:
    """Let names lead anywhere, or nowhere but below the capture's folder, for the rest of this context."""
    _allowed.set(allowed)


@contextmanager
def outside_allowed(allowed: bool | None) -> Generator[None]:
    """Let names lead anywhere (True) or not (False) in this block; None leaves it as it is."""
    token = _allowed.set(_allowed.get() if allowed is None else allowed)
    try:
        yield
    finally:
        _allowed.reset(token)


def check_inside(folder: Path, names: Iterable[str], source: Path) -> None:
    """Look where names lead that stand in the file `source` and are meant from `folder` on.

    Raises `OutsideError` for the first one that leads out of it: absolute, by "..", or through a link; unless that is
    allowed. What can't be a name of a file at all is left to who reads it.
    """
    if _allowed.get():
        return
    home = Path(os.path.realpath(folder))
    parents: dict[Path, Path] = {}
    for name in dict.fromkeys(names):
        if "\0" in name:
            continue
        path = folder / name
        if path.parent not in parents:
            parents[path.parent] = Path(os.path.realpath(path.parent))
        real = parents[path.parent] / path.name
        try:
            is_elsewhere = path.name in ("", "..") or real.is_symlink()
        except OSError:  # longer than any name
            continue
        if is_elsewhere:
            real = Path(os.path.realpath(real))
        if not real.is_relative_to(home):
            shown = name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}..."
            raise OutsideError(
                f"{source}: names {shown!r}, which leads out of {folder}; --allow-outside reads such files all the same"
            )
