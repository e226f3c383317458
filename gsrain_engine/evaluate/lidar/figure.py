"""The figure of a lidar in rain: from above in clear air and in rain, and what is lost and made up by distance."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from gsrain_engine.scene.atomic_files import whole_file

from ..series_styles import Color, shades
from .runs import NEAR_STEP_M, Run, RunCounts
from .sweep_in_rain import Fate
from .tally import Tally
from .turns import Turn

_SIZE_INCHES, _DPI = (13.5, 8.2), 140
_CLEAR, _DROPPED, _MASKED, _FALSE, _EGO = "#3c6e9f", "#e08a1e", "#7d3fa0", "#d3202a", "#222222"
_VIEWED_SHARE = 0.985
_ASPECT = 0.66
"""Height over width of what is seen from above."""
_FEWEST = 20
"""Bins with fewer clear returns than this have no share to be drawn."""

_FEW_ENTRIES = 8
"""Of a legend that lies in its panel; a longer one stands to its right."""

ByIntensity = Mapping[float, Sequence[RunCounts]]
"""All seeds and turns at each intensity in mm/h."""

_Rows = Mapping[float, Sequence[Tally]]


def write_figure(path: Path, shown: Run, by_intensity: ByIntensity) -> None:
    """Draw and write the figure (PNG), whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside:
        draw_figure(shown, by_intensity).savefig(beside, format="png", dpi=_DPI)


def draw_figure(shown: Run, by_intensity: ByIntensity) -> Figure:
    """Draw one turn from above, clear and in its rain, and the counts of all turns by range."""
    figure = Figure(figsize=_SIZE_INCHES, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.08)  # pyright: ignore
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, height_ratios=(1.45, 1))
    reach = float(np.quantile(shown.turn.beams.ranges_m[shown.turn.beams.is_echo], _VIEWED_SHARE))
    _draw_clear(figure.add_subplot(grid[0, 0]), shown.turn, reach)
    _draw_rain(figure.add_subplot(grid[0, 1]), shown, reach)
    _draw_kept(
        figure.add_subplot(grid[1, 0]), {rain: [run.tally for run in runs] for rain, runs in by_intensity.items()}
    )
    _draw_false(
        figure.add_subplot(grid[1, 1]), {rain: [run.near for run in runs] for rain, runs in by_intensity.items()}
    )
    return figure


def _from_above(turn: Turn, points_m: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
    """To the left and ahead of the vehicle, in metres."""
    local = (points_m - turn.anchor_to_world[:3, 3]) @ turn.anchor_to_world[:3, :3]
    return np.stack([local[:, 0], local[:, 1]], axis=1)


def _draw_clear(axes: Axes, turn: Turn, reach_m: float) -> None:
    echoes = turn.beams.is_echo
    _dots(axes, _from_above(turn, turn.beams.points_m[echoes].astype(np.float64)), _CLEAR)
    _frame(axes, turn, reach_m)
    axes.set_title(f"clear: {int(echoes.sum()):,} returns", loc="left")


def _draw_rain(axes: Axes, shown: Run, reach_m: float) -> None:
    turn, rainy = shown.turn, shown.rainy
    fates, clear = rainy.fates, turn.beams.points_m.astype(np.float64)
    kept = ~rainy.is_false & ~turn.beams.untouched[rainy.beams]
    _dots(axes, _from_above(turn, rainy.sweep.points_m[kept].astype(np.float64)), _CLEAR, f"kept {int(kept.sum()):,}")
    for fate, color, title in ((Fate.DROPPED, _DROPPED, "too weak"), (Fate.MASKED, _MASKED, "behind a drop")):
        lost = fates == fate
        label = f"{title} {int(lost.sum()):,}"
        _dots(axes, _from_above(turn, clear[lost]), color, label, size=3.0)
    false = rainy.sweep.points_m[rainy.is_false].astype(np.float64)
    _dots(axes, _from_above(turn, false), _FALSE, f"drops {len(false):,}", size=5.0)
    _frame(axes, turn, reach_m)
    axes.set_title(
        f"{shown.state.intensity_mm_h:g} mm/h: {len(rainy.beams) - int(turn.beams.untouched.sum()):,} returns",
        loc="left",
    )
    axes.legend(loc="upper right", fontsize=8, framealpha=0.9, markerscale=3, handletextpad=0.2)


def _dots(axes: Axes, places: Float64[np.ndarray, "n 2"], color: str, label: str = "", size: float = 0.6) -> None:
    axes.scatter(places[:, 0], places[:, 1], s=size, c=color, linewidths=0, label=label or None, rasterized=True)


def _frame(axes: Axes, turn: Turn, reach_m: float) -> None:
    sensor = _from_above(turn, turn.beams.origin_m[None])[0]
    axes.plot(*sensor, marker="^", color=_EGO, markersize=6, linestyle="none")
    axes.set_xlim(sensor[0] - reach_m, sensor[0] + reach_m)
    axes.set_ylim(sensor[1] - _ASPECT * reach_m, sensor[1] + _ASPECT * reach_m)
    axes.set_aspect("equal")
    axes.set_xlabel("ahead (m)")
    axes.set_ylabel("left (m)")


def _draw_kept(axes: Axes, rows: _Rows) -> None:
    for color, (intensity, tallies) in zip(shades(len(rows)), rows.items(), strict=True):
        edges = np.where(np.isinf(tallies[0].edges_m), 1.5 * tallies[0].edges_m[-2], tallies[0].edges_m)
        enough = sum(each.clear for each in tallies) >= _FEWEST * len(tallies)
        shares = np.stack([np.where(enough, each.kept_share(), np.nan) for each in tallies])
        _band(axes, (edges[1:] + edges[:-1]) / 2, shares, color, f"{intensity:g} mm/h")
    axes.set_title("clear returns that are kept", loc="left")
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None))
    _finish(axes, "range (m)")
    axes.set_ylim(min(axes.get_ylim()[0], 0.9), 1.005)


def _draw_false(axes: Axes, near: _Rows) -> None:
    for color, (intensity, tallies) in zip(shades(len(near)), near.items(), strict=True):
        edges = tallies[0].edges_m
        counts = np.stack([each.false for each in tallies]).astype(np.float64)
        if counts.any():
            _band(
                axes,
                (edges[1:] + edges[:-1]) / 2,
                counts,
                color,
                f"{intensity:g} mm/h: {counts.sum(1).mean():.0f} in all",
            )
    axes.set_title(f"false returns: drops in a turn, per {NEAR_STEP_M:g} m", loc="left")
    _finish(axes, "range (m)")
    axes.set_ylim(bottom=0)
    if not axes.lines:
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center", color="#888888", fontsize=12)


def _band(
    axes: Axes, x: Float64[np.ndarray, " k"], values: Float64[np.ndarray, "s k"], color: Color, label: str
) -> None:
    """The mean of seeds and turns, in a band from the least to the most of them."""
    known = np.isfinite(values).all(axis=0)
    x, values = x[known], values[:, known]
    axes.fill_between(x, values.min(axis=0), values.max(axis=0), color=color, alpha=0.25, linewidth=0)
    axes.plot(x, values.mean(axis=0), color=color, marker="o", markersize=3, linewidth=1.4, label=label)


def _finish(axes: Axes, x_title: str) -> None:
    axes.set_xlabel(x_title)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    entries = len(axes.get_legend_handles_labels()[0])
    if entries > _FEW_ENTRIES:
        axes.legend(fontsize=6.5, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0), ncols=-(-entries // 20))
    elif entries:
        axes.legend(fontsize=8, frameon=False)
