"""Report of real and simulated rain as one table in Markdown, with intervals."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from gsrain_engine.report.interval import Interval, quantiles, resampled
from gsrain_engine.report.table import Cell, Column, Table, columns

from .comparison import MeasuredFrames, RealRainComparison
from .streaks import DARK_BAND, streaks_within

BLACK_BAND, BRIGHT_BAND = (0.0, 16.0), (64.0, 140.0)
"""Background levels: nearly black, and bright but darker than the drops."""

_RESAMPLES = 1000
_CONFIDENCE = 0.9
_MIN_STREAKS = 10
"""Streaks for medians and scatter; with fewer the table has a dash."""


Resampled = Callable[[Int64[np.ndarray, " t"]], float]
"""Figure of the frames with some numbers, which may repeat."""

Measure = Callable[[MeasuredFrames], Resampled]


def estimate(measured: MeasuredFrames, measure: Measure) -> Interval:
    """Return a figure with its interval: percentiles over frames drawn with replacement (Efron 1979), seeded."""
    number, figure = len(measured.frames), measure(measured)
    value = figure(np.arange(number))
    low, high = np.nan, np.nan
    if not np.isnan(value):
        draws = resampled((np.arange(number),), figure, resamples=_RESAMPLES, vectorized=False)
        low, high = quantiles(draws, _CONFIDENCE)
    return Interval(value, low, high, "bootstrap, 90 %", "frames", number)


def _of_streaks(
    band: tuple[float, float], column: str, reduce: Callable[[Float64[np.ndarray, " n"]], float]
) -> Measure:
    """Measure a column of the streaks before a band of backgrounds."""

    def measure(measured: MeasuredFrames) -> Resampled:
        chosen = streaks_within(measured.streaks, band)
        values = [getattr(chosen, column)[chosen.frame == k] for k in range(len(measured.frames))]

        def figure(frames: Int64[np.ndarray, " t"]) -> float:
            found = np.concatenate([values[k] for k in frames])
            return reduce(found) if len(found) >= _MIN_STREAKS else np.nan

        return figure

    return measure


def _density(measured: MeasuredFrames) -> Resampled:
    """Streaks per megapixel of the dark band."""
    low, high = DARK_BAND
    pixels = np.count_nonzero(measured.found.still & (measured.found.median >= low) & (measured.found.median < high))
    counts = np.bincount(streaks_within(measured.streaks, DARK_BAND).frame, minlength=len(measured.frames))
    return lambda frames: float(1e6 * counts[frames].mean() / pixels) if pixels else np.nan


def _root_mean_square(column: str) -> Measure:
    """Measure standard deviations of frames together."""

    def measure(measured: MeasuredFrames) -> Resampled:
        squares = getattr(measured, column) ** 2
        return lambda frames: float(np.sqrt(np.mean(squares[frames])))

    return measure


def _median(values: Float64[np.ndarray, " n"]) -> float:
    return float(np.median(values))


def _scatter(values: Float64[np.ndarray, " n"]) -> float:
    low, high = np.percentile(values, (10, 90))
    return float(high - low)


DENSITY, SCATTER, BLACK_RISE = (
    "Streaks per megapixel",
    "Scatter of angles (10 to 90 %), degrees",
    "Rise before gray 0 to 16",
)
MEASURES: dict[str, Measure] = {
    DENSITY: _density,
    "Length, px": _of_streaks(DARK_BAND, "length_px", _median),
    "Width, px": _of_streaks(DARK_BAND, "width_px", _median),
    "Rise, gray levels": _of_streaks(DARK_BAND, "rise_levels", _median),
    "Angle from the vertical, degrees": _of_streaks(DARK_BAND, "angle_deg", _median),
    SCATTER: _of_streaks(DARK_BAND, "angle_deg", _scatter),
    BLACK_RISE: _of_streaks(BLACK_BAND, "rise_levels", _median),
    "Rise before gray 64 to 140": _of_streaks(BRIGHT_BAND, "rise_levels", _median),
    "Clouds, gray levels": _root_mean_square("cloud_levels"),
    "Deviation of the residual, gray levels": _root_mean_square("deviation_levels"),
}
"""Rows of the report; before backgrounds of gray 32 to 64, if nothing else is stated."""


# Goals


class Goal(NamedTuple):
    """Bounds on a figure of ours, as a ratio to that of real rain or as a difference from it."""

    measure: str
    title: str
    low: float
    high: float
    is_ratio: bool = True

    def verdict(self, real: float, ours: float) -> str:
        """Return the relation of the figures, and whether it is within the bounds."""
        if np.isnan(real) or np.isnan(ours) or real == 0:
            return "too few streaks"
        relation = ours / real if self.is_ratio else ours - real
        shown = f"{relation:.2f}" if self.is_ratio else f"{relation:+.1f}"
        return f"{shown} met" if self.low <= relation <= self.high else f"{shown} missed"


GOALS = (
    Goal(DENSITY, "Number of streaks within 0.6 to 1.6 of real", 0.6, 1.6),
    Goal(SCATTER, "Scatter of angles within 4 degrees", -4, 4, is_ratio=False),
    Goal(BLACK_RISE, "Rise before gray 0 to 16 within a factor of 1.6", 1 / 1.6, 1.6),
)


# Markdown


_INTRODUCTION = (
    "RainSense's frames (IVtest-Lab, doi 10.5281/zenodo.17231190) and our rain in front of the same backgrounds,",
    "written by `gsrain evaluate streaks RAINSENSE --report docs/real_rain.md`; [method](real_rain_method.md).",
)


def markdown(rows: Sequence[RealRainComparison]) -> str:
    """Write the report of the sequences with rain: one table, real beside ours, then the goals.

    Only the first exposure of each comparison is used.
    """
    rainy = [row for row in rows if row.labelled_mm_h > 0]
    rates = [f"{row.labelled_mm_h:g} mm/h" for row in rainy]
    found = {
        name: [(estimate(row.real, measure), estimate(row.ours[0], measure)) for row in rainy]
        for name, measure in MEASURES.items()
    }
    shutters = [cell for row in rainy for cell in (None, 1e3 * (row.ours[0].statistics.exposure_s or 0))]
    values: list[tuple[Cell, ...]] = [("Shutter of ours, ms", *shutters)]
    values += [(name, *(each for pair in pairs for each in pair)) for name, pairs in found.items()]
    titled = (Column(""), *(Column(f"{rate}, {whose}", ".3g") for rate in rates for whose in ("real", "ours")))
    caption = (
        "Figures are medians of the streaks found before backgrounds of gray 32 to 64, if nothing else is stated. A "
        "dash: fewer than 10 streaks."
    )
    goals = [
        (goal.title, *(goal.verdict(real.value, ours.value) for real, ours in found[goal.measure])) for goal in GOALS
    ]
    parts = Table("Our rain and real rain", titled, values, caption), Table("Goals", columns(["", *rates]), goals)
    return "\n".join(["# Our rain and real rain", "", *_INTRODUCTION, "", parts[0].markdown, "## Goals", "",
                      parts[1].markdown])  # fmt: skip
