"""Reads JSON files of data sets; what is wrong with them is said with their names."""

import json
from pathlib import Path
from typing import Any

from gsrain_engine.untrusted.limits import InputError, read_file

from ..capture import CaptureError

_MAX_BYTES = 1 << 30


def read_json(file: Path) -> Any:
    """Read a JSON file; `CaptureError` that names it where it is missing, broken or larger than 1 GB."""
    try:
        return json.loads(read_file(file, _MAX_BYTES).decode("utf-8"))
    except FileNotFoundError:
        raise CaptureError(f"{file}: no such file") from None
    except InputError as error:
        raise CaptureError(str(error)) from None
    except (OSError, ValueError, RecursionError) as error:
        raise CaptureError(f"{file}: not a JSON file that can be read ({error})") from None


def read_json_object(file: Path) -> dict[str, Any]:
    values = read_json(file)
    if not isinstance(values, dict):
        raise CaptureError(f"{file}: holds {type(values).__name__}, expected a JSON object")
    return values


def read_json_rows(file: Path) -> list[dict[str, Any]]:
    rows = read_json(file)
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise CaptureError(f"{file}: expected a JSON list of objects")
    return rows
