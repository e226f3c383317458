"""What came of a run: figures, curves, pictures, timings."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from gsrain_engine.render.machine import machine

from .comparison import Comparison


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A number as it changed over a run."""

    name: str
    """Such as "loss" or "held-out PSNR"."""
    steps: Int64[np.ndarray, " n"]
    values: Float64[np.ndarray, " n"]
    times_s: Float64[np.ndarray, " n"] | None = None
    """Since the start."""
    unit: str = ""
    is_logarithmic: bool = False
    """Whether the vertical axis is."""


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """A drawing or a picture with what it shows."""

    title: str
    pixels: UInt8[np.ndarray, "h w 3"]
    caption: str = ""
    is_photograph: bool = False
    """Whether it may be kept as a JPEG; drawings are kept as they are."""


@dataclass(frozen=True, slots=True)
class ReportTable:
    """Numbers in rows; a person can sort them by each column."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str | float | None, ...], ...]
    decimals: int = 3
    caption: str = ""
    definitions: tuple[str, ...] = ()
    """What the columns mean, a sentence each, below the table."""

    @property
    def kinds(self) -> list[str]:
        """Of each column: "word" where it holds any, else "number"."""
        return [
            "word" if any(isinstance(row[i], str) for row in self.rows) else "number" for i in range(len(self.columns))
        ]


@dataclass(frozen=True, slots=True, eq=False)
class RunReport:
    """Everything that the page of a run shows."""

    title: str
    settings: Mapping[str, object]
    """By name with unit, in the order in which they are shown."""
    curves: tuple[Curve, ...] = ()
    comparisons: tuple[Comparison, ...] = ()
    """Views that the run did not learn from; pictures where `held_out` is False."""
    timings: Mapping[str, float] = field(default_factory=dict[str, float])
    """Seconds of each part of the run."""
    headlines: Mapping[str, str] = field(default_factory=dict[str, str])
    """Figures to show first beside the means over the views, such as {"Gaussians": "212,400"}."""
    problems: tuple[str, ...] = ()
    """What was left out of the capture and why."""
    machine: Mapping[str, object] = field(default_factory=machine)
    """What it ran on."""
    notes: tuple[str, ...] = ()
    """What a reader of the figures should know, a sentence each."""
    held_out: bool = True
    """Whether the comparisons are of such views; else they are called pictures."""
    figures: tuple[Figure, ...] = ()
    """Shown first."""
    tables: tuple[ReportTable, ...] = ()
