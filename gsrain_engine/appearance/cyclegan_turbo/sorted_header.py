"""Puts the fields in the header of a .safetensors in order: the library writes them in another one every time."""

import json
from pathlib import Path
from typing import Any

_LENGTH_BYTES = 8


def sort_header(file: Path) -> None:
    """Rewrite the header in place, so that the same weights are the same bytes; where tensors lie stays as it is."""
    with file.open("r+b") as stream:
        length = int.from_bytes(stream.read(_LENGTH_BYTES), "little")
        header: dict[str, Any] = json.loads(stream.read(length))
        fields = dict(sorted(header.pop("__metadata__", {}).items()))
        text = json.dumps({"__metadata__": fields, **header}, separators=(",", ":"), ensure_ascii=False).encode()
        if len(text) > length:
            raise ValueError(f"{file}: its header can't be written in {length} bytes")
        stream.seek(_LENGTH_BYTES)
        stream.write(text.ljust(length))
