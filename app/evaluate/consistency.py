"""`gsrain evaluate consistency`: agreement of neighboring views before and after a transfer."""

import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from jaxtyping import UInt8
from PIL import Image

from gsrain_engine.evaluation.consistency import (
    FILM_SHARE,
    PairAgreement,
    ViewFolder,
    WarpAgreement,
    WarpError,
    agreements,
    open_view_folder,
    pool_errors,
    warped_pair,
)
from gsrain_engine.evaluation.consistency_sheet import SheetPair, consistency_sheet
from gsrain_engine.evaluation.input_fingerprint import input_fingerprint
from gsrain_engine.evaluation.report import ReportFigure, ReportTable, RunReport, write_report
from gsrain_engine.render.images import write_image
from gsrain_engine.scene.open import file_hash

from ..console import Console, Table, bold, print
from ..options import (
    AllowOutside,
    JsonFileOrScreen,
    check_image,
    check_page,
    let_names_lead_outside,
    table_stream,
    write_numbers,
)
from ..progress import progress_bar
from .images import perceived_distance
from .run_facts import provenance_lines, run_provenance, write_report_numbers

_COLUMNS = 150
_Pairs = list[tuple[int, int]]


def consistency(
    folders: Annotated[
        tuple[Path, ...],
        Parameter(name="DIR", help="What gsrain transfer has written, or captures with depth, side by side."),
    ],
    /,
    *,
    neighbours: Annotated[int, Parameter(help="Neighbours that each view is compared with.")] = 2,
    film: Annotated[
        float, Parameter(help="Share of mirrored light, 0..1, from which on a pixel counts as water film.")
    ] = FILM_SHARE,
    width: Annotated[int | None, Parameter(help="Most pixels across a capture's pictures; default: 960.")] = None,
    lpips: Annotated[
        str | None,
        Parameter(help="LPIPS too: alex (some seconds a pair) or vgg (slower) of this machine, or a file of weights."),
    ] = None,
    sheet: Annotated[Path | None, Parameter(help="Picture of some pairs, warped, with their errors (.png).")] = None,
    sheet_pairs: Annotated[int, Parameter(help="Pairs on that picture.")] = 4,
    report: Annotated[
        Path | None, Parameter(help="Also write a page of HTML with that picture, and the numbers as JSON beside it.")
    ] = None,
    allow_outside: AllowOutside = False,
    json: JsonFileOrScreen = None,
) -> None:
    """Warp neighboring views onto each other by their depth, and compare: before a transfer, and after it.

    The error after should be that before: what a transfer adds differently in each view increases it. Reflections in
    water move with the eye, so errors outside the water film are reported as well. Errors are root mean squares over
    matched pixels, in levels of 255; "per contrast" divides each by its image's contrast.
    """
    let_names_lead_outside(allow_outside)
    _check(folders, neighbours, film, sheet_pairs)
    check_image("--sheet", sheet)
    check_page(report, json, sheet)
    compared = [open_view_folder(folder, width) for folder in folders]
    pairs = compared[0].chosen(neighbours)
    if not pairs and not compared[0].has_poses:
        raise ValueError(f"{folders[0]}: it is not known where its pictures were taken; expected a capture with poses")
    if not pairs:
        raise ValueError(f"{folders[0]}: no two views show the same place, or their depth is not known")
    own_pairs = [each.alike(compared[0], pairs) for each in compared]
    perceived = None if lpips is None else perceived_distance(lpips)
    results: list[list[PairAgreement]] = []
    with progress_bar("Comparing", len(pairs) * len(compared)) as advance:
        for each, own in zip(compared, own_pairs, strict=True):
            rows: list[PairAgreement] = []
            for pair in own:
                rows += agreements(each.views, [pair], has_clear=each.has_clear, film_share=film, perceived=perceived)
                advance()
            if not rows:
                raise ValueError(f"{each.folder}: neighbouring views match in too few pixels to be compared")
            results.append(rows)
    print_agreements(compared, results, Console(file=table_stream(json), width=_COLUMNS))
    numbers = report_of(compared, results, film) | run_provenance(_inputs(folders, lpips), ("torch",))
    if sheet is not None or report is not None:
        drawn = _drawn(compared, own_pairs, film, sheet_pairs)
        if sheet is not None:
            write_image(sheet, Image.fromarray(drawn))
            print(f"wrote {sheet}", file=sys.stderr)
        if report is not None:
            write_report(report, consistency_page(numbers, drawn, {"neighbours": neighbours, "LPIPS": lpips or "-"}))
            beside = write_report_numbers(report, json, numbers)
            print(f"wrote {report}" + (f", {beside}" if beside else ""), file=sys.stderr)
    write_numbers(json, numbers)


def _inputs(folders: Sequence[Path], lpips: str | None) -> dict[str, str]:
    """Return hashes over names, sizes and times of the compared files, and of the bytes of a weights file."""
    found = {str(folder): input_fingerprint(folder) for folder in folders}
    return found | {f"LPIPS {lpips}": file_hash(Path(lpips))} if lpips and Path(lpips).is_file() else found


def _check(folders: Sequence[Path], neighbours: int, film: float, sheet_pairs: int) -> None:
    if not folders:
        raise ValueError("expected one or more folders")
    if not 1 <= neighbours <= 16:
        raise ValueError(f"--neighbours {neighbours}: must be within 1..16")
    if not 0 <= film <= 1:
        raise ValueError(f"--film {film:g}: must be within 0..1")
    if not 1 <= sheet_pairs <= 40:
        raise ValueError(f"--sheet-pairs {sheet_pairs}: must be within 1..40")


def _drawn(
    compared: Sequence[ViewFolder], pairs: Sequence[_Pairs], film: float, most: int
) -> UInt8[np.ndarray, "h w 3"]:
    count = min(most, len(pairs[0]))
    chosen = [i * len(pairs[0]) // count for i in range(count)]
    shown = [
        [
            SheetPair(each.title, warped_pair(each.views[own[i][0]], each.views[own[i][1]], film), each.has_clear)
            for each, own in zip(compared, pairs, strict=True)
        ]
        for i in chosen
    ]
    return consistency_sheet(shown)


# Numbers as a table and as JSON

_LEVELS = 255
_MAX_ROWS = 40  # maximum number of pairs printed per folder; the JSON has all


def report_of(
    compared: Sequence[ViewFolder], results: Sequence[Sequence[PairAgreement]], film: float
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


def _means(rows: Sequence[PairAgreement]) -> tuple[WarpAgreement | None, WarpAgreement | None]:
    return pool_errors(row.everywhere for row in rows), pool_errors(
        row.outside_film for row in rows if row.outside_film
    )


def _numbers(agreement: WarpAgreement | None) -> dict[str, Any]:
    """Return plain numbers of an agreement, errors in display values of 0..1; null if unknown."""
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
    compared: Sequence[ViewFolder], results: Sequence[Sequence[PairAgreement]], console: Console
) -> None:
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
            mean = f"mean of {len(rows)} pairs" + (f", above the {_MAX_ROWS} worst" if len(rows) > _MAX_ROWS else "")
            table.add_row(bold(mean), "", "", *_cells(everywhere, dry, with_lpips))
    console.print(table)
    console.print(
        "Errors of the neighbour warped onto the view, in levels of 255; dry: share of the matched pixels that lies "
        "outside the water film, and the errors there."
    )


def _worst(rows: Sequence[PairAgreement]) -> list[PairAgreement]:
    """Return all pairs in order, or only those with the largest errors if there are many."""
    if len(rows) <= _MAX_ROWS:
        return list(rows)
    return sorted(rows, key=lambda row: -row.everywhere.after.rmse)[:_MAX_ROWS]


def _cells(everywhere: WarpAgreement, dry: WarpAgreement | None, with_lpips: bool) -> list[str]:
    cells = [*_error_cells(everywhere), _ratio(everywhere.contrast_ratio)]
    cells += ["", "", "", ""] if dry is None else [f"{dry.pixels / everywhere.pixels:.0%}", *_error_cells(dry)]
    if with_lpips:
        before = everywhere.before.lpips if everywhere.before is not None else None
        cells += [_lpips(before), _lpips(everywhere.after.lpips), _ratio(everywhere.lpips_ratio)]
    return cells


def _error_cells(agreement: WarpAgreement) -> list[str]:
    before = "" if agreement.before is None else f"{_LEVELS * agreement.before.rmse:.2f}"
    return [before, f"{_LEVELS * agreement.after.rmse:.2f}", _ratio(agreement.ratio)]


def _ratio(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}"


def _lpips(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


# HTML page

_CAPTION = (
    "Root mean square errors of a neighbour warped onto the view, in levels of 255. ratio: after over before; per "
    "contrast: each divided by its picture's contrast first; dry: outside the water film, which moves with the eye."
)

_PAGE_COLUMNS = ("before", "after", "ratio", "per contrast", "LPIPS before", "LPIPS after")
_NUMBERS = ("rmse_before", "rmse_after", "ratio", "contrast_ratio", "lpips_before", "lpips_after")


def consistency_page(
    numbers: Mapping[str, Any], sheet: UInt8[np.ndarray, "h w 3"], settings: Mapping[str, object]
) -> RunReport:
    """Lay out the page; `numbers` are those of `--json`, `sheet` shows some pairs."""
    means, rows = numbers["means"], numbers["rows"]
    folders = tuple((_name(each), each["pairs"], *_page_cells(each), *_dry(each)) for each in means)
    pairs = tuple(
        (_name(row), row["of"], row["to"], row["matched_share"], *_page_cells(row), *_dry(row)) for row in rows
    )
    how = {f"made by, {_name(each)}": str(each["settings"]) for each in means if each["settings"]}
    about = {"film share": numbers["film_share"], **settings, **how}
    columns = (*_PAGE_COLUMNS, "dry before", "dry after", "dry ratio")
    return RunReport(
        title="Agreement of neighbouring views",
        settings={**about, **provenance_lines(numbers)},
        headlines={f"error after, {_name(each)}": f"{_LEVELS * each['rmse_after']:.2f}" for each in means},
        figures=(ReportFigure("Pairs, warped", sheet, is_photograph=True),),
        tables=(
            ReportTable("Means", ("folder", "pairs", *columns), folders, caption=_CAPTION),
            ReportTable("Pairs", ("folder", "view", "neighbour", "matched", *columns), pairs, caption=_CAPTION),
        ),
    )


def _name(row: Mapping[str, Any]) -> str:
    return f"{row['folder']} ({row['method']})" if row["method"] else str(row["folder"])


def _page_cells(row: Mapping[str, Any]) -> list[float | None]:
    return [_in_levels(name, row.get(name)) for name in _NUMBERS]


def _dry(row: Mapping[str, Any]) -> list[float | None]:
    dry = row["outside_film"]
    return [_in_levels(name, dry.get(name)) for name in ("rmse_before", "rmse_after", "ratio")]


def _in_levels(name: str, value: float | None) -> float | None:
    return _LEVELS * value if value is not None and name.startswith("rmse") else value
