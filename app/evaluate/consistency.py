"""`gsrain evaluate consistency`: agreement of neighboring views before and after a transfer."""

import math
import sys
from collections.abc import Mapping, Sequence
from itertools import islice
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
from gsrain_engine.safe_io.errors import MissingInputsError
from gsrain_engine.scene.open import file_hash

from ..console import Console, bold, print, progress_bar, table_of
from ..options import AllowOutside, JsonFileOrScreen, check_within, let_names_lead_outside, option
from ..outputs import (
    check_image,
    check_page,
    finite_numbers,
    provenance_lines,
    run_provenance,
    table_stream,
    write_numbers,
    write_page,
)
from ..scene import missing_source
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
    if missing := [line for folder in folders for line in missing_source(folder)]:
        raise MissingInputsError(missing)
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
    numbers = report_of(compared, results, water_film)
    print_agreements(numbers, [each.title for each in compared], Console(file=table_stream(json), width=_COLUMNS))
    inputs = {str(folder): input_fingerprint(folder) for folder in folders}
    if lpips and Path(lpips).is_file():
        inputs[f"LPIPS {lpips}"] = file_hash(Path(lpips))
    numbers |= run_provenance(inputs, ("torch",))
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
        pooled = pool_errors(row.everywhere for row in own)
        dry = pool_errors(row.outside_film for row in own if row.outside_film)
        means.append({**about, "settings": each.settings, "pairs": len(own), **_both(pooled, dry)})
        for row in own:
            pair = {"of": row.of, "to": row.to, "matched_share": row.matched_share}
            rows.append({**about, **pair, **_both(row.everywhere, row.outside_film)})
    return {"film_share": film, "means": means, "rows": rows}


def _both(everywhere: WarpAgreement | None, dry: WarpAgreement | None) -> dict[str, Any]:
    return {**_numbers(everywhere), "outside_film": _numbers(dry)}


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
    return finite_numbers(numbers)


def print_agreements(numbers: Mapping[str, Any], titles: Sequence[str], console: Console) -> None:
    """Print the numbers of `report_of`: the pairs of each folder, below its title, and their means."""
    with_lpips = any(row["lpips_after"] is not None for row in numbers["rows"])
    columns = "view,neighbour,matched,before,after,ratio,per contrast,dry,dry before,dry after,dry ratio"
    table = table_of(columns + ",LPIPS before,after,ratio" * with_lpips, wraps=True)
    rows = iter(numbers["rows"])
    for title, mean in zip(titles, numbers["means"], strict=True):
        table.add_section()
        table.add_row(bold(title))
        own = list(islice(rows, mean["pairs"]))
        is_long = len(own) > _MAX_ROWS
        for row in sorted(own, key=lambda row: -row["rmse_after"])[:_MAX_ROWS] if is_long else own:
            table.add_row(row["of"], row["to"], f"{row['matched_share']:.0%}", *_cells(row, with_lpips))
        words = f"mean of {len(own)} pairs" + (f", above the {_MAX_ROWS} worst" if is_long else "")
        table.add_row(bold(words), "", "", *_cells(mean, with_lpips))
    console.print(table)
    console.print(
        "Errors of the neighbor warped onto the view, in levels of 255; dry: share of the matched pixels that lies "
        "outside the water film, and the errors there."
    )
    if note := _without_film(numbers, titles):
        console.print(note, soft_wrap=True)


def _without_film(numbers: Mapping[str, Any], titles: Sequence[str]) -> str:
    means = zip(titles, numbers["means"], strict=True)
    names = [title for title, mean in means if not mean["outside_film"]["pixels"]]
    return film_note(names) if names else ""


def film_note(names: Sequence[str]) -> str:
    """Return a sentence that explains the empty numbers of these folders or methods outside the water film."""
    return (
        f"Empty under dry, since their water film is unknown: {', '.join(names)}; of the built-in methods, only wet "
        "writes a mask of the film."
    )


def _cells(row: Mapping[str, Any], with_lpips: bool) -> list[str]:
    before, after, ratio, per_contrast, lpips_before, lpips_after, *dry = _page_cells(row)
    dry_pixels = row["outside_film"]["pixels"]
    share = f"{dry_pixels / row['pixels']:.0%}" if dry_pixels else ""
    cells = [*map(_text, (before, after, ratio, per_contrast)), share, *map(_text, dry)]
    if with_lpips:
        cells += [_text(lpips_before, 3), _text(lpips_after, 3), _text(row["lpips_ratio"])]
    return cells


def _text(value: float | None, digits: int = 2) -> str:
    return "" if value is None else f"{value:.{digits}f}"


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
        notes=tuple(filter(None, [_without_film(numbers, [_name(each) for each in means])])),
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
