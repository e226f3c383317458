"""Plot styles: distinct curve styles for any number of series, and legends of matching size."""

from collections.abc import Sequence
from math import ceil
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure, SubFigure

_LINES: tuple[str | tuple[int, tuple[float, ...]], ...] = (
    "-", (0, (4, 1.5)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1, 1, 1, 1, 1)),
)  # fmt: skip

_MARKERS = ("o", "s", "^", "D", "v", "P")
_COLORS = 10
_LINES_PER_IN = 5.4  # legend lines per inch at 8 points
_LEGEND_IN = 2.1  # width in inches of a legend column at 8 points
Color = tuple[float, ...]


class SeriesStyle(NamedTuple):
    """Style of one curve."""

    color: Color
    line: str | tuple[int, tuple[float, ...]]
    """A dash pattern as in Matplotlib's `linestyle`; format strings do not support custom patterns."""
    marker: str
    band: float
    """Opacity of the band around it; lower for many curves, so that bands do not hide them."""


def series_styles(count: int) -> list[SeriesStyle]:
    """Return styles of `count` curves: ten colors, repeated with other dashes and markers; the first 300 differ."""
    colors = matplotlib.colormaps["tab10"]
    styles: list[SeriesStyle] = []
    for place in range(count):
        turn, color = divmod(place, _COLORS)
        line, marker = _LINES[turn % len(_LINES)], _MARKERS[turn % len(_MARKERS)]
        styles.append(SeriesStyle(tuple(colors(color)), line, marker, min(0.18, 1.3 / count)))
    return styles


def shades(count: int, low: float = 0.3, high: float = 1.0, colormap: str = "Blues") -> list[Color]:
    """Return `count` colors from light to dark, for ordered curves."""
    where = np.linspace(low, high, count) if count > 1 else np.array([(low + high) / 2])
    return [tuple(matplotlib.colormaps[colormap](each)) for each in where]


def legend_columns(entries: int, height_in: float) -> int:
    """Return the number of columns of a legend in 8 points for a height in inches."""
    return max(1, ceil(entries / max(1, int(height_in * _LINES_PER_IN))))


def legend_width_in(entries: int, height_in: float) -> float:
    """Return the approximate width of such a legend, in inches."""
    return _LEGEND_IN * legend_columns(entries, height_in)


def legend_at_right(
    figure: Figure | SubFigure, handles: Sequence[Artist], labels: Sequence[str], height_in: float
) -> None:
    """Put a legend in 8 points to the right of all panels, in as many columns as its entries need."""
    figure.legend(
        handles, labels, loc="outside right upper", frameon=False, fontsize=8,
        ncols=legend_columns(len(labels), height_in),
    )  # fmt: skip
