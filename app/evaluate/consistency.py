"""`gsrain evaluate consistency`: agreement of neighboring views before and after a transfer."""

import math
import sys
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

from gsrain_engine.choices import FILM_SHARE
from gsrain_engine.report.numbers import finite_numbers, provenance_lines, run_provenance
from gsrain_engine.safe_io.errors import MissingInputsError
from gsrain_engine.safe_io.fingerprints import input_fingerprint

from ..console import print, print_lines, progress_bar
from ..options import AllowOutside, JsonFileOrScreen, check_within, let_names_lead_outside, option
from ..outputs import check_image, check_page, table_stream, write_numbers, write_page
from .images import LpipsChoice, Report, open_lpips

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import UInt8

    from gsrain_engine.evaluation.consistency import PairAgreement, ViewFolder, WarpAgreement
    from gsrain_engine.report.page import RunReport
    from gsrain_engine.report.table import Cell, Table

    _Row = tuple[tuple[Cell, ...], Mapping[str, Any]]
    """First cells of a row, and its numbers as in `report_of`."""


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
    from PIL import Image

    from gsrain_engine.datasets.open_source import missing_source
    from gsrain_engine.evaluation.consistency import agreements, open_view_folder
    from gsrain_engine.render.images import write_image
    from gsrain_engine.scene.open import file_hash

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
    print_agreements(numbers, [each.title for each in compared], table_stream(json))
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
    compared: "Sequence[ViewFolder]", pairs: Sequence[list[tuple[int, int]]], film: float, max_pairs: int
) -> "UInt8[np.ndarray, 'h w 3']":
    """Draw some pairs, evenly chosen, of all folders."""
    from gsrain_engine.evaluation.consistency import warped_pair
    from gsrain_engine.evaluation.consistency_sheet import SheetPair, consistency_sheet

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
    compared: "Sequence[ViewFolder]", results: "Sequence[Sequence[PairAgreement]]", film: float
) -> dict[str, Any]:
    """Return the plain values of `--json`: means of each folder and rows of each pair."""
    from gsrain_engine.evaluation.consistency import pool_errors

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


def _both(everywhere: "WarpAgreement | None", dry: "WarpAgreement | None") -> dict[str, Any]:
    return {**_numbers(everywhere), "outside_film": _numbers(dry)}


def _numbers(agreement: "WarpAgreement | None") -> dict[str, Any]:
    """Return plain numbers of an agreement, errors in display values of 0..1; null if unknown."""
    from gsrain_engine.evaluation.consistency import WarpError

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


def print_agreements(numbers: Mapping[str, Any], titles: Sequence[str], file: TextIO) -> None:
    """Print the numbers of `report_of`: for each folder the worst pairs, and the means of all."""
    rows = iter(numbers["rows"])
    for title, mean in zip(titles, numbers["means"], strict=True):
        own = list(islice(rows, mean["pairs"]))
        shown = sorted(own, key=lambda row: -row["rmse_after"])[:_MAX_ROWS] if len(own) > _MAX_ROWS else own
        words = f"mean of {len(own)} pairs" + (f", above the {_MAX_ROWS} worst" if len(own) > _MAX_ROWS else "")
        table = agreement_table(
            title, ("view", "neighbour"), [((row["of"], row["to"]), row) for row in shown], [((words, ""), mean)]
        )
        print(f"{title}:", file=file)
        print_lines(f"{table.text}\n", file=file)
    if note := _without_film(numbers, titles):
        print(note, file=file)


def agreement_table(title: str, named: Sequence[str], rows: "Sequence[_Row]", foot: "Sequence[_Row]" = ()) -> "Table":
    """Return a table of agreements, with LPIPS if any row has it."""
    from gsrain_engine.report.table import Table, columns

    measured = {"matched": ".0%", "before": ".2f", "after": ".2f", "ratio": ".2f", "per contrast": ".2f", "dry": ".0%",
                "dry before": ".2f", "dry after": ".2f", "dry ratio": ".2f"}  # fmt: skip
    if any(row.get("lpips_after") is not None for _, row in rows):
        measured |= {"LPIPS before": ".3f", "LPIPS after": ".3f", "LPIPS ratio": ".2f"}
    cells = [[*first, *_cells(row)[: len(measured)]] for first, row in (*rows, *foot)]
    titled = *columns(named), *columns(measured)
    return Table(title, titled, cells[: len(rows)], _CAPTION, foot=cells[len(rows) :])


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


def _cells(row: Mapping[str, Any]) -> "list[Cell]":
    dry = row["outside_film"]
    levels = [_scaled(each.get(name), _LEVELS) for each in (row, dry) for name in ("rmse_before", "rmse_after")]
    share = dry["pixels"] / row["pixels"] if dry["pixels"] else None
    return [
        row.get("matched_share"), *levels[:2], row.get("ratio"), row.get("contrast_ratio"), share, *levels[2:],
        dry.get("ratio"), row.get("lpips_before"), row.get("lpips_after"), row.get("lpips_ratio"),
    ]  # fmt: skip


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value


# HTML page

_CAPTION = (
    "Root mean square errors of a neighbor warped onto the view, in levels of 255. ratio: after over before; per "
    "contrast: each divided by its picture's contrast first; dry: share of the matched pixels outside the water film, "
    "which moves with the eye, and the errors there."
)


def consistency_page(
    numbers: Mapping[str, Any], sheet: "UInt8[np.ndarray, 'h w 3']", settings: Mapping[str, object]
) -> "RunReport":
    """Lay out the page; `numbers` are those of `--json`, `sheet` shows some pairs."""
    from gsrain_engine.report.page import ReportFigure, RunReport

    means, rows = numbers["means"], numbers["rows"]
    folders = [((_name(each), each["pairs"]), each) for each in means]
    pairs = [((_name(row), row["of"], row["to"]), row) for row in rows]
    made_by = {f"made by, {_name(each)}": str(each["settings"]) for each in means if each["settings"]}
    return RunReport(
        title="Agreement of neighboring views",
        settings={"film share": numbers["film_share"], **settings, **made_by, **provenance_lines(numbers)},
        headlines={f"error after, {_name(each)}": f"{_LEVELS * each['rmse_after']:.2f}" for each in means},
        figures=(ReportFigure("Pairs, warped", sheet, is_photograph=True),),
        notes=tuple(filter(None, [_without_film(numbers, [_name(each) for each in means])])),
        tables=(
            agreement_table("Means", ("folder", "pairs"), folders),
            agreement_table("Pairs", ("folder", "view", "neighbour"), pairs),
        ),
    )


def _name(row: Mapping[str, Any]) -> str:
    return f"{row['folder']} ({row['method']})" if row["method"] else str(row["folder"])
