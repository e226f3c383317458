"""COCO's packed run lengths read back."""

from typing import Any

import numpy as np
from jaxtyping import Bool

_FIRST = 48


def unpacked(value: dict[str, Any]) -> Bool[np.ndarray, "h w"]:
    """Read what `packed` returns. Raises ValueError where the runs don't fill the picture."""
    runs: list[int] = []
    number = shift = 0
    for character in value["counts"]:
        bits = ord(character) - _FIRST
        number |= (bits & 0x1F) << shift
        shift += 5
        if not bits & 0x20:
            number -= (1 << shift) if bits & 0x10 else 0
            runs.append(number + (runs[-2] if len(runs) > 2 else 0))
            number = shift = 0
    height, width = value["size"]
    if sum(runs) != height * width or min(runs, default=0) < 0:
        raise ValueError(f"runs of a mask cover {sum(runs)} of {height * width} pixels")
    return np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape((height, width), order="F")
