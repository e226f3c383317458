"""Options, output checks and prompts shared by several commands."""

import json
import math
import os
import re
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, TextIO, TypeVar, get_args

import msgspec
from cyclopts import Parameter, Token, convert

from gsrain_engine.safe_io.errors import convert_checked
from gsrain_engine.scene.files import hold_for_writing, name_problem, shortened, whole_file
from gsrain_engine.trusted_code import Code, UntrustedCodeError, trust_permanently
from gsrain_engine.trusted_code import trust as trust_now

from .console import print, print_lines

JsonFile = Annotated[Path | None, Parameter(name="--json", help="Write the reported numbers to this file.")]

JsonFileOrScreen = Annotated[
    Path | None,
    Parameter(name="--json", help="Write the numbers to this file; - prints them.", allow_leading_hyphen=True),
]

AllowOutside = Annotated[
    bool,
    Parameter(
        name="--allow-outside",
        negative="",
        help="Read files that a capture's own files name outside of its folder: absolute, by .., or through links.",
    ),
]

SCREEN = Path("-")
"""Standard output in place of a file."""

_SIZE = re.compile(r"(\d+)x(\d+)")


def reject_non_finite(_kind: Any, value: Any) -> None:
    """Raise ValueError for NaN and infinity: no option accepts them.

    `value` is an option's value or a dataclass of options.
    """
    if is_dataclass(value):
        for field in fields(value):
            try:
                reject_non_finite(field.type, getattr(value, field.name))
            except ValueError as error:
                raise ValueError(f"--{field.name.replace('_', '-')}: {error}") from None
    elif isinstance(value, list | tuple):
        for each in value:
            reject_non_finite(_kind, each)
    elif isinstance(value, float) and not math.isfinite(value):
        raise ValueError("Expected a finite number.")


def parse_whole_numbers(kind: Any, tokens: Sequence[Token]) -> Any:
    """Convert words as cyclopts does, but raise ValueError for 1.5 as an integer instead of rounding."""
    for token in tokens if int in (kind, *get_args(kind)) else ():
        if "." in token.value:
            raise ValueError(f"{token.keyword} {token.value}: expected a whole number")
    return convert(kind, tokens)


def parse_size(text: str, option: str = "--size") -> tuple[int, int]:
    """Turn "960x640" into (960, 640)."""
    match = _SIZE.fullmatch(text)
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(1 <= side <= 16384 for side in size):
        raise ValueError(f"{option} {text}: expected WIDTHxHEIGHT with both within 1..16384, such as 960x640")
    return size


def split_list(option: str, text: str) -> list[str]:
    """Split at commas and drop duplicates. Raises ValueError for an empty word."""
    words = list(dict.fromkeys(word.strip() for word in text.split(",")))
    if not all(words):
        raise ValueError(f"{option} {text!r}: expected values with single commas between")
    return words


def write_numbers(file: Path | None, numbers: Mapping[str, Any]) -> None:
    """Write the numbers of a command as JSON, if a file is set; `SCREEN` prints them."""
    if file == SCREEN:
        print_lines(json.dumps(numbers, indent=1))
    elif file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(file) as beside:
            beside.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")


def let_names_lead_outside(allowed: bool) -> None:
    """Apply `AllowOutside` for the duration of the command."""
    if allowed:
        from gsrain_engine.datasets.capture import allow_outside  # only needed for captures

        allow_outside(allowed)


def table_stream(file: Path | None) -> TextIO:
    """Return the stream for tables: standard output, unless the JSON numbers go there."""
    return sys.stderr if file == SCREEN else sys.stdout


# Conversion of options with errors that name the option

RAIN_OPTIONS = {"intensity_mm_h": "rain", "exposure_s": "exposure"}
"""Rain options whose name differs from the field's, by field."""

_Kind = TypeVar("_Kind")
_WORD = re.compile(r"\w+")
_PLACE = re.compile(r" - at `\$.*?(\w+)(\[[^\]]*\])*`$")


def converted_options(values: Mapping[str, Any], kind: type[_Kind], options: Mapping[str, str] | None = None) -> _Kind:
    """Convert option values to a type known to msgspec. Raises ValueError, which names the option.

    `options` maps fields to option names without dashes where the two differ.
    """
    try:
        return convert_checked(values, kind)
    except msgspec.ValidationError as error:
        said = str(error)

    def named(field: str) -> str:
        return f"--{(options or {}).get(field, field).replace('_', '-')}"

    if place := _PLACE.search(said):
        raise ValueError(f"{named(place[1])}: {said[: place.start()]}")
    # Errors of a type's own checks name the fields: "last_s must be above first_s ..."
    raise ValueError(_WORD.sub(lambda word: named(word[0]) if word[0] in values else word[0], said))


# Checks of output files and folders before long work starts

PAGES = (".html", ".htm")
"""File extensions of reports."""


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


_held = ExitStack()


def lock_outputs(*places: Path | None, shared: bool = False) -> None:
    """Lock files and folders that a command will write, until the command ends; None is ignored.

    Raises `PathInUseError`, which names the process, if another process holds one of them; `shared` locks may coexist.
    """
    for place in places:
        if place is not None and place != SCREEN:
            _held.enter_context(hold_for_writing(place, shared=shared))


def release_outputs() -> None:
    _held.close()


def check_writable(*files: Path | None, folders: Iterable[Path | None] = ()) -> None:
    """Raise ValueError for the first file or folder that could not be written; None and `SCREEN` are ignored.

    Checks names (their bytes, duplicates), existing entries (a folder in place of a file, a file as a parent), and
    whether the disk accepts a new file there. Nothing is created.
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
    """Raise ValueError, which names the option, for a file with another extension; None is ignored."""
    if path is not None and path.suffix.lower() not in endings:
        raise ValueError(f"{option} {path}: expected a name that ends in {_listed(endings)}")


def check_page(report: Path | None, json: Path | None, *files: Path | None) -> None:
    """Check a report page with its numbers, which are written next to it if `json` is None, and other `files`."""
    check_ending("--report", report, PAGES)
    numbers = report.with_suffix(".json") if report is not None and json is None else json
    check_writable(report, numbers, *files)


def check_image(option: str, path: Path | None) -> None:
    """Raise ValueError for an image format that can't be written; a name without an extension becomes a PNG."""
    if path is None or path.suffix == "":
        return
    from PIL import Image  # loads slowly, and few commands draw images

    Image.init()
    known = Image.registered_extensions()
    if known.get(path.suffix.lower()) not in Image.SAVE:
        raise ValueError(f"{option} {path}: expected a picture, such as {path.with_suffix('.png')}")


def report_path(output: Path, report: Path | None) -> Path:
    """Return the path of the report of a run: as chosen, else next to its scene."""
    check_ending("--report", report, PAGES)
    return report or output.with_name(f"{shortened(output.name)}.report.html")


def _check_name(path: Path) -> None:
    if (problem := name_problem(path)) is not None:
        raise ValueError(f"{_short(path)}: can't be written, for {problem}")


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


def _check_folder(path: Path) -> None:
    place = Path(os.path.realpath(path))
    mode = _mode(place)
    if mode is not None and not stat.S_ISDIR(mode):
        raise ValueError(f"{path}: can't be written, for it is a file; expected the name of a folder")
    _check_takes_files(path, place)


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


def _short(path: Path) -> str:
    """Return a path, shortened for an error message."""
    text = str(path)
    return text if len(text) <= 80 else f"{text[:40]}...{text[-20:]}"


def _listed(endings: Sequence[str]) -> str:
    return endings[0] if len(endings) == 1 else f"{', '.join(endings[:-1])} or {endings[-1]}"


# Display


def has_display() -> bool:
    """Return True if a window can open; systems other than Linux always have a display."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


# Permission to run Python code that a file names, remembered by content hash

_Result = TypeVar("_Result")

Trust = Annotated[
    bool,
    Parameter(
        help="Run Python code that the file names (agents, programs of estimators) without asking. It can do all that "
        "you can: look at it before.",
        negative="",
    ),
]


def with_trust(load: Callable[[], _Result], trust: bool) -> _Result:
    """Return the result of `load`, asking for permission if it meets Python code that is not trusted yet.

    With `trust` the code may run this time. Otherwise the program asks in the terminal, and remembers a yes for exactly
    this content. Raises `UntrustedCodeError` without a terminal, or if the answer is no.
    """
    try:
        return load()
    except UntrustedCodeError as error:
        if trust:
            trust_now(each.digest for each in error.codes)
        elif _is_allowed(error):
            trust_permanently(error.codes)
        else:
            raise
    return load()


def _is_allowed(error: UntrustedCodeError) -> bool:
    if not all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr)):  # pyright: ignore
        return False
    print(f"{error.named_by} names Python code, which would run with all your rights:", file=sys.stderr)
    for code in error.codes:
        print(f"  {_described(code)}", file=sys.stderr)
    print("Run it? The answer is remembered for these very contents. [y/N]", file=sys.stderr)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _described(code: Code) -> str:
    others = code.others
    listed = ", ".join(others[:4]) + (f" and {len(others) - 4} more" if len(others) > 4 else "")
    return f"{code.path} (SHA-256 {code.digest})" + (f", with {listed}" if others else "")
