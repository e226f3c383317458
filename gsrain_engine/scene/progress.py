"""Progress of background jobs: the one message type that jobs yield."""

import math
from collections.abc import Callable, Generator, Mapping
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import UInt8

from ..fields import short_number

_Result = TypeVar("_Result")
PENDING = "queued", "running"
"""States of a job that has not ended."""


class Progress(NamedTuple):
    """One step of a job; a job may be stopped wherever it yields one."""

    fraction: float
    """Completed fraction, 0 to 1, never decreasing."""
    message: str
    """Description of the current step for the user."""
    preview: UInt8[np.ndarray, "h w 3"] | None = None
    """A small preview image; only the newest is shown."""
    metrics: Mapping[str, float] = {}
    """Figures at this step by name with unit, such as `loss`; `step` is the abscissa of their curves."""
    warning: str | None = None
    """One sentence about the work so far, such as that a training goes wrong."""
    note: str = ""
    """Line about the input or settings of the work that its result depends on."""


def duration_text(seconds: float) -> str:
    """Duration as people write it: 0.4 s, 42 s, 3:05 min, 2:10 h."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d} min" if minutes < 60 else f"{minutes // 60}:{minutes % 60:02d} h"


_FIGURES = {
    "gaussians": "{} Gaussians", "seconds per frame": "{} s per frame", "psnr_held_out_db": "held-out views {} dB",
}  # fmt: skip


def figure_text(name: str, value: float) -> str:
    """A metric as people write it, with its unit: 65,960 Gaussians, 0.918 s per frame; others follow their name."""
    number = short_number(value) if math.isfinite(value) else "not finite"
    return _FIGURES.get(name, f"{name.replace('_', ' ')} {{}}").format(number)


def run_to_end(
    work: Generator[Progress, None, _Result], on_step: Callable[[Progress], object] | None = None
) -> _Result:
    """Run a job to its end and return its result; calls `on_step` with each step. Exceptions propagate."""
    while True:
        try:
            step = next(work)
        except StopIteration as end:
            return end.value
        if on_step is not None:
            on_step(step)


def subprogress(
    work: Generator[Progress, None, _Result], first: float, last: float
) -> Generator[Progress, None, _Result]:
    """Run a job as a part of a larger one, whose progress it advances from `first` to `last` (0 to 1)."""
    while True:
        try:
            step = next(work)
        except StopIteration as end:
            return end.value
        yield step._replace(fraction=first + (last - first) * step.fraction)
