"""Output files of commands: checks before long work starts, locks, and numbers as JSON."""

import json
import os
import stat
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from gsrain_engine.report.numbers import write_json
from gsrain_engine.safe_io.file_names import name_problem, shortened
from gsrain_engine.safe_io.files import hold_for_writing

from .console import print, print_lines

if TYPE_CHECKING:
    from gsrain_engine.report.page import RunReport

SCREEN = Path("-")
"""Standard output in place of a file."""

PAGES = (".html", ".htm")
"""File extensions of reports."""


def claim_outputs(*files: Path | None, folders: Iterable[Path | None] = (), locked: Iterable[Path | None] = ()) -> None:
    """Check files and folders that a command will write, and lock the folders and `locked` files."""
    folders = list(folders)
    check_writable(*files, folders=folders)
    lock_outputs(*folders, *locked)


def check_writable(*files: Path | None, folders: Iterable[Path | None] = ()) -> None:
    """Raise ValueError for the first file or folder that could not be written; None and `SCREEN` are ignored.

    Checks names (their bytes, duplicates), existing entries (a folder in place of a file, a file as a parent), and
    whether the disk accepts a new file there. Nothing is created.
    """
    chosen = [path for path in files if path is not None and path != SCREEN]
    chosen_folders = [path for path in folders if path is not None]
    for path in (*chosen, *chosen_folders):
        if str(path) in ("", ".") and path in chosen:
            raise ValueError("an empty name: expected the name of a file to write")
        _check_name(path)
    for path in chosen:
        _check_file(path)
    for path in chosen_folders:
        place = Path(os.path.realpath(path))
        mode = _mode(place)
        if mode is not None and not stat.S_ISDIR(mode):
            raise ValueError(f"{path}: can't be written, for it is a file; expected the name of a folder")
        _check_takes_files(path, place)
    _check_apart(chosen, chosen_folders)


_locks = ExitStack()


def lock_outputs(*places: Path | None, shared: bool = False) -> None:
    """Lock files and folders that a command will write, until the command ends; None is ignored.

    Raises `PathInUseError`, which names the process, if another process holds one of them; `shared` locks may coexist.
    """
    for place in places:
        if place is not None and place != SCREEN:
            _locks.enter_context(hold_for_writing(place, shared=shared))


def release_outputs() -> None:
    _locks.close()


def check_scene_folder(output: Path) -> None:
    """Raise ValueError if a scene folder can't be written: a file name, or a folder with other contents."""
    from gsrain_engine.scene.formats.scene_files import names_scene_folder  # loads NumPy, which startup avoids

    check_writable(folders=[output])
    if not names_scene_folder(output):
        folder = output.with_suffix("")
        raise ValueError(f"{output}: expected a scene folder, such as {folder}; gsrain convert makes files of it")
    if output.is_dir() and any(output.iterdir()) and not (output / "scene.json").is_file():
        raise ValueError(f"{output}: expected a new folder, or a scene folder to replace")


def check_scene_target(output: Path) -> None:
    """Raise ValueError if no scene can be written there, as a folder or as a file of a writable format."""
    from gsrain_engine.scene.formats.registry import check_written_format
    from gsrain_engine.scene.formats.scene_files import names_scene_folder

    _check_name(output)
    if names_scene_folder(output):
        check_scene_folder(output)
        return
    check_writable(output)
    check_written_format(output)


def check_ending(option: str, path: Path | None, endings: Sequence[str]) -> None:
    """Raise ValueError, which names the option, for a file with another extension; None is ignored."""
    if path is not None and path.suffix.lower() not in endings:
        listed = " or ".join(filter(None, (", ".join(endings[:-1]), endings[-1])))
        raise ValueError(f"{option} {path}: expected a name that ends in {listed}")


def check_page(report: Path | None, json: Path | None, *files: Path | None) -> None:
    """Check a report page with its numbers, which are written next to it if `json` is None, and other `files`."""
    check_ending("--report", report, PAGES)
    numbers = report.with_suffix(".json") if report is not None and json is None else json
    check_writable(report, numbers, *files)


def check_image(option: str, path: Path | None) -> None:
    """Raise ValueError for an image format that can't be written; a name without an extension becomes a PNG."""
    if path is None or path.suffix == "":
        return
    from PIL import Image  # loads slowly, and few commands write images

    Image.init()
    if Image.registered_extensions().get(path.suffix.lower()) not in Image.SAVE:
        raise ValueError(f"{option} {path}: expected a picture, such as {path.with_suffix('.png')}")


def report_path(output: Path, report: Path | None) -> Path:
    """Return the path of the report of a run: as chosen, else next to its scene."""
    check_ending("--report", report, PAGES)
    return report or output.with_name(f"{shortened(output.name)}.report.html")


def _check_name(path: Path) -> None:
    if (problem := name_problem(path)) is not None:
        text = str(path)
        text = text if len(text) <= 80 else f"{text[:40]}...{text[-20:]}"
        raise ValueError(f"{text}: can't be written, for {problem}")


def _check_file(path: Path) -> None:
    place = Path(os.path.realpath(path))  # a link's target is replaced, not the link
    mode = _mode(place)
    if mode is not None and stat.S_ISDIR(mode):
        raise ValueError(f"{path}: can't be written, for it is a folder; expected the name of a file")
    if mode is not None and not stat.S_ISREG(mode):  # devices and pipes are written directly
        if not os.access(place, os.W_OK):
            raise ValueError(f"{path}: can't be written to (permission denied)")
        return
    _check_takes_files(path, place.parent)


def _check_takes_files(path: Path, folder: Path) -> None:
    """Try to create a file in the nearest existing parent folder."""
    there = next((each for each in (folder, *folder.parents) if _mode(each) is not None), folder)
    if not stat.S_ISDIR(_mode(there) or 0):
        raise ValueError(f"{path}: can't be written, for {there} is a file")
    try:
        tempfile.TemporaryFile(dir=there).close()  # only an attempt proves write access
    except OSError as error:
        raise ValueError(f"{path}: can't be written, for {there} takes no file ({error.strerror})") from None


def _check_apart(files: Sequence[Path], folders: Sequence[Path]) -> None:
    """Raise ValueError if two outputs share a path, or one lies below a file."""
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
    """Return type and permissions of a path; None if it doesn't exist or is not accessible."""
    try:
        return path.stat().st_mode
    except (OSError, ValueError):
        return None


# Numbers and reports


def write_numbers(file: Path | None, numbers: Mapping[str, Any]) -> None:
    """Write the numbers of a command as JSON, if a file is set; `SCREEN` prints them."""
    if file == SCREEN:
        print_lines(json.dumps(numbers, indent=1))
    elif file is not None:
        write_json(file, numbers)


def table_stream(file: Path | None) -> TextIO:
    """Return the stream for tables: standard output, unless the JSON numbers go there."""
    return sys.stderr if file == SCREEN else sys.stdout


def write_page(report: Path, page: "RunReport", json: Path | None, numbers: Mapping[str, Any]) -> None:
    """Write a report page, with its numbers next to it unless another file was chosen for them; prints the names."""
    from gsrain_engine.report.page import write_report

    write_report(report, page)
    written = [report] if json is not None else [report, report.with_suffix(".json")]
    for file in written[1:]:
        write_numbers(file, numbers)
    print(f"wrote {', '.join(map(str, written))}", file=sys.stderr)
