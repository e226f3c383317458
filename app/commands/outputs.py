"""Files and folders that a command writes, looked at before its work: none of it is lost to a name or a place."""

import os
import stat
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path

from gsrain_engine.scene.file_lock import holding
from gsrain_engine.scene.file_names import name_problem, shortened

from .arguments import SCREEN

PAGES = (".html", ".htm")
"""Endings of reports."""


def check_scene_folder(output: Path) -> None:
    """Raise ValueError where a scene folder can't be written: the name of a file, a folder with other things in it."""
    from gsrain_engine.scene.formats.scene_files import names_scene_folder  # and NumPy, which no start waits for

    check_writable(folders=[output])
    if not names_scene_folder(output):
        folder = output.with_suffix("")
        raise ValueError(f"{output}: expected a scene folder, such as {folder}; gsrain convert makes files of it")
    if output.is_dir() and any(output.iterdir()) and not (output / "scene.json").is_file():
        raise ValueError(f"{output}: expected a new folder, or a scene folder to replace")


def check_scene_target(output: Path) -> None:
    """Raise ValueError where no scene can be written: as a folder, or as a file of a format that can be written."""
    from gsrain_engine.scene.formats.gaussian_files import check_written_format
    from gsrain_engine.scene.formats.scene_files import names_scene_folder

    _check_name(output)
    if names_scene_folder(output):
        check_scene_folder(output)
        return
    check_writable(output)
    check_written_format(output)


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


def check_writable(*files: Path | None, folders: Iterable[Path | None] = ()) -> None:
    """Raise ValueError for the first file or folder that could not be written; None and `SCREEN` are passed by.

    Names are looked at (their bytes, whether two are the same), what stands at the places (a folder where a file is to
    be, a file above), and whether the disk takes a new file there. Nothing is made.
    """
    named = [path for path in files if path is not None and path != SCREEN]
    kept = [path for path in folders if path is not None]
    for path in (*named, *kept):
        if str(path) in ("", ".") and path in named:
            raise ValueError("an empty name: expected the name of a file to write")
        _check_name(path)
    for path in named:
        _check_file(path)
    for path in kept:
        _check_folder(path)
    _check_apart(named, kept)


def check_ending(option: str, path: Path | None, endings: Sequence[str]) -> None:
    """Raise ValueError, which names the option, for a file whose name ends otherwise; None is passed by."""
    if path is not None and path.suffix.lower() not in endings:
        raise ValueError(f"{option} {path}: expected a name that ends in {_listed(endings)}")


def check_page(report: Path | None, json: Path | None, *files: Path | None) -> None:
    """Check a page of a run, and its numbers, which go to a file of its name where `json` names none, with `files`."""
    check_ending("--report", report, PAGES)
    numbers = report.with_suffix(".json") if report is not None and json is None else json
    check_writable(report, numbers, *files)


def check_picture(option: str, path: Path | None) -> None:
    """Raise ValueError for a picture in a format that can't be written; one without an ending becomes a PNG."""
    if path is None or path.suffix == "":
        return
    from PIL import Image  # loads slowly, and most who load this module draw no picture

    Image.init()
    known = Image.registered_extensions()
    if known.get(path.suffix.lower()) not in Image.SAVE:
        raise ValueError(f"{option} {path}: expected a picture, such as {path.with_suffix('.png')}")


def report_beside(output: Path, report: Path | None) -> Path:
    """Return where the report of a run goes: as asked for, else beside its scene."""
    check_ending("--report", report, PAGES)
    return report or output.with_name(f"{shortened(output.name)}.report.html")


def _check_name(path: Path) -> None:
    if (problem := name_problem(path)) is not None:
        raise ValueError(f"{_short(path)}: can't be written, for {problem}")


def _check_file(path: Path) -> None:
    place = Path(os.path.realpath(path))  # what a link leads to is replaced, not the link
    mode = _mode(place)
    if mode is not None and stat.S_ISDIR(mode):
        raise ValueError(f"{path}: can't be written, for it is a folder; expected the name of a file")
    if mode is not None and not stat.S_ISREG(mode):  # a device or a pipe is written to as it is
        if not os.access(place, os.W_OK):
            raise ValueError(f"{path}: can't be written to (permission denied)")
        return
    _check_takes_files(path, place.parent)


def _check_folder(path: Path) -> None:
    place = Path(os.path.realpath(path))
    mode = _mode(place)
    if mode is not None and not stat.S_ISDIR(mode):
        raise ValueError(f"{path}: can't be written, for it is a file; expected the name of a folder")
    _check_takes_files(path, place)


def _check_takes_files(path: Path, folder: Path) -> None:
    """Try to make a file in the next folder above that is there."""
    there = next((each for each in (folder, *folder.parents) if _mode(each) is not None), folder)
    if not stat.S_ISDIR(_mode(there) or 0):
        raise ValueError(f"{path}: can't be written, for {there} is a file")
    try:
        tempfile.TemporaryFile(dir=there).close()  # what may be written is only known to who tries
    except OSError as error:
        raise ValueError(f"{path}: can't be written, for {there} takes no file ({error.strerror})") from None


def _check_apart(files: Sequence[Path], folders: Sequence[Path]) -> None:
    """Raise ValueError where two outputs have one place, or one lies below a file."""
    regular = [each for each in files if stat.S_ISREG(_mode(each) or stat.S_IFREG)]
    places: dict[Path, Path] = {}
    for path in (*regular, *folders):
        place = Path(os.path.realpath(path))
        if place in places:
            raise ValueError(f"{path}: two outputs have this name; give one another")
        places[place] = path
    files_there = {Path(os.path.realpath(path)) for path in regular}
    for place, path in places.items():
        if (above := next((each for each in place.parents if each in files_there), None)) is not None:
            raise ValueError(f"{path}: can't be written, for {places[above]} is to be a file")


def _mode(path: Path) -> int | None:
    """Type and permissions of what stands there; None where nothing does, or nobody can say."""
    try:
        return path.stat().st_mode
    except (OSError, ValueError):
        return None


def _short(path: Path) -> str:
    """Return a path for a sentence: one too long for a disk is too long for that too."""
    text = str(path)
    return text if len(text) <= 80 else f"{text[:40]}...{text[-20:]}"


def _listed(endings: Sequence[str]) -> str:
    return endings[0] if len(endings) == 1 else f"{', '.join(endings[:-1])} or {endings[-1]}"
