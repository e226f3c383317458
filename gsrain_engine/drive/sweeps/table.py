"""The rows of a sweep as one table, with what they say together: files beside the rows."""

from collections.abc import Iterable, Sequence
from pathlib import Path, PurePath
from typing import Any

import msgspec
from PIL import Image

from gsrain_engine.evaluate.report.report_file import write_report
from gsrain_engine.evaluate.report.run_report import Figure
from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.scene.file_names import shortened

from .figures import scenario_figure
from .job import DriveJob, Job
from .page import sweep_page
from .row import FAILED, Row, comma_separated, encoded, parquet
from .summary import Cell, by_scenario, summarized
from .sweep import Sweep
from .sweep_folder import SweepFolder


def write_tables(folder: SweepFolder, sweep: Sweep, jobs: Sequence[Job]) -> dict[str, Any]:
    """Merge the rows that stand there into table.parquet, table.csv, summary.json, figures and report.html.

    Everything but the report is the same bytes for the same rows. Returns the summary as plain values. Raises
    ValueError where no row stands there, OSError where something can't be written.
    """
    found = folder.read(jobs)
    rows = [found[job.id] for job in jobs if job.id in found]
    if not rows:
        raise ValueError(f"{folder.path}: there are no rows of this sweep yet")
    kind = "drive" if isinstance(jobs[0], DriveJob) else "render"
    cells = summarized(rows) if kind == "drive" else []
    numbers = _numbers(folder, jobs, rows, cells)
    figures = _written_figures(folder.path / "figures", by_scenario(cell for cell in cells if cell.runs))
    for name, data in (
        ("table.parquet", parquet(rows, kind)),
        ("table.csv", comma_separated(rows, kind).encode()),
        ("summary.json", encoded(numbers)),
    ):
        with whole_file(folder.path / name) as beside:
            beside.write_bytes(data)
    write_report(folder.path / "report.html", sweep_page(folder.path.name, sweep, numbers, rows, cells, figures))
    return numbers


def _numbers(folder: SweepFolder, jobs: Sequence[Job], rows: Sequence[Row], cells: Sequence[Cell]) -> dict[str, Any]:
    failed = [row for row in rows if row["status"] == FAILED]
    return {
        "jobs": len(jobs),
        "rows": len(rows),
        "failed": len(failed),
        "other_rows": folder.others(jobs),
        "errors": _errors(failed),
        "cells": msgspec.to_builtins(cells),
    }


def _errors(failed: Iterable[Row]) -> dict[str, int]:
    """Count each error's jobs, the most frequent first."""
    counts: dict[str, int] = {}
    for row in failed:
        counts[str(row["error"])] = counts.get(str(row["error"]), 0) + 1
    return dict(sorted(counts.items(), key=lambda each: (-each[1], each[0])))


def _written_figures(folder: Path, scenarios: Sequence[Sequence[Cell]]) -> list[Figure]:
    """Draw each scenario into a file of its name and its scene's; those of equal names are numbered."""
    caption = "Bands: 95 %, over the seeds; of collisions Wilson's interval, of means a bootstrap."
    figures: list[Figure] = []
    names: list[str] = []
    for cells in scenarios:
        scenario, scene = cells[0].scenario, cells[0].scene
        name = shortened("".join(each if each.isalnum() else "-" for each in f"{scenario}-{PurePath(scene).stem}"))
        names.append(name)
        file = folder / (f"{name}.png" if names.count(name) == 1 else f"{name}-{names.count(name)}.png")
        figures.append(Figure(f"{scenario}, {scene}", scenario_figure(cells), caption))
        folder.mkdir(parents=True, exist_ok=True)
        with whole_file(file) as beside:
            Image.fromarray(figures[-1].pixels).save(beside, "png")
    return figures
