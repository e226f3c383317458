"""How far a background job has come: the one thing that jobs say while they work."""

from collections.abc import Callable, Generator
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import UInt8

_Result = TypeVar("_Result")


class Progress(NamedTuple):
    """One step of a job; a job may be stopped wherever it yields one."""

    fraction: float
    """Work done so far, 0 to 1, never falling."""
    message: str
    """What is being done, for a person to read."""
    preview: UInt8[np.ndarray, "h w 3"] | None = None
    """A small picture of how it goes; of several, the newest is shown."""


def run_to_end(work: Generator[Progress, None, _Result], tell: Callable[[Progress], object] | None = None) -> _Result:
    """Do a piece of work to its end and return its result; `tell` hears of each step. What it raises comes through."""
    while True:
        try:
            step = next(work)
        except StopIteration as end:
            return end.value
        if tell is not None:
            tell(step)


def subprogress(
    work: Generator[Progress, None, _Result], first: float, last: float
) -> Generator[Progress, None, _Result]:
    """Do a piece of work as a part of a whole, of which it takes the share from `first` to `last` (0 to 1)."""
    while True:
        try:
            step = next(work)
        except StopIteration as end:
            return end.value
        yield step._replace(fraction=first + (last - first) * step.fraction)
