"""Reads JSON that may be damaged, or made to exhaust who reads it; what is wrong with it is one sentence."""

import json
from pathlib import Path
from typing import Any

from .errors import SceneFormatError

_MOST_BYTES = 1 << 28
"""A path of an hour with a key for each of 30 frames a second has 30 MB."""


def read_json(path: Path | str) -> Any:
    """Read a JSON file; `SceneFormatError` where it is missing, no JSON, nested without end, or huge."""
    try:
        size = Path(path).stat().st_size
        if size <= _MOST_BYTES:
            return json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneFormatError(path, f"can't be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:  # also no UTF-8, and integers of thousands of digits
        raise SceneFormatError(path, f"not a JSON file: {error}") from None
    raise SceneFormatError(path, f"has {size} bytes, at most {_MOST_BYTES} would be right")
