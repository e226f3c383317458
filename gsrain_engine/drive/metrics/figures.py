"""Speed, acceleration, time to collision and gap over time, all intensities in one figure: the paper's kinematics."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.untrusted.figure_words import figure_words

from .comfort_limits import PAPER
from .comparison import Comparison, WeatherRuns
from .curves_over_time import Quantity, band
from .time_to_collision import LONGEST_S

_SIZE_INCHES, _DPI = (10.5, 6.2), 150
_WIDEST, _THINNEST = 3.0, 1.5
_CLEAR, _GRID = "#d9822b", "#9aa3ad"
_TITLES: dict[Quantity, str] = {
    "speed_m_s": "Speed (m/s)",
    "acceleration_m_s2": "Acceleration (m/s$^2$)",
    "ttc_s": "Time to collision (s)",
    "gap_m": "Gap to the vehicle ahead (m)",
}
_WITHOUT_DATE: dict[str, dict[str, None]] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""Kinds of figures, and what to leave out of each so that the same runs give the same bytes."""


def kinematics_figure(comparison: Comparison) -> Figure:
    """Draw the ego vehicle's motion over time, one colour an intensity; a cross is a collision.

    Several seeds are their mean over the runs that still go on, with the band of its 95 % bootstrap interval. Needs the
    roll-outs of the runs; raises ValueError without.
    """
    figure = Figure(figsize=_SIZE_INCHES, layout="constrained")
    FigureCanvasAgg(figure)
    panels: list[Axes] = list(figure.subplots(2, 2, sharex=True).ravel())
    colors = rain_colors([each.intensity_mm_h for each in comparison.weathers])
    for panel, (quantity, title) in zip(panels, _TITLES.items(), strict=True):
        for weather, width in zip(comparison.weathers, _widths(len(comparison.weathers)), strict=True):
            _draw(panel, weather, quantity, colors[weather.intensity_mm_h], width)
        _dress(panel, quantity, title)
    for panel in panels[2:]:
        panel.set_xlabel("Time (s)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=min(len(labels), 6), frameon=False, fontsize=9
    )  # fmt: skip
    figure.suptitle(figure_words(comparison.title, 110), fontsize=12, x=0.01, ha="left")
    return figure


def rain_colors(intensities_mm_h: list[float]) -> dict[float, tuple[float, ...] | str]:
    """Return a colour for each intensity: the clear one apart, rain the darker the heavier it is."""
    rainy = sorted({each for each in intensities_mm_h if each > 0})
    shades = np.linspace(0.42, 1.0, len(rainy)) if len(rainy) > 1 else np.full(len(rainy), 0.8)
    blue = colormaps["Blues"]
    return {0.0: _CLEAR, **{each: blue(shade) for each, shade in zip(rainy, shades, strict=True)}}


def write_figure(path: Path, figure: Figure) -> None:
    """Write a figure as PNG, PDF or SVG by the name's ending, whole or not at all; the same figure, the same bytes.

    Raises ValueError for another ending.
    """
    kind = path.suffix.removeprefix(".").lower()
    if kind not in _WITHOUT_DATE:
        raise ValueError(f"{path}: expected a name that ends with .{', .'.join(_WITHOUT_DATE)}")
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside, rc_context({"svg.hashsalt": "gsrain"}):
        figure.savefig(beside, format=kind, dpi=_DPI, metadata=_WITHOUT_DATE[kind])


def _widths(count: int) -> list[float]:
    """Of lines from below to above: where they coincide all are seen."""
    return [float(each) for each in np.linspace(_WIDEST, _THINNEST, count)] if count > 1 else [_THINNEST]


def _draw(panel: Axes, weather: WeatherRuns, quantity: Quantity, color: Any, width: float) -> None:
    times, mean, low, high = band(weather, quantity)
    style = "steps-pre" if quantity == "acceleration_m_s2" else "default"
    rain = "clear" if weather.intensity_mm_h == 0 else f"{weather.intensity_mm_h:g} mm/h"
    seeds = f" ({len(weather.runs)} seeds)" if len(weather.runs) > 1 else ""
    if len(weather.runs) > 1:
        step = "pre" if quantity == "acceleration_m_s2" else None
        panel.fill_between(times, low, high, color=color, alpha=0.2, linewidth=0, step=step)
    panel.plot(times, mean, color=color, linewidth=width, drawstyle=style, label=f"{rain}{seeds}")
    _crosses(panel, weather, quantity, color)


def _crosses(panel: Axes, weather: WeatherRuns, quantity: Quantity, color: Any) -> None:
    """Mark collisions where their run's curve ends."""
    for run in weather.runs:
        if run.rollout is None or not run.metrics.collision:
            continue
        own = band(WeatherRuns(weather.intensity_mm_h, (run,)), quantity)
        if np.isfinite(own.mean[-1]):
            panel.plot(
                own.times_s[-1], own.mean[-1], "X", color=color, markersize=9, markeredgecolor="white", zorder=5,
                clip_on=False,
            )  # fmt: skip


def _dress(panel: Axes, quantity: Quantity, title: str) -> None:
    panel.set_title(title, loc="left", fontsize=10)
    panel.grid(alpha=0.3)
    panel.spines[["top", "right"]].set_visible(False)
    panel.tick_params(labelsize=9)
    panel.set_xlim(left=0)
    if quantity == "acceleration_m_s2":
        for limit in (PAPER.braking_m_s2, PAPER.acceleration_m_s2):
            panel.axhline(limit, color=_GRID, linewidth=1, linestyle=(0, (4, 3)), zorder=0)
        panel.text(
            0.995, PAPER.acceleration_m_s2, "comfort limits", transform=panel.get_yaxis_transform(), fontsize=7.5,
            color="#6b7480", ha="right", va="bottom",
        )  # fmt: skip
        low, high = panel.get_ylim()
        panel.set_ylim(min(low, PAPER.braking_m_s2 - 0.5), max(high, PAPER.acceleration_m_s2 + 0.9))
    elif quantity == "ttc_s":
        panel.set_ylim(-0.25, LONGEST_S + 0.4)
    else:
        low, high = panel.get_ylim()
        panel.set_ylim(min(0.0, low), max(1.04 * high, 1.0))
