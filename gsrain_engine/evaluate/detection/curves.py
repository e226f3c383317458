"""Confidence, overlap and average precision against the intensity of rain, as figures with bands over the seeds."""

from collections import defaultdict
from collections.abc import Sequence
from itertools import cycle
from typing import Literal, TypeVar

import matplotlib
import numpy as np
from jaxtyping import UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gsrain_engine.untrusted.printable import figure_label

from .summary import Spread, WeatherScore
from .sweep import Row

MOST_OBJECTS = 8
"""Of more objects those with most frames are drawn, of these the nearest."""

_WIDTH_IN, _HEIGHT_IN, _DPI = 5.4, 3.9, 150
_WORDS = {
    "confidence": "confidence of the match (missed: 0)",
    "iou": "IoU of the match (missed: 0)",
    "map": "mAP",
    "map50": "mAP50",
}

_MEANS = ("--", ":", "-.", (0, (1, 3)))
"""Lines of the means: over all objects, then by class."""

_Seeds = dict[int, list[float]]
_Line = TypeVar("_Line", Row, WeatherScore)


def object_figure(rows: Sequence[Row], number: Literal["confidence", "iou"]) -> Figure:
    """Draw a number against the intensity, a curve for each object and one panel for each detector.

    A point is the mean over frames and seeds, a band reaches from the lowest to the highest seed's mean over frames.
    Where there are both, a cross is the picture as it was taken, and the curve begins at its reconstruction.
    """
    detectors = list(dict.fromkeys(row.detector for row in rows))
    chosen = shown_objects(rows)
    figure = Figure(figsize=(_WIDTH_IN * len(detectors) + 2.0, _HEIGHT_IN), layout="constrained")
    panels: list[Axes] = list(np.atleast_1d(figure.subplots(1, len(detectors), sharey=True)))
    colors = matplotlib.colormaps["tab10"]
    for panel, detector in zip(panels, detectors, strict=True):
        own = [row for row in rows if row.detector == detector]
        for place, name in enumerate(chosen):
            _curve(panel, [row for row in own if row.object == name], number, colors(place), chosen[name])
        _everything(panel, own, number)
        _dress(panel, detector, _WORDS[number] if panel is panels[0] else "")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper", frameon=False, fontsize=8)
    return figure


def precision_figure(scores: Sequence[WeatherScore]) -> Figure:
    """Draw mAP and mAP50 of each detector against the intensity, with the range over the seeds."""
    figure = Figure(figsize=(2 * _WIDTH_IN, _HEIGHT_IN), layout="constrained")
    panels: list[Axes] = list(figure.subplots(1, 2, sharey=True))
    colors = matplotlib.colormaps["tab10"]
    for panel, number in zip(panels, ("map", "map50"), strict=True):
        for place, detector in enumerate(dict.fromkeys(each.detector for each in scores)):
            own = [each for each in scores if each.detector == detector]
            drawn = _one_without_rain(own)
            spreads: list[Spread] = [getattr(each, number) for each in drawn]
            _band(panel, [each.intensity_mm_h for each in drawn], spreads, colors(place), detector)
            for each in own:
                if each not in drawn:
                    value = getattr(each, number).mean
                    panel.plot(
                        [0], [value], "x", color=colors(place), label=figure_label(f"{detector}, pictures as taken")
                    )
        _dress(panel, "", _WORDS[number])
    panels[0].legend(frameon=False, fontsize=8)
    return figure


def pixels(figure: Figure) -> UInt8[np.ndarray, "h w 3"]:
    """Return a figure as a picture, the same bytes every time."""
    figure.set_dpi(_DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def shown_objects(rows: Sequence[Row]) -> dict[str, str]:
    """The objects to draw, those of most frames and of these the nearest first, with what a legend calls them."""
    frames: dict[str, set[str]] = defaultdict(set)
    distances: dict[str, list[float]] = defaultdict(list)
    classes: dict[str, str] = {}
    for row in rows:
        frames[row.object].add(row.frame)
        classes[row.object] = row.class_name
        distances[row.object].append(np.inf if row.distance_m is None else row.distance_m)
    middle = {name: float(np.median(each)) for name, each in distances.items()}
    best = sorted(frames, key=lambda name: (-len(frames[name]), middle[name], name))[:MOST_OBJECTS]
    return {name: _called(name, classes[name], middle[name], len(frames[name])) for name in best}


def _called(name: str, class_name: str, distance_m: float, frames: int) -> str:
    short = name if len(name) <= 14 else f"{name[:6]}..{name[-6:]}"
    where = f", {distance_m:.0f} m" if np.isfinite(distance_m) else ""
    return f"{short}: {class_name}{where}, {frames} frame{'s' if frames > 1 else ''}"


def _curve(panel: Axes, rows: Sequence[Row], number: str, color: object, label: str) -> None:
    intensities, spreads = _over_seeds(_one_without_rain(rows), number)
    _band(panel, intensities, spreads, color, label)
    taken = [getattr(row, number) for row in rows if row.picture == "original"]
    if taken and any(row.picture == "clear" for row in rows):
        panel.plot([0], [float(np.mean(taken))], "x", color=color, markersize=7, clip_on=False)


def _everything(panel: Axes, rows: Sequence[Row], number: str) -> None:
    """The mean over all objects, in black; where there are several classes, also that over each."""
    classes = sorted({row.class_name for row in rows})
    groups = {"object": list(rows)}
    if len(classes) > 1:
        groups |= {name: [row for row in rows if row.class_name == name] for name in classes}
    for (name, own), style in zip(groups.items(), cycle(_MEANS)):
        intensities, spreads = _over_seeds(_one_without_rain(own), number)
        many = len({row.object for row in own})
        label = f"mean of {many} {name}{'s' if many > 1 else ''}"
        panel.plot(
            intensities, [each.mean for each in spreads], style, color="black", linewidth=1.6, label=figure_label(label)
        )


def _one_without_rain(lines: Sequence[_Line]) -> list[_Line]:
    """Of two kinds of pictures at 0 mm/h keep the one that differs from the others by nothing but rain."""
    has_clear = any(each.picture == "clear" for each in lines)
    return [each for each in lines if not (has_clear and each.picture == "original")]


def _over_seeds(rows: Sequence[Row], number: str) -> tuple[list[float], list[Spread]]:
    by_intensity: dict[float, _Seeds] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        by_intensity[row.intensity_mm_h][row.seed].append(getattr(row, number))
    intensities = sorted(by_intensity)
    return intensities, [Spread.of(float(np.mean(each)) for each in by_intensity[r].values()) for r in intensities]


def _band(panel: Axes, x: Sequence[float], spreads: Sequence[Spread], color: object, label: str) -> None:
    lows, highs = [each.low for each in spreads], [each.high for each in spreads]
    panel.fill_between(x, lows, highs, color=color, alpha=0.18, linewidth=0)
    panel.plot(
        x, [each.mean for each in spreads], "o-", color=color, markersize=3.5, linewidth=1.4, label=figure_label(label)
    )


def _dress(panel: Axes, title: str, words: str) -> None:
    panel.set_title(figure_label(title), fontsize=10)
    panel.set_xlabel("rain intensity (mm/h)")
    panel.set_ylabel(words)
    panel.set_ylim(-0.02, 1.02)
    panel.grid(alpha=0.3)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
