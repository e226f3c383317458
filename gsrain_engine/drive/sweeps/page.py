"""The page of a sweep: its figures, and what they show as tables."""

from collections.abc import Sequence
from typing import Any

import msgspec

from gsrain_engine.evaluate.report.run_report import Figure, ReportTable, RunReport

from .row import Row
from .summary import MEASURED, Cell, Spread, by_scenario
from .sweep import Sweep

_MOST_ERRORS = 20
_BANDED = 1
"""Of the measured columns so many have room for their intervals; summary.json has all."""
_CHANGED = ("min_ttc_s", "planned_point_collision_rate", "comfort_executed")


def sweep_page(
    name: str,
    sweep: Sweep,
    numbers: dict[str, Any],
    rows: Sequence[Row],
    cells: Sequence[Cell],
    figures: Sequence[Figure],
) -> RunReport:
    """Lay out the page of a sweep; `numbers` is its summary, `figures` those of its scenarios."""
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
        notes=tuple(notes[:_MOST_ERRORS]),
        figures=tuple(figures),
        tables=_tables(cells) if cells else (_clips(rows),),
    )


def _tables(cells: Sequence[Cell]) -> tuple[ReportTable, ...]:
    tables: list[ReportTable] = []
    for own in by_scenario(cells):
        tables.append(scenario_table(own))
        if any(cell.changes for cell in own):
            tables.append(change_table(own))
    return tuple(tables)


def scenario_table(cells: Sequence[Cell]) -> ReportTable:
    """Lay the cells of one scenario in one scene out as a table: a row an agent and intensity."""
    banded, plain = list(MEASURED)[:_BANDED], list(MEASURED)[_BANDED:]
    failed = any(cell.failed for cell in cells)
    columns = (
        "agent", "R (mm/h)", "drives", *(["failed"] if failed else []), "collisions", "95 %",
        *(each for name in banded for each in (MEASURED[name], "95 %")), *(MEASURED[name] for name in plain),
    )  # fmt: skip
    rows = tuple(
        (
            cell.agent,
            cell.intensity_mm_h,
            cell.runs,
            *([cell.failed] if failed else []),
            *_pair(cell.collision_rate),
            *(each for name in banded for each in _pair(cell.means.get(name))),
            *(_pair(cell.means.get(name))[0] for name in plain),
        )
        for cell in cells
    )
    caption = (
        "Collisions: share of the drives, with Wilson's interval. C and S are the paper's, of points or frames of the "
        "plans, and of the motion as driven or as planned; means over the seeds, with bootstrap intervals."
    )
    return ReportTable(f"{cells[0].scenario}, {cells[0].scene}", columns, rows, 2, caption)


def change_table(cells: Sequence[Cell]) -> ReportTable:
    """Lay out what rain changes in one scenario, seed by seed: a row an agent and intensity above the lowest."""
    columns = ("agent", "R (mm/h)", "pairs", *(each for name in _CHANGED for each in (MEASURED[name], "95 %")))
    changed = [cell for cell in cells if cell.changes]
    rows = tuple(
        (
            cell.agent,
            cell.intensity_mm_h,
            max(each.count for each in cell.changes.values()),
            *(each for name in _CHANGED for each in _pair(cell.changes.get(name))),
        )
        for cell in changed
    )
    caption = "Differences from the lowest intensity, each drive's from the one of the same seed."
    return ReportTable(f"{cells[0].scenario}, {cells[0].scene}: what rain changes", columns, rows, 2, caption)


def _clips(rows: Sequence[Row]) -> ReportTable:
    columns = ("scene", "intensity_mm_h", "seed", "cameras", "frames", "sizes_px", "drops", "clip", "error")
    return ReportTable("Clips", columns, tuple(tuple(row[name] for name in columns) for row in rows))


def _pair(spread: Spread | None) -> tuple[float | None, str]:
    return (None, "") if spread is None else (spread.mean, f"{spread.low:.2f} to {spread.high:.2f}")
