"""Masks as COCO writes them: run lengths down the columns, as a list of numbers or packed into a string.

Source: maskApi.c of the COCO API (Lin and Dollar, 2015), whose strings hold five bits a character from "0" on, and
from the third run on the difference to the run before the last.
"""

from typing import TypedDict

import numpy as np
from jaxtyping import Bool

_FIRST = 48


class RunLengths(TypedDict):
    """A mask in COCO's JSON."""

    size: list[int]
    """Height, width."""
    counts: str


def run_lengths(mask: Bool[np.ndarray, "h w"]) -> list[int]:
    """Lengths of the runs of equal pixels, column by column; the first is of pixels that are False and may be 0."""
    flat = np.concatenate([[False], mask.ravel(order="F"), [False]])
    changes = np.flatnonzero(flat[1:] != flat[:-1])
    edges = np.concatenate([[0], changes[changes < mask.size], [mask.size]])
    return np.diff(edges).tolist()


def packed(mask: Bool[np.ndarray, "h w"]) -> RunLengths:
    """Return a mask as COCO's JSON has it for crowds and for results: its size and its runs as a string."""
    runs = run_lengths(mask)
    text = "".join(_characters(run - (runs[k - 2] if k > 2 else 0)) for k, run in enumerate(runs))
    return {"size": list(mask.shape), "counts": text}


def _characters(value: int) -> str:
    text = ""
    while True:
        bits, value = value & 0x1F, value >> 5
        more = value != (-1 if bits & 0x10 else 0)
        text += chr((bits | (0x20 if more else 0)) + _FIRST)
        if not more:
            return text
