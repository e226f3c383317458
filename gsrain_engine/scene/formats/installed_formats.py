"""Scene formats of other installed packages: found by the suffix, loaded when a file has it, checked like ours."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from gsrain_engine.extensions import SCENE_FORMATS, Extension, ExtensionError, extensions

from ..errors import SceneFormatError
from ..gaussians import Gaussians
from .checks import checked_gaussians
from .format import Format


def installed_suffixes() -> tuple[str, ...]:
    """Return the suffixes, with their dots, that installed packages read."""
    return tuple(f".{each.name.lower()}" for each in extensions(SCENE_FORMATS))


def installed_format(path: Path) -> Format | None:
    """Return the format of another package that a file's name belongs to; None where there is none.

    Raises `SceneFormatError` where the package can't be used.
    """
    for each, suffix in zip(extensions(SCENE_FORMATS), installed_suffixes(), strict=True):
        if path.name.lower().endswith(suffix):
            try:
                return _guarded(each, _checked(each, each.load(Format), suffix))
            except ExtensionError as error:
                raise SceneFormatError(path, str(error)) from error
    return None


def _checked(extension: Extension, row: Format, suffix: str) -> Format:
    if row.suffix != suffix:
        raise extension.unfit(f"its suffix is {row.suffix!r}, its name asks for {suffix!r}")
    return row


def _guarded(extension: Extension, row: Format) -> Format:
    """Let code of others fail in one sentence, and give arrays such as our own readers give."""

    def read(path: Path) -> Gaussians:
        with _told(extension, path):
            found = extension.expect(row.read(path), Gaussians, "reads")
        fields = found.means, found.scales, found.quaternions, found.opacities, found.sh
        return checked_gaussians(path, *(np.array(each, np.float32, order="C") for each in fields))

    return row._replace(read=read, write=None if row.write is None else partial(_written, extension, row.write))


def _written(extension: Extension, write: Callable[[Gaussians, Path], None], gaussians: Gaussians, path: Path) -> None:
    with _told(extension, path):
        write(gaussians, path)


@contextmanager
def _told(extension: Extension, path: Path) -> Generator[None]:
    """Turn whatever others raise into one sentence."""
    try:
        yield
    except (SceneFormatError, OSError, MemoryError):
        raise
    except ExtensionError as error:
        raise SceneFormatError(path, str(error)) from error
    except Exception as error:
        raise SceneFormatError(path, str(extension.unfit(error))) from error
