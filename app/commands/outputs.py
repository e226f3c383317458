"""What commands write: looked at before the work, for after an hour of it nobody wants to hear that it can't be."""

import tempfile
from contextlib import ExitStack
from pathlib import Path

from gsrain_engine.scene.file_lock import holding
from gsrain_engine.scene.formats.scene_files import names_scene_folder

from .arguments import SCREEN


def check_scene_folder(output: Path) -> None:
    """Raise ValueError where a scene folder can't be written: the name of a file, a folder with other things in it."""
    if not names_scene_folder(output):
        folder = output.with_suffix("")
        raise ValueError(f"{output}: expected a scene folder, such as {folder}; gsrain convert makes files of it")
    if output.is_file() or (output.is_dir() and any(output.iterdir()) and not (output / "scene.json").is_file()):
        raise ValueError(f"{output}: expected a new folder, or a scene folder to replace")
    check_writable(output)


_held = ExitStack()


def hold(*places: Path | None, shared: bool = False) -> None:
    """Have files and folders that a command will write for this process, until the command ends; None is passed by.

    Raises `HeldError`, which names the process, where another one has one of them; `shared` ones may have it together.
    """
    for place in places:
        if place is not None and place != SCREEN:
            _held.enter_context(holding(place, shared=shared))


def release() -> None:
    """Let others have all that a command has held."""
    _held.close()


def check_writable(*paths: Path | None) -> None:
    """Raise ValueError for the first place at which nothing can be written; None and `SCREEN` are passed by."""
    for path in paths:
        if path is None or path == SCREEN:
            continue
        there = next(each for each in (path.absolute().parent, *path.absolute().parents) if each.exists())
        if not there.is_dir():
            raise ValueError(f"{path}: can't be written, for {there} is a file")
        try:
            tempfile.TemporaryFile(dir=there).close()  # what may be written is only known to who tries
        except OSError as error:
            raise ValueError(f"{path}: can't be written, for {there} takes no file ({error.strerror})") from None


def report_beside(output: Path, report: Path | None) -> Path:
    """Where the report of a run goes: as asked for, else beside its scene."""
    return report or output.with_name(f"{output.name}.report.html")
