"""The page of `gsrain evaluate lidar`: its figure, and what is kept, lost and made up at each intensity."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gsrain_engine.evaluate.lidar.runs import RunCounts
from gsrain_engine.evaluate.report.report_file import write_report
from gsrain_engine.evaluate.report.run_report import Figure, ReportTable, RunReport

from .run_facts import told_facts

_NOTES = (
    "False returns hang on the sensor's least reflectance near by, which makers don't state.",
    "Spreads are those of the drops: they say nothing of other places.",
)


def write_lidar_page(
    file: Path, figure: Path, by_intensity: Mapping[float, Sequence[RunCounts]], report: Mapping[str, Any]
) -> None:
    """Write the page; `report` is what `lidar_report` gives, `figure` the picture to show first."""
    with Image.open(figure) as opened:
        pixels = np.asarray(opened.convert("RGB"))
    told = told_facts(report)
    settings = {name: value for name, value in report.items() if name not in ("sensor", "rows", "versions", "inputs")}
    settings |= told
    runs = len(next(iter(by_intensity.values())))
    write_report(
        file,
        RunReport(
            title=f"Lidar in rain: {report['source']}",
            settings=settings | {f"sensor: {name}": value for name, value in report["sensor"].items()},
            figures=(Figure("From above, and by range", pixels),),
            tables=(_totals(by_intensity), _by_range(by_intensity)),
            headlines={"runs of each intensity": str(runs)},
            notes=_NOTES,
        ),
    )


def _totals(by_intensity: Mapping[float, Sequence[RunCounts]]) -> ReportTable:
    rows: list[tuple[str | float | None, ...]] = []
    for intensity, runs in by_intensity.items():
        clear, kept, dropped, masked, false = (
            np.array([getattr(run.tally, name).sum() for run in runs], np.float64)
            for name in ("clear", "kept", "dropped", "masked", "false")
        )
        share = float(100 * kept.sum() / max(clear.sum(), 1))
        beta = 1e3 * runs[0].state.extinction_per_m
        rows.append(
            (f"{intensity:g}", beta, runs[0].wetness, float(clear.mean()), share, float(dropped.mean()),
             float(masked.mean()), float(false.mean()), float(false.min()), float(false.max()))
        )  # fmt: skip
    columns = (
        "mm/h", "beta 1/km", "wetness", "clear", "kept %", "too weak", "behind a drop", "drops", "least", "most"
    )  # fmt: skip
    return ReportTable("Returns", columns, tuple(rows), decimals=2, caption="Means of the runs of each intensity.")


def _by_range(by_intensity: Mapping[float, Sequence[RunCounts]]) -> ReportTable:
    edges = next(iter(by_intensity.values()))[0].tally.edges_m.tolist()
    ends = [f"{a:g}-{b:g} m" if math.isfinite(b) else f"> {a:g} m" for a, b in pairwise(edges)]
    rows: list[tuple[str | float | None, ...]] = []
    for intensity, runs in by_intensity.items():
        kept, clear = (np.sum([getattr(run.tally, name) for run in runs], axis=0) for name in ("kept", "clear"))
        rows.append((f"{intensity:g}", *(float(100 * k / c) if c else None for k, c in zip(kept, clear, strict=True))))
    caption = "Per cent of the returns in clear weather."
    return ReportTable("Kept, by range", ("mm/h", *ends), tuple(rows), decimals=1, caption=caption)
