"""The page of `gsrain evaluate consistency`: errors of neighbouring views by folder and by pair."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import UInt8

from gsrain_engine.evaluate.report.run_report import Figure, ReportTable, RunReport

from .run_facts import told_facts

_CAPTION = (
    "Root mean square errors of a neighbour warped onto the view, in levels of 255. ratio: after over before; per "
    "contrast: each divided by its picture's contrast first; dry: outside the water film, which moves with the eye."
)
_COLUMNS = ("before", "after", "ratio", "per contrast", "LPIPS before", "LPIPS after")
_NUMBERS = ("rmse_before", "rmse_after", "ratio", "contrast_ratio", "lpips_before", "lpips_after")
_LEVELS = 255


def consistency_page(
    numbers: Mapping[str, Any], sheet: UInt8[np.ndarray, "h w 3"], settings: Mapping[str, object]
) -> RunReport:
    """Lay out the page; `numbers` are those of `--json`, `sheet` shows some pairs."""
    means, rows = numbers["means"], numbers["rows"]
    folders = tuple((_name(each), each["pairs"], *_cells(each), *_dry(each)) for each in means)
    pairs = tuple((_name(row), row["of"], row["to"], row["matched_share"], *_cells(row), *_dry(row)) for row in rows)
    how = {f"made by, {_name(each)}": str(each["settings"]) for each in means if each["settings"]}
    about = {"film share": numbers["film_share"], **settings, **how}
    columns = (*_COLUMNS, "dry before", "dry after", "dry ratio")
    return RunReport(
        title="Agreement of neighbouring views",
        settings={**about, **told_facts(numbers)},
        headlines={f"error after, {_name(each)}": f"{_LEVELS * each['rmse_after']:.2f}" for each in means},
        figures=(Figure("Pairs, warped", sheet, is_photograph=True),),
        tables=(
            ReportTable("Means", ("folder", "pairs", *columns), folders, caption=_CAPTION),
            ReportTable("Pairs", ("folder", "view", "neighbour", "matched", *columns), pairs, caption=_CAPTION),
        ),
    )


def _name(row: Mapping[str, Any]) -> str:
    return f"{row['folder']} ({row['method']})" if row["method"] else str(row["folder"])


def _cells(row: Mapping[str, Any]) -> list[float | None]:
    return [_in_levels(name, row.get(name)) for name in _NUMBERS]


def _dry(row: Mapping[str, Any]) -> list[float | None]:
    dry = row["outside_film"]
    return [_in_levels(name, dry.get(name)) for name in ("rmse_before", "rmse_after", "ratio")]


def _in_levels(name: str, value: float | None) -> float | None:
    return _LEVELS * value if value is not None and name.startswith("rmse") else value
