"""`gsrain evaluate consistency`: agreement of neighboring views before and after a transfer."""

import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
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
from gsrain_engine.evaluation.report import ReportFigure, ReportTable, RunReport, input_fingerprint
from gsrain_engine.render.images import write_image
from gsrain_engine.scene.open import file_hash

from ..console import Console, bold, print, progress_bar, table_of
from ..options import AllowOutside, JsonFileOrScreen, check_within, let_names_lead_outside, option
from ..outputs import check_image, check_page, provenance_lines, run_provenance, table_stream, write_numbers, write_page
from .images import LpipsChoice, Report, open_lpips

_COLUMNS = 150


def consistency(
    folders: Annotated[tuple[Path, ...], option("Output folders of gsrain transfer, or captures with depth.", "DIR")],
    /,
    *,
    neighbors: Annotated[int, option("Number of neighbors that each view is compared with.")] = 2,
    water_film: Annotated[float, option("Minimum share of reflected light, 0..1, of water film.")] = FILM_SHARE,
    width: Annotated[int | None, option("Maximum width of a capture's images; default: 960.")] = None,
    lpips: LpipsChoice = None,
    contact_sheet: Annotated[Path | None, option("Image of some pairs, warped, with their errors (.png).")] = None,
    contact_sheet_pairs: Annotated[int, option("Number of pairs on that image.")] = 4,
    report: Report = None,
    allow_outside: AllowOutside = False,
    json: JsonFileOrScreen = None,
) -> None:
    """Warp neighboring views onto each other by their depth, and compare: before a transfer, and after it.

    The error after should be that before: what a transfer adds differently in each view increases it. Reflections in
    water move with the eye, so errors outside the water film are reported as well. Errors are root mean squares over
    matched pixels, in levels of 255; "per contrast" divides each by its image's contrast.
    """
    let_names_lead_outside(allow_outside)
    if not folders:
        raise ValueError("expected one or more folders")
    check_within("--neighbors", neighbors, 1, 16)
    check_within("--water-film", water_film, 0, 1)
    check_within("--contact-sheet-pairs", contact_sheet_pairs, 1, 40)
    check_image("--contact-sheet", contact_sheet)
    check_page(report, json, contact_sheet)
    compared = [open_view_folder(folder, width) for folder in folders]
    pairs = compared[0].chosen(neighbors)
    if not pairs and not compared[0].has_poses:
        raise ValueError(f"{folders[0]}: it is not known where its pictures were taken; expected a capture with poses")
    if not pairs:
        raise ValueError(f"{folders[0]}: no two views show the same place, or their depth is not known")
    own_pairs = [each.alike(compared[0], pairs) for each in compared]
    lpips_of = None if lpips is None else open_lpips(lpips)
    results: list[list[PairAgreement]] = []
    with progress_bar("Comparing", len(pairs) * len(compared)) as advance:
        for each, own in zip(compared, own_pairs, strict=True):
            rows: list[PairAgreement] = []
            for pair in own:
                rows += agreements(
                    each.views, [pair], has_clear=each.has_clear, film_share=water_film, perceived=lpips_of
                )
                advance()
            if not rows:
                raise ValueError(f"{each.folder}: neighboring views match in too few pixels to be compared")
            results.append(rows)
    print_agreements(compared, results, Console(file=table_stream(json), width=_COLUMNS))
    inputs = {str(folder): input_fingerprint(folder) for folder in folders}
    if lpips and Path(lpips).is_file():
        inputs[f"LPIPS {lpips}"] = file_hash(Path(lpips))
    numbers = report_of(compared, results, water_film) | run_provenance(inputs, ("torch",))
    if contact_sheet is not None or report is not None:
        sheet = _sheet(compared, own_pairs, water_film, contact_sheet_pairs)
        if contact_sheet is not None:
            write_image(contact_sheet, Image.fromarray(sheet))
            print(f"wrote {contact_sheet}", file=sys.stderr)
        if report is not None:
            settings = {"neighbours": neighbors, "LPIPS": lpips or "-"}
            write_page(report, consistency_page(numbers, sheet, settings), json, numbers)
    write_numbers(json, numbers)


def _sheet(
    compared: Sequence[ViewFolder], pairs: Sequence[list[tuple[int, int]]], film: float, max_pairs: int
) -> UInt8[np.ndarray, "h w 3"]:
    """Draw some pairs, evenly chosen, of all folders."""
    count = min(max_pairs, len(pairs[0]))
    return consistency_sheet([
        [
            SheetPair(each.title, warped_pair(each.views[own[i][0]], each.views[own[i][1]], film), each.has_clear)
            for each, own in zip(compared, pairs, strict=True)
        ]
        for i in (k * len(pairs[0]) // count for k in range(count))
    ])  # fmt: skip


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
        values = {**_numbers(everywhere), "outside_film": _numbers(dry)}
        means.append({**about, "settings": each.settings, "pairs": len(own), **values})
        for row in own:
            values = {**_numbers(row.everywhere), "outside_film": _numbers(row.outside_film)}
            rows.append({**about, "of": row.of, "to": row.to, "matched_share": row.matched_share, **values})
    return {"film_share": film, "means": means, "rows": rows}


def _means(rows: Sequence[PairAgreement]) -> tuple[WarpAgreement | None, WarpAgreement | None]:
    everywhere = pool_errors(row.everywhere for row in rows)
    return everywhere, pool_errors(row.outside_film for row in rows if row.outside_film)


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
    titles = "view,neighbour,matched,before,after,ratio,per contrast,dry,dry before,dry after,dry ratio"
    table = table_of(titles + ",LPIPS before,after,ratio" * with_lpips, wraps=True)
    for each, rows in zip(compared, results, strict=True):
        table.add_section()
        table.add_row(bold(each.title))
        worst = sorted(rows, key=lambda row: -row.everywhere.after.rmse)[:_MAX_ROWS]
        for row in rows if len(rows) <= _MAX_ROWS else worst:
            cells = [row.of, row.to, f"{row.matched_share:.0%}"]
            table.add_row(*cells, *_cells(row.everywhere, row.outside_film, with_lpips))
        everywhere, dry = _means(rows)
        if everywhere is not None:
            mean = f"mean of {len(rows)} pairs" + (f", above the {_MAX_ROWS} worst" if len(rows) > _MAX_ROWS else "")
            table.add_row(bold(mean), "", "", *_cells(everywhere, dry, with_lpips))
    console.print(table)
    console.print(
        "Errors of the neighbor warped onto the view, in levels of 255; dry: share of the matched pixels that lies "
        "outside the water film, and the errors there."
    )


def _cells(everywhere: WarpAgreement, dry: WarpAgreement | None, with_lpips: bool) -> list[str]:
    cells = [*_error_cells(everywhere), _ratio(everywhere.contrast_ratio)]
    cells += ["", "", "", ""] if dry is None else [f"{dry.pixels / everywhere.pixels:.0%}", *_error_cells(dry)]
    if with_lpips:
        before = everywhere.before.lpips if everywhere.before is not None else None
        cells += ["" if value is None else f"{value:.3f}" for value in (before, everywhere.after.lpips)]
        cells.append(_ratio(everywhere.lpips_ratio))
    return cells


def _error_cells(agreement: WarpAgreement) -> list[str]:
    before = "" if agreement.before is None else f"{_LEVELS * agreement.before.rmse:.2f}"
    return [before, f"{_LEVELS * agreement.after.rmse:.2f}", _ratio(agreement.ratio)]


def _ratio(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}"


# HTML page

_CAPTION = (
    "Root mean square errors of a neighbor warped onto the view, in levels of 255. ratio: after over before; per "
    "contrast: each divided by its picture's contrast first; dry: outside the water film, which moves with the eye."
)

_PAGE_COLUMNS = (
    "before", "after", "ratio", "per contrast", "LPIPS before", "LPIPS after", "dry before", "dry after", "dry ratio"
)  # fmt: skip
_NUMBERS = ("rmse_before", "rmse_after", "ratio", "contrast_ratio", "lpips_before", "lpips_after")


def consistency_page(
    numbers: Mapping[str, Any], sheet: UInt8[np.ndarray, "h w 3"], settings: Mapping[str, object]
) -> RunReport:
    """Lay out the page; `numbers` are those of `--json`, `sheet` shows some pairs."""
    means, rows = numbers["means"], numbers["rows"]
    folders = tuple((_name(each), each["pairs"], *_page_cells(each)) for each in means)
    pairs = tuple((_name(row), row["of"], row["to"], row["matched_share"], *_page_cells(row)) for row in rows)
    made_by = {f"made by, {_name(each)}": str(each["settings"]) for each in means if each["settings"]}
    return RunReport(
        title="Agreement of neighboring views",
        settings={"film share": numbers["film_share"], **settings, **made_by, **provenance_lines(numbers)},
        headlines={f"error after, {_name(each)}": f"{_LEVELS * each['rmse_after']:.2f}" for each in means},
        figures=(ReportFigure("Pairs, warped", sheet, is_photograph=True),),
        tables=(
            ReportTable("Means", ("folder", "pairs", *_PAGE_COLUMNS), folders, caption=_CAPTION),
            ReportTable("Pairs", ("folder", "view", "neighbour", "matched", *_PAGE_COLUMNS), pairs, caption=_CAPTION),
        ),
    )


def _name(row: Mapping[str, Any]) -> str:
    return f"{row['folder']} ({row['method']})" if row["method"] else str(row["folder"])


def _page_cells(row: Mapping[str, Any]) -> list[float | None]:
    values = [(name, row.get(name)) for name in _NUMBERS]
    values += [(name, row["outside_film"].get(name)) for name in ("rmse_before", "rmse_after", "ratio")]
    return [_LEVELS * value if value is not None and name.startswith("rmse") else value for name, value in values]
