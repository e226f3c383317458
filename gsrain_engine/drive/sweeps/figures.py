"""Collisions, time to collision, planned collisions and comfort against the intensity of rain, with their bands."""

from collections.abc import Callable, Sequence
from pathlib import PurePath

import numpy as np
from jaxtyping import UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gsrain_engine.evaluate.series_styles import SeriesStyle, series_styles
from gsrain_engine.rain.rain import CALIBRATED_UP_TO_MM_H
from gsrain_engine.untrusted.figure_words import figure_words

from .summary import Cell, Spread

_PANEL_IN, _DPI = (4.4, 3.3), 120
_ASIDE, _ALL_ASIDE = 0.012, 0.06
"""Of the widest intensity: how far curves stand from each other, and all of them together at most."""
_LEGEND_COLUMNS, _LEGEND_LINE_IN = 4, 0.2


def _mean(name: str) -> Callable[[Cell], Spread | None]:
    return lambda cell: cell.means.get(name)


_PANELS: tuple[tuple[str, Callable[[Cell], Spread | None]], ...] = (
    ("share of drives with a collision", lambda cell: cell.collision_rate),
    ("least time to collision (s)", _mean("min_ttc_s")),
    ("C: share of planned points that collide", _mean("planned_point_collision_rate")),
    ("S: comfort of the motion as driven", _mean("comfort_executed")),
)


def scenario_figure(cells: Sequence[Cell]) -> UInt8[np.ndarray, "h w 3"]:
    """Draw what the agents did in one scenario of one scene: a panel a measure, a curve an agent.

    The same cells give the same bytes. Bands are the 95 % intervals of the cells; the first panel's are Wilson's.
    """
    rows, columns = 2, len(_PANELS) // 2
    agents = list(dict.fromkeys(cell.agent for cell in cells))
    legend_in = _LEGEND_LINE_IN * -(-len(agents) // _LEGEND_COLUMNS)
    size = columns * _PANEL_IN[0], rows * _PANEL_IN[1] + 0.4 + legend_in
    figure = Figure(figsize=size, layout="constrained", dpi=_DPI)
    panels: list[Axes] = list(np.ravel(figure.subplots(rows, columns, sharex=True)))
    styles = series_styles(len(agents))
    # else equal curves would hide each other
    aside = min(_ASIDE, _ALL_ASIDE / len(agents)) * max(cell.intensity_mm_h for cell in cells)
    for number, (panel, (title, value)) in enumerate(zip(panels, _PANELS, strict=True)):
        for place, agent in enumerate(agents):
            own = [cell for cell in cells if cell.agent == agent]
            _curve(panel, own, value, styles[place], figure_words(agent, 28), aside * (place - (len(agents) - 1) / 2))
        _dress(panel, title, cells, is_lowest=number >= columns)
    runs = sorted({cell.runs for cell in cells})
    seeds = f"{runs[0]}" if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"
    where = f"{figure_words(cells[0].scenario)} in {figure_words(PurePath(cells[0].scene).name)}"
    figure.suptitle(f"{where}: {seeds} drives a point", fontsize=11)
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", frameon=False, fontsize=9,
        ncols=min(len(agents), _LEGEND_COLUMNS),
    )  # fmt: skip
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _curve(
    panel: Axes, cells: Sequence[Cell], value: Callable[[Cell], Spread | None], style: SeriesStyle, label: str,
    aside: float,
) -> None:  # fmt: skip
    points = [(cell.intensity_mm_h, spread) for cell in cells if (spread := value(cell)) is not None]
    x = [each + aside for each, _ in points]
    spreads = [each for _, each in points]
    color, means = style.color, [each.mean for each in spreads]
    panel.plot(x, means, linestyle=style.line, marker=style.marker, color=color, label=label, ms=4)
    if len(points) > 1:
        panel.fill_between(x, [s.low for s in spreads], [s.high for s in spreads], color=color, alpha=style.band, lw=0)
    for at, each in zip(x, spreads, strict=True):
        panel.plot([at, at], [each.low, each.high], color=color, alpha=0.6, lw=1)


def _dress(panel: Axes, title: str, cells: Sequence[Cell], *, is_lowest: bool) -> None:
    panel.set_title(title, fontsize=9.5)
    intensities = sorted({cell.intensity_mm_h for cell in cells})
    if intensities[-1] > CALIBRATED_UP_TO_MM_H:
        panel.axvspan(CALIBRATED_UP_TO_MM_H, intensities[-1], color="0.93", zorder=0)
    if "(s)" in title:
        panel.set_ylim(bottom=-0.03 * panel.get_ylim()[1])
    else:
        panel.set_ylim(-0.03, 1.03)
    panel.grid(alpha=0.25)
    panel.spines[["top", "right"]].set_visible(False)
    if is_lowest:
        panel.set_xlabel("rainfall intensity (mm/h)")
