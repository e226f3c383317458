"""What several commands take on the command line."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

JsonFile = Annotated[Path | None, Parameter(name="--json", help="Write the reported numbers to this file.")]

_SIZE = re.compile(r"(\d+)x(\d+)")


def parse_size(text: str, option: str = "--size") -> tuple[int, int]:
    """Turn "960x640" into (960, 640)."""
    match = _SIZE.fullmatch(text)
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(1 <= side <= 16384 for side in size):
        raise ValueError(f"{option} {text}: expected WIDTHxHEIGHT with both within 1..16384, such as 960x640")
    return size


def write_numbers(file: Path | None, numbers: Mapping[str, Any]) -> None:
    """Write what a command reports as JSON, if it was asked to."""
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
