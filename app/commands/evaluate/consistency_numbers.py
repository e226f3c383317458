"""The numbers of `gsrain evaluate consistency`: as a table for a person, and as plain values for a file."""

import math
from collections.abc import Sequence
from typing import Any

from gsrain_engine.evaluate.consistency.folders import ComparedViews
from gsrain_engine.evaluate.consistency.pairs import PairAgreement
from gsrain_engine.evaluate.consistency.warp_error import Agreement, WarpError, pooled

from ...console import Console, Table, bold

_LEVELS = 255
_MOST_ROWS = 40
"""Pairs that are printed of each folder; all are in the JSON."""


def report_of(
    compared: Sequence[ComparedViews], results: Sequence[Sequence[PairAgreement]], film: float
) -> dict[str, Any]:
    """Return the plain values of `--json`: means of each folder and rows of each pair."""
    means: list[dict[str, Any]] = []
    rows: list[dict[str, Any]] = []
    for each, own in zip(compared, results, strict=True):
        about = {"folder": str(each.folder), "method": each.method}
        everywhere, dry = _means(own)
        means.append(
            {
                **about,
                "settings": each.settings,
                "pairs": len(own),
                **_numbers(everywhere),
                "outside_film": _numbers(dry),
            }
        )
        rows += [
            {
                **about,
                "of": row.of,
                "to": row.to,
                "matched_share": row.matched_share,
                **_numbers(row.everywhere),
                "outside_film": _numbers(row.outside_film),
            }
            for row in own
        ]
    return {"film_share": film, "means": means, "rows": rows}


def _means(rows: Sequence[PairAgreement]) -> tuple[Agreement | None, Agreement | None]:
    return pooled(row.everywhere for row in rows), pooled(row.outside_film for row in rows if row.outside_film)


def _numbers(agreement: Agreement | None) -> dict[str, Any]:
    """Return plain numbers of an agreement, errors in display values of 0..1; null where they are not known."""
    if agreement is None:
        return {"pixels": 0}
    before = agreement.before or WarpError(math.nan, math.nan)
    numbers = {
        "pixels": agreement.pixels,
        "rmse_before": before.rmse,
        "rmse_after": agreement.after.rmse,
        "ratio": agreement.ratio,
        "contrast_before": before.contrast,
        "contrast_after": agreement.after.contrast,
        "contrast_ratio": agreement.contrast_ratio,
        "lpips_before": before.lpips,
        "lpips_after": agreement.after.lpips,
        "lpips_ratio": agreement.lpips_ratio,
    }
    return {name: None if isinstance(value, float) and math.isnan(value) else value for name, value in numbers.items()}


def print_agreements(
    compared: Sequence[ComparedViews], results: Sequence[Sequence[PairAgreement]], console: Console
) -> None:
    """Print a table of pairs and means, folder by folder."""
    with_lpips = any(row.everywhere.after.lpips is not None for rows in results for row in rows)
    names = [
        "view",
        "neighbour",
        "matched",
        "before",
        "after",
        "ratio",
        "per contrast",
        "dry",
        "dry before",
        "dry after",
        "dry ratio",
    ]
    table = Table(*names, *(["LPIPS before", "after", "ratio"] if with_lpips else []), box=None)
    for each, rows in zip(compared, results, strict=True):
        table.add_section()
        table.add_row(bold(each.title))
        for row in _worst(rows):
            cells = [row.of, row.to, f"{row.matched_share:.0%}"]
            table.add_row(*cells, *_cells(row.everywhere, row.outside_film, with_lpips))
        everywhere, dry = _means(rows)
        if everywhere is not None:
            mean = f"mean of {len(rows)} pairs" + (f", above the {_MOST_ROWS} worst" if len(rows) > _MOST_ROWS else "")
            table.add_row(bold(mean), "", "", *_cells(everywhere, dry, with_lpips))
    console.print(table)
    console.print(
        "Errors of the neighbour warped onto the view, in levels of 255; dry: share of the matched pixels that lies "
        "outside the water film, and the errors there."
    )


def _worst(rows: Sequence[PairAgreement]) -> list[PairAgreement]:
    """All pairs in their order; of many, those whose error is largest."""
    if len(rows) <= _MOST_ROWS:
        return list(rows)
    return sorted(rows, key=lambda row: -row.everywhere.after.rmse)[:_MOST_ROWS]


def _cells(everywhere: Agreement, dry: Agreement | None, with_lpips: bool) -> list[str]:
    cells = [*_error_cells(everywhere), _ratio(everywhere.contrast_ratio)]
    cells += ["", "", "", ""] if dry is None else [f"{dry.pixels / everywhere.pixels:.0%}", *_error_cells(dry)]
    if with_lpips:
        before = everywhere.before.lpips if everywhere.before is not None else None
        cells += [_lpips(before), _lpips(everywhere.after.lpips), _ratio(everywhere.lpips_ratio)]
    return cells


def _error_cells(agreement: Agreement) -> list[str]:
    before = "" if agreement.before is None else f"{_LEVELS * agreement.before.rmse:.2f}"
    return [before, f"{_LEVELS * agreement.after.rmse:.2f}", _ratio(agreement.ratio)]


def _ratio(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}"


def _lpips(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"
