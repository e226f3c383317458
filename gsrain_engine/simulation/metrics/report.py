"""HTML report of drives: results, motion over time, bird's-eye views, and settings."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from importlib import metadata

import msgspec
from msgspec import structs

from ...evaluation.detection.figures import figure_pixels
from ...report.page import ReportFigure, RunReport
from ...report.table import Cell, Column, Table
from ..geometry import Route
from ..rollout import Rollout
from .figures import birds_eye_sheet, kinematics_figure
from .summary import (
    AFTER_COLLISION,
    RATE,
    RESULT_COLUMNS,
    DriveComparison,
    ScoredRun,
    compare_drives,
    is_measured,
    results_table,
)

_MAX_FROM_ABOVE = 8
_PACKAGES = ("gsrain", "numpy", "scipy", "shapely", "numba")

_OVER_TIME = (
    "One color an intensity; a cross is a collision. The acceleration is that over each step. Several seeds: the mean "
    "over the runs that still go on, with the band of its 95 % bootstrap interval."
)

_FROM_ABOVE = "In the frame of the start; boxes every second, darker with time; dots are planned points."


def rollout_hash(rollout: Rollout) -> str:
    """Return the SHA-256 of a roll-out, equal for equal runs on every machine."""
    return hashlib.sha256(msgspec.json.encode(rollout, order="sorted")).hexdigest()


def drive_report_page(
    runs: Sequence[ScoredRun],
    routes: Mapping[str, Route] | None = None,
    settings: Mapping[str, object] | None = None,
    notes: tuple[str, ...] = (),
) -> RunReport:
    """Build the report page of runs. `routes` are by scene name; `settings` precede the facts of the runs.

    Runs without a roll-out appear only in tables. Write it with `write_report`.
    """
    comparisons = compare_drives(runs)
    rollouts = [run.rollout for run in runs if run.rollout is not None]
    versions = {name: metadata.version(name) for name in _PACKAGES}
    for rollout in rollouts:
        versions.update(rollout.software)
    values: dict[str, Iterable[str]] = {
        "scenes": (run.metrics.scene for run in runs),
        "scene hashes": (each.scene_hash[:16] for each in rollouts if each.scene_hash),
        "intensities (mm/h)": (f"{run.metrics.intensity_mm_h:g}" for run in runs),
        "seeds": (str(run.metrics.seed) for run in runs),
        "agents": (run.metrics.agent for run in runs),
        "step (s)": (f"{each.step_s:g}" for each in rollouts),
        "time between planned points (s)": (f"{each.spacing_s:g}" for each in rollouts),
        "SHA-256 of the roll-outs": (rollout_hash(each)[:16] for each in rollouts),
        "versions": (f"{name} {version}" for name, version in versions.items()),
    }
    facts = {name: ", ".join(dict.fromkeys(each)) for name, each in values.items()}
    return RunReport(
        title="Driving in rain: " + ", ".join(dict.fromkeys(each.scenario for each in comparisons)),
        settings={**(settings or {}), **facts},
        figures=tuple(figure for each in comparisons for figure in _figures(each, (routes or {}).get(each.scene))),
        tables=(results_table(comparisons), _runs_table(runs)),
        headlines={
            "runs": str(len(runs)),
            "collisions": str(sum(run.metrics.collision for run in runs)),
            "least time to collision": f"{min(run.metrics.min_ttc_s for run in runs):.2f} s" if runs else "-",
        },
        notes=notes,
        held_out=False,
    )


def _figures(comparison: DriveComparison, route: Route | None) -> list[ReportFigure]:
    """Draw figures over time, and the bird's-eye view of the first run of each intensity, given roll-outs."""
    figures: list[ReportFigure] = []
    if all(run.rollout is not None for run in comparison.runs):
        figures.append(ReportFigure(comparison.title, figure_pixels(kinematics_figure(comparison)), _OVER_TIME))
    first = [weather.runs[0].rollout for weather in comparison.weathers]
    rollouts = [each for each in first if each is not None][:_MAX_FROM_ABOVE]
    if rollouts:
        image = figure_pixels(birds_eye_sheet(rollouts, route))
        figures.append(ReportFigure(f"{comparison.title}, from above", image, _FROM_ABOVE))
    return figures


_COLUMNS = {
    "seed": Column("seed"), "end": Column("end"), "duration_s": Column("for", ".2f", "s"),
    "collided_with": Column("hit"), "min_gap_m": Column("gap", ".3f", "m"), **RESULT_COLUMNS,
    "pdms": Column("PDMS", ".3f"), "hdscore": Column("HD-score", ".3f"),
}  # fmt: skip


def _runs_table(runs: Sequence[ScoredRun]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for metrics in (structs.asdict(run.metrics) for run in runs):
        values = [metrics[name] if is_measured(name, metrics) else None for name in _COLUMNS]
        rows.append((metrics["scenario"], metrics["agent"], metrics["intensity_mm_h"], *values))
    columns = [replace(each, definition="") for each in _COLUMNS.values()]
    caption = f"{AFTER_COLLISION} HD-score as in HUGSIM; the drivable area counts where it is known."
    return Table("Every run", (Column("scenario"), Column("agent"), RATE, *columns), rows, caption)
