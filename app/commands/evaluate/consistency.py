"""`gsrain evaluate consistency`: whether neighbouring views still agree after a transfer."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from jaxtyping import UInt8
from PIL import Image

from gsrain_engine.evaluate.comparison.stamp import stamp
from gsrain_engine.evaluate.consistency.folders import ComparedViews, open_compared
from gsrain_engine.evaluate.consistency.pairs import FILM_SHARE, PairAgreement, agreements, warped_pair
from gsrain_engine.evaluate.consistency.sheet import ShownPair, consistency_sheet
from gsrain_engine.evaluate.report.report_file import write_report
from gsrain_engine.render.pictures import write_sheet
from gsrain_engine.scene.content_hash import file_hash

from ...console import Console, print
from ..arguments import AllowOutside, JsonFileOrScreen, let_names_lead_outside, words_go_to, write_numbers
from ..outputs import check_page, check_picture
from ..progress import progress_bar
from .consistency_numbers import print_agreements, report_of
from .consistency_page import consistency_page
from .perceived import perceived_distance
from .run_facts import run_facts, write_beside

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
    """Warp neighbouring views onto each other by their depth, and compare: before a transfer, and after it.

    The error after should be that before: what a transfer adds differently in each view makes it grow. Reflections in
    water move with the eye, so that errors outside the water film are told as well. Errors are the root of the mean
    square over matched pixels, in levels of 255; "per contrast" divides each by its picture's contrast.
    """
    let_names_lead_outside(allow_outside)
    _check(folders, neighbours, film, sheet_pairs)
    check_picture("--sheet", sheet)
    check_page(report, json, sheet)
    compared = [open_compared(folder, width) for folder in folders]
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
    print_agreements(compared, results, Console(file=words_go_to(json), width=_COLUMNS))
    numbers = report_of(compared, results, film) | run_facts(_inputs(folders, lpips), ("torch",))
    if sheet is not None or report is not None:
        drawn = _drawn(compared, own_pairs, film, sheet_pairs)
        if sheet is not None:
            write_sheet(sheet, Image.fromarray(drawn))
            print(f"wrote {sheet}", file=sys.stderr)
        if report is not None:
            write_report(report, consistency_page(numbers, drawn, {"neighbours": neighbours, "LPIPS": lpips or "-"}))
            beside = write_beside(report, json, numbers)
            print(f"wrote {report}" + (f", {beside}" if beside else ""), file=sys.stderr)
    write_numbers(json, numbers)


def _inputs(folders: Sequence[Path], lpips: str | None) -> dict[str, str]:
    """Hashes over names, sizes and times of what is compared, and of the bytes of a file of weights."""
    found = {str(folder): stamp(folder) for folder in folders}
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
    compared: Sequence[ComparedViews], pairs: Sequence[_Pairs], film: float, most: int
) -> UInt8[np.ndarray, "h w 3"]:
    """Some pairs of each folder, warped, with their errors."""
    count = min(most, len(pairs[0]))
    chosen = [i * len(pairs[0]) // count for i in range(count)]
    shown = [
        [
            ShownPair(each.title, warped_pair(each.views[own[i][0]], each.views[own[i][1]], film), each.has_clear)
            for each, own in zip(compared, pairs, strict=True)
        ]
        for i in chosen
    ]
    return consistency_sheet(shown)
