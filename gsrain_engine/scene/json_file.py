"""Reads JSON that may be damaged, or made to exhaust who reads it; what is wrong with it is one sentence."""

import json
from pathlib import Path
from typing import Any

from gsrain_engine.untrusted.limits import read_input

from .errors import SceneFormatError

_MAX_BYTES = 1 << 28
"""A path of an hour with a key for each of 30 frames a second has 30 MB."""


def read_json(path: Path | str) -> Any:
    """Read a JSON file, or a pipe of one; `SceneFormatError` where it is missing, no JSON, nested without end, huge."""
    try:
        return json.loads(read_input(path, _MAX_BYTES).decode("utf-8"))
    except OSError as error:
        raise SceneFormatError(path, f"can't be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:  # also no UTF-8, and integers of thousands of digits
        raise SceneFormatError(path, f"not a JSON file: {error}") from None
