"""What several commands take on the command line."""

import json
import math
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, TextIO, get_args

from cyclopts import Parameter, Token, convert

from gsrain_engine.scene.atomic_files import whole_file

from ..console import print_lines

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
"""In the place of a file: standard output."""

_SIZE = re.compile(r"(\d+)x(\d+)")


def finite(_kind: Any, value: Any) -> None:
    """Raise ValueError for NaN and infinity: no option takes them.

    `value` is what an option was given, or a dataclass of options.
    """
    if is_dataclass(value):
        for field in fields(value):
            try:
                finite(field.type, getattr(value, field.name))
            except ValueError as error:
                raise ValueError(f"--{field.name.replace('_', '-')}: {error}") from None
    elif isinstance(value, list | tuple):
        for each in value:
            finite(_kind, each)
    elif isinstance(value, float) and not math.isfinite(value):
        raise ValueError("Expected a finite number.")


def whole_or_else(kind: Any, tokens: Sequence[Token]) -> Any:
    """Turn words into what an option takes, as cyclopts does; but it would round 1.5 where whole numbers are wanted."""
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


def listed(option: str, text: str) -> list[str]:
    """Split at commas; what stands there twice is taken once. Raises ValueError for an empty word."""
    words = list(dict.fromkeys(word.strip() for word in text.split(",")))
    if not all(words):
        raise ValueError(f"{option} {text!r}: expected values with single commas between")
    return words


def write_numbers(file: Path | None, numbers: Mapping[str, Any]) -> None:
    """Write what a command reports as JSON, if it was asked to; `SCREEN` prints it."""
    if file == SCREEN:
        print_lines(json.dumps(numbers, indent=1))
    elif file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(file) as beside:
            beside.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")


def let_names_lead_outside(allowed: bool) -> None:
    """Act on `AllowOutside`, for as long as the command runs."""
    if allowed:
        from gsrain_engine.datasets.files.inside import allow_outside  # only for captures

        allow_outside(allowed)


def words_go_to(file: Path | None) -> TextIO:
    """Return where tables for people go: standard output, unless that is for the numbers."""
    return sys.stderr if file == SCREEN else sys.stdout
