"""Disdrometer texts that other installed packages read: asked when no format of ours knows the lines."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gsrain_engine.extensions import DISDROMETERS, Extension, ExtensionError, loaded

from .reading import DisdrometerFileError, Reading


@dataclass(frozen=True, slots=True)
class LogFormat:
    """One kind of text that disdrometers write."""

    recognizes: Callable[[list[str]], bool]
    """Whether lines look like this kind: quick, and without an exception."""
    read: Callable[[Path, list[str]], Reading]
    """Read them; raises `DisdrometerFileError` where no record can be used."""


def read_by_packages(path: Path, lines: list[str]) -> Reading | None:
    """Read lines by the first installed package that knows them; None where none does.

    Raises `DisdrometerFileError` where that fails.
    """
    for extension, kind in loaded(DISDROMETERS, LogFormat):
        reading = _read(path, lines, extension, kind)
        if reading is not None:
            return reading
    return None


def _read(path: Path, lines: list[str], extension: Extension, kind: LogFormat) -> Reading | None:
    try:
        return extension.expect(kind.read(path, lines), Reading, "reads") if kind.recognizes(lines) else None
    except (DisdrometerFileError, OSError, MemoryError):
        raise
    except ExtensionError as error:
        raise DisdrometerFileError(path, str(error)) from error
    except Exception as error:  # it is code of others: its words are the reason
        raise DisdrometerFileError(path, str(extension.unfit(error))) from error
