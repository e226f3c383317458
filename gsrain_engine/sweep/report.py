"""Tables, summary figures and HTML report of a sweep."""

import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

import msgspec
import numpy as np
from jaxtyping import UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from msgspec import structs
from PIL import Image

from ..evaluation.attribution.results import Attribution, share_table
from ..rain.settings import CALIBRATED_UP_TO_MM_H
from ..report.charts import SeriesStyle, series_styles
from ..report.page import ReportFigure, RunReport, write_report
from ..report.table import Cell, Column, Table, columns, table_of
from ..safe_io.file_names import shortened
from ..safe_io.files import whole_file
from ..safe_io.text_files import figure_words
from ..simulation.metrics.summary import AFTER_COLLISION, COLLISIONS, RATE, RESULT_COLUMNS
from . import results
from .attribution import drive_attributions, write_attribution
from .expansion import DriveJob, Job, attributed_drives, drives_of
from .results import Row, SummaryCell, SweepFolder, by_scenario
from .settings import DriveSweep, RenderSweep, Sweep


@dataclass(frozen=True, eq=False)
class SweepReport:
    """Numbers, tables and figures of a sweep, as they stand in its folder."""

    folder: Path
    numbers: Mapping[str, Any]
    """Those of summary.json."""
    tables: tuple[Table, ...]
    figures: tuple[ReportFigure, ...]

    @property
    def table(self) -> Table:
        return self.tables[0]

    @property
    def figure(self) -> Image.Image | None:
        """The first figure; None for clips, which have none."""
        return Image.fromarray(self.figures[0].pixels) if self.figures else None

    def save(self, folder: Path | str) -> list[str]:
        """Copy tables, figures, numbers and page to another folder; returns their names there."""
        place, own = Path(folder), ("table.csv", "table.parquet", "summary.json", "report.html")
        files = [*own, *(f"figures/{each.name}" for each in sorted((self.folder / "figures").glob("*.png")))]
        for name in files:
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            with whole_file(place / name) as partial:
                shutil.copyfile(self.folder / name, partial)
        return files


def write_tables(folder: SweepFolder, sweep: Sweep, jobs: Sequence[Job]) -> SweepReport:
    """Merge the existing rows into table.parquet, table.csv, summary.json, figures and report.html.

    All files except the report are byte-identical for the same rows. Raises ValueError if there are no rows, and
    OSError if a file can't be written.
    """
    found = folder.read(jobs)
    rows = [found[job.id] for job in jobs if job.id in found]
    if not rows:
        raise ValueError(f"{folder.path}: there are no rows of this sweep yet")
    kind = "drive" if isinstance(jobs[0], DriveJob) else "render"
    failed = [str(row["error"]) for row in rows if row["status"] == results.FAILED]
    errors = sorted(Counter(failed).items(), key=lambda each: (-each[1], each[0]))  # most frequent first
    numbers: dict[str, Any] = {
        "jobs": len(jobs), "rows": len(rows), "failed": len(failed), "other_rows": folder.others(jobs),
        "errors": dict(errors),
    }  # fmt: skip
    figures: list[ReportFigure] = []
    shares: list[Attribution] = []
    if isinstance(sweep, DriveSweep) and (apart := attributed_drives(sweep)):
        shares = drive_attributions(apart, found)
        figures += write_attribution(folder.path, apart, found, shares)
        numbers["attribution"] = [each.plain for each in shares]
        whole = {job.id for job in drives_of(sweep)}
        rows = [row for row in rows if row["id"] in whole]  # drives in parts of the rain have a table of their own
    cells = results.summarized(rows) if kind == "drive" else []
    numbers["cells"] = msgspec.to_builtins(cells)
    figures += _written_figures(folder.path / "figures", by_scenario(cell for cell in cells if cell.runs))
    table_of("Rows", results.columns_of(kind), rows).write_csv(folder.path / "table.csv")
    for name, data in (
        ("table.parquet", results.rows_parquet(rows, kind)),
        ("summary.json", results.indented_json(numbers)),
    ):
        with whole_file(folder.path / name) as partial:
            partial.write_bytes(data)
    tables = tuple(_tables(sweep, rows, cells, shares))
    write_report(folder.path / "report.html", sweep_report_page(folder.path.name, sweep, numbers, figures, tables))
    return SweepReport(folder.path, numbers, tables, tuple(figures))


def _written_figures(folder: Path, scenarios: Sequence[Sequence[SummaryCell]]) -> list[ReportFigure]:
    """Write one PNG per scenario and scene, and one of the boundary of failure; equal names get a number."""
    bands = (
        "Bands: 95 %, over the seeds; of collisions Wilson's interval, of means a bootstrap. C and S are those of "
        "drives without a collision."
    )
    shares = "Share of the drives with a collision; the line is at one half, the boundary of failure."
    figures: list[ReportFigure] = []
    names: list[str] = []
    drawn: list[tuple[Sequence[SummaryCell], str, UInt8[np.ndarray, "h w 3"], str]] = []
    for cells in scenarios:
        axes = grid_axes(cells)
        if len({cell.title for cell in cells}) <= _MAX_CURVES:
            drawn.append((cells, "", scenario_figure(cells), bands))
        if axes:
            drawn.append((cells, "boundary", boundary_figure(cells, axes), shares))
    for cells, kind, pixels, caption in drawn:
        scenario, scene = cells[0].scenario, cells[0].scene
        words = "-".join(filter(None, [scenario, PurePath(scene).stem, kind]))
        name = shortened("".join(each if each.isalnum() else "-" for each in words))
        names.append(name)
        file = folder / (f"{name}.png" if names.count(name) == 1 else f"{name}-{names.count(name)}.png")
        figures.append(ReportFigure(", ".join(filter(None, [scenario, scene, kind])), pixels, caption))
        folder.mkdir(parents=True, exist_ok=True)
        with whole_file(file) as partial:
            Image.fromarray(figures[-1].pixels).save(partial, "png")
    return figures


# Scenario figures: collisions, time to collision, planned collisions and comfort against rain intensity

_PANEL_IN, _DPI = (4.4, 3.3), 120
_ASIDE, _ALL_ASIDE = 0.012, 0.06
"""Horizontal offset between curves, and the maximum of all offsets together, as a share of the highest intensity."""

_LEGEND_COLUMNS, _LEGEND_LINE_IN = 4, 0.2


_PANELS: tuple[tuple[str, str], ...] = (
    ("share of drives with a collision", ""),
    ("least time to collision (s)", "min_ttc_s"),
    ("C: share of planned points that collide", "planned_point_collision_rate"),
    ("S: comfort of the motion as driven", "comfort_executed"),
)


def scenario_figure(cells: Sequence[SummaryCell]) -> UInt8[np.ndarray, "h w 3"]:
    """Draw the results of all agents in one scenario: a panel per measure, a curve per agent.

    The same cells give byte-identical images. Bands are the cells' 95 % intervals; the first panel's are Wilson's.
    """
    rows, columns = 2, len(_PANELS) // 2
    agents = list(dict.fromkeys(cell.title for cell in cells))
    legend_in = _LEGEND_LINE_IN * -(-len(agents) // _LEGEND_COLUMNS)
    size = columns * _PANEL_IN[0], rows * _PANEL_IN[1] + 0.4 + legend_in
    figure = Figure(figsize=size, layout="constrained", dpi=_DPI)
    panels: list[Axes] = list(np.ravel(figure.subplots(rows, columns, sharex=True)))
    styles = series_styles(len(agents))
    # keep equal curves distinguishable
    aside = min(_ASIDE, _ALL_ASIDE / len(agents)) * max(cell.intensity_mm_h for cell in cells)
    for number, (panel, (title, measure)) in enumerate(zip(panels, _PANELS, strict=True)):
        for place, agent in enumerate(agents):
            own = [cell for cell in cells if cell.title == agent]
            _curve(panel, own, measure, styles[place], figure_words(agent, 28), aside * (place - (len(agents) - 1) / 2))
        _dress(panel, title, cells, is_lowest=number >= columns)
    runs = sorted({cell.runs for cell in cells})
    seeds = f"{runs[0]}" if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"
    figure.suptitle(f"{_title(cells)}: {seeds} drives a point", fontsize=11)
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", frameon=False, fontsize=9,
        ncols=min(len(agents), _LEGEND_COLUMNS),
    )  # fmt: skip
    return _pixels(figure)


def _title(cells: Sequence[SummaryCell]) -> str:
    return f"{figure_words(cells[0].scenario)} in {figure_words(PurePath(cells[0].scene).name)}"


def _pixels(figure: Figure) -> UInt8[np.ndarray, "h w 3"]:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _curve(
    panel: Axes, cells: Sequence[SummaryCell], measure: str, style: SeriesStyle, label: str, aside: float
) -> None:
    """Draw a measure of one agent; without a name it is the collision rate."""
    values = [(cell.intensity_mm_h, cell.means.get(measure) if measure else cell.collision_rate) for cell in cells]
    points = [(intensity, spread) for intensity, spread in values if spread is not None]
    x = [each + aside for each, _ in points]
    spreads = [each for _, each in points]
    color, means = style.color, [each.value for each in spreads]
    panel.plot(x, means, linestyle=style.line, marker=style.marker, color=color, label=label, ms=4)
    if len(points) > 1:
        panel.fill_between(x, [s.low for s in spreads], [s.high for s in spreads], color=color, alpha=style.band, lw=0)
    for at, each in zip(x, spreads, strict=True):
        panel.plot([at, at], [each.low, each.high], color=color, alpha=0.6, lw=1)


def _dress(panel: Axes, title: str, cells: Sequence[SummaryCell], *, is_lowest: bool) -> None:
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


# Boundary of failure: collisions over a grid of start speeds, gaps and exposures

_GRID_AXES = {
    "start_speed_m_s": "V0 (m/s)",
    "gap_m": "d (m)",
    "exposure_s": "exposure (s)",
    "diameter_scale": "diameters x",
}
_MAX_CURVES = 12  # a figure over intensity with more curves shows nothing
_CELL_IN = (2.6, 2.3)
_COLLISION_COLORS = "RdYlBu_r"  # red: all collide, blue: none; distinguishable without seeing red and green


def grid_axes(cells: Sequence[SummaryCell]) -> list[str]:
    """Names of the parameters that take several values, at most two."""
    return [name for name in _GRID_AXES if len(_values(cells, name)) > 1][:2]


def boundary_figure(cells: Sequence[SummaryCell], axes: Sequence[str]) -> UInt8[np.ndarray, "h w 3"]:
    """Draw the share of drives with a collision over one or two parameters: a column for each intensity.

    Rows are agents and the choices on other axes. Missing cells are gray.
    """
    rest = {cell.title: structs.replace(cell.variant, **dict.fromkeys(axes)) for cell in cells}
    rows = list(dict.fromkeys((cell.agent, rest[cell.title]) for cell in cells))
    intensities = sorted({cell.intensity_mm_h for cell in cells})
    size = _CELL_IN[0] * len(intensities) + 2.0, _CELL_IN[1] * len(rows) + 0.9
    figure = Figure(figsize=size, layout="constrained", dpi=_DPI)
    panels = figure.subplots(len(rows), len(intensities), squeeze=False, sharex=True, sharey=True)
    for line, (agent, variant) in enumerate(rows):
        for column, intensity in enumerate(intensities):
            panel: Axes = panels[line, column]
            own = [
                cell for cell in cells
                if (cell.agent, rest[cell.title], cell.intensity_mm_h) == (agent, variant, intensity)
            ]  # fmt: skip
            _draw_boundary(panel, own, axes, [_values(cells, name) for name in axes])
            if line == 0:
                panel.set_title(f"{intensity:g} mm/h", fontsize=9.5)
            if line == len(rows) - 1:
                panel.set_xlabel(_GRID_AXES[axes[0]], fontsize=9)
            if column == 0:
                of = figure_words(", ".join(filter(None, [agent, variant.title])), 28)
                panel.set_ylabel(f"{of}\n{_GRID_AXES[axes[1]] if len(axes) > 1 else 'collisions'}", fontsize=9)
    if len(axes) > 1:
        shares = ScalarMappable(Normalize(0, 1), _COLLISION_COLORS)
        figure.colorbar(shares, ax=panels, label="share of drives with a collision", shrink=0.8)
    figure.suptitle(_title(cells), fontsize=11)
    return _pixels(figure)


def _draw_boundary(
    panel: Axes, cells: Sequence[SummaryCell], axes: Sequence[str], values: Sequence[Sequence[float]]
) -> None:
    rates = np.full([len(each) for each in values], np.nan)
    for cell in cells:
        if cell.collision_rate is not None:
            place = tuple(each.index(getattr(cell.variant, name)) for name, each in zip(axes, values, strict=True))
            rates[place] = cell.collision_rate.value
    if len(axes) == 1:
        panel.plot(values[0], rates, marker="o", color="C3")
        panel.axhline(0.5, color="0.4", lw=1)
        panel.set_ylim(-0.03, 1.03)
        return
    panel.set_facecolor("0.85")
    panel.pcolormesh(*values, rates.T, cmap=_COLLISION_COLORS, vmin=0, vmax=1, shading="nearest")
    if np.isfinite(rates).all() and rates.min() < 0.5 < rates.max():
        panel.contour(*values, rates.T, levels=[0.5], colors="black", linewidths=1.5)


def _values(cells: Sequence[SummaryCell], name: str) -> list[float]:
    return sorted({value for cell in cells if (value := getattr(cell.variant, name)) is not None})


# Report page

_MAX_ERRORS = 20
_CHANGED = ("min_ttc_s", "planned_point_collision_rate", "comfort_executed")


def sweep_report_page(
    name: str, sweep: Sweep, numbers: dict[str, Any], figures: Sequence[ReportFigure], tables: Sequence[Table]
) -> RunReport:
    """Return the report page of a sweep; `numbers` is its summary."""
    notes = [f"{count} of {numbers['rows']} failed: {error}" for error, count in list(numbers["errors"].items())]
    if numbers["rows"] < numbers["jobs"]:
        notes.insert(0, f"{numbers['jobs'] - numbers['rows']} of {numbers['jobs']} jobs have not been done yet.")
    if numbers["other_rows"]:
        notes.append(f"{numbers['other_rows']} rows of other settings, scenes or versions lie there and are left out.")
    done = {"jobs": f"{numbers['jobs']:,}", "finished": f"{numbers['rows'] - numbers['failed']:,}"}
    settings = {
        name: value if isinstance(value, str | int | float) else msgspec.json.encode(value).decode()
        for name, value in msgspec.to_builtins(sweep).items()
        if value is not None
    }
    return RunReport(
        title=f"Sweep {name}",
        settings=settings,
        headlines={**done, "failed": f"{numbers['failed']:,}"},
        notes=tuple(notes[:_MAX_ERRORS]),
        figures=tuple(figures),
        tables=tuple(tables),
    )


def _tables(
    sweep: Sweep, rows: Sequence[Row], cells: Sequence[SummaryCell], shares: Sequence[Attribution]
) -> Iterator[Table]:
    """Tables of each scenario, of the shares of rain's factors, and of clips; the first has the definitions."""
    for place, own in enumerate(by_scenario(cells)):
        yield scenario_table(own, defines=place == 0)
        if any(cell.changes for cell in own):
            yield change_table(own)
    if shares:
        yield share_table(shares)
    if isinstance(sweep, RenderSweep):
        named = "scene", "intensity_mm_h", "seed", "cameras", "frames", "sizes_px", "drops", "clip", "error"
        yield table_of("Clips", named, rows)


def scenario_table(cells: Sequence[SummaryCell], *, defines: bool = True) -> Table:
    """Return the table of one scenario in one scene: a row per agent and intensity."""
    failed = any(cell.failed for cell in cells)
    measured = [each if defines else replace(each, definition="") for each in (COLLISIONS, *RESULT_COLUMNS.values())]
    rows: list[tuple[Cell, ...]] = [
        (
            cell.title, cell.intensity_mm_h, cell.runs, *([cell.failed] if failed else []),
            cell.collision_rate, *(cell.means.get(name) for name in RESULT_COLUMNS),
        )
        for cell in cells
    ]  # fmt: skip
    titled = Column("Agent"), RATE, Column("drives"), *(columns(["failed"]) if failed else ()), *measured
    return Table(f"{cells[0].scenario}, {cells[0].scene}", titled, rows, AFTER_COLLISION)


def change_table(cells: Sequence[SummaryCell]) -> Table:
    """Return the paired differences caused by rain: a row per agent and intensity above the lowest."""
    measured = [replace(RESULT_COLUMNS[name], definition="") for name in _CHANGED]
    signed = [replace(each, format=f"+{each.format}") for each in measured]
    rows: list[tuple[Cell, ...]] = [
        (
            cell.title, cell.intensity_mm_h, max(each.n for each in cell.changes.values()),
            *(cell.changes.get(name) for name in _CHANGED),
        )
        for cell in cells if cell.changes
    ]  # fmt: skip
    caption = (
        "Differences from the lowest intensity, each drive's from the one of the same seed; of C and S, where neither "
        "of the two has a collision."
    )
    titled = Column("Agent"), RATE, Column("pairs"), *signed
    return Table(f"{cells[0].scenario}, {cells[0].scene}: what rain changes", titled, rows, caption)
