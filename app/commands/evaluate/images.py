"""`gsrain evaluate images`: PSNR, SSIM and LPIPS of pictures and those of the same names that they should be."""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from jaxtyping import Bool, UInt8

from gsrain_engine.datasets.capture import View
from gsrain_engine.datasets.files.picture_file import is_picture, read_labels
from gsrain_engine.datasets.image_folder import capture_without_poses
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.other_pictures import pictures_below
from gsrain_engine.evaluate.comparison.stamp import stamp
from gsrain_engine.evaluate.distribution.feature_cache import picture_hash
from gsrain_engine.evaluate.image_metrics import check_pair
from gsrain_engine.evaluate.mean_interval import MeanInterval, mean_interval
from gsrain_engine.evaluate.report.comparison import Comparison, Distance
from gsrain_engine.evaluate.report.report_file import write_report
from gsrain_engine.evaluate.report.run_report import RunReport

from ...console import Console, Table, bold, print
from ..arguments import AllowOutside, JsonFileOrScreen, let_names_lead_outside, words_go_to, write_numbers
from ..outputs import check_page
from ..progress import progress_bar
from .perceived import perceived_distance
from .run_facts import run_facts, set_hash, told_facts, write_beside

_COLUMNS = 120
_MOST_ROWS = 40

Mask = Bool[np.ndarray, "h w"]
Picture = UInt8[np.ndarray, "h w 3"]


def images(
    shown: Annotated[Path, Parameter(name="A", help="A picture, a folder of pictures, or a capture.")],
    truth: Annotated[
        Path,
        Parameter(name="B", help="What they should be: pictures of the same names and sizes; of a picture any other."),
    ],
    /,
    *,
    masks: Annotated[
        Path | None,
        Parameter(
            help="Mask, or folder of masks NAME.png: what is not black is compared. Default: those of B, if it has any."
        ),
    ] = None,
    lpips: Annotated[
        str | None, Parameter(help="LPIPS too: alex or vgg of this machine's weights, or a file of weights.")
    ] = None,
    seed: Annotated[int, Parameter(help="Same seed, same intervals.")] = 0,
    report: Annotated[
        Path | None, Parameter(help="Also write a page of HTML with the pictures, and the numbers as JSON beside it.")
    ] = None,
    allow_outside: AllowOutside = False,
    json: JsonFileOrScreen = None,
) -> None:
    """Measure how close pictures are to those of the same names: PSNR, SSIM and LPIPS, each with its mean and interval.

    PSNR in dB and SSIM (at most 1) are higher for closer pictures, LPIPS (0 for equal ones) is lower.
    """
    let_names_lead_outside(allow_outside)
    check_page(report, json)
    pairs, left_out = _pairs(shown, truth)
    distance = None if lpips is None else perceived_distance(lpips)
    rows: list[Comparison] = []
    shares: list[float] = []
    hashes: list[tuple[str, str]] = []
    with progress_bar("Comparing", len(pairs)) as advance:
        for a, b in pairs:
            mask = b.mask if masks is None else _mask(masks, b)
            pictures = a.image, b.image  # each is read anew
            rows.append(_compared(b.name, *pictures, mask, distance))
            hashes.append((picture_hash(pictures[0]), picture_hash(pictures[1])))
            shares.append(1.0 if mask is None else float(mask.mean()))
            advance()
    means = {name: mean_interval(values, seed) for name, values in _columns(rows).items()}
    _print(rows, means, Console(file=words_go_to(json), width=_COLUMNS, highlight=False))
    if left_out:
        print(f"{left_out} pictures have no other of their name, and are left out", file=sys.stderr)
    settings = {"pictures": str(shown), "truth": str(truth), "lpips": lpips, "seed": seed, "left_out": left_out}
    facts = run_facts(_inputs(hashes, shown, truth, masks), ("scikit-image", "torch"))
    numbers = {**settings, **facts, "means": _means(means), "rows": _numbers(rows, shares)}
    write_numbers(json, numbers)
    if report is not None:
        told = {**settings, **told_facts(facts)}
        write_report(
            report, RunReport(title="Pictures compared", settings=told, comparisons=tuple(rows), held_out=False)
        )
        beside = write_beside(report, json, numbers)
        print(f"wrote {report}" + (f", {beside}" if beside else ""), file=sys.stderr)


def _inputs(hashes: Sequence[tuple[str, str]], shown: Path, truth: Path, masks: Path | None) -> dict[str, str]:
    """Hashes of the pictures that were compared, and of the masks' names, sizes and times."""
    first, second = (set_hash(each) for each in zip(*hashes, strict=True))
    found = {f"pictures {shown}": first, f"truth {truth}": second}
    return found if masks is None else found | {f"masks {masks}": stamp(masks)}


def _pairs(shown: Path, truth: Path) -> tuple[list[tuple[View, View]], int]:
    """Return views to compare, and how many pictures have no other; two files are a pair whatever they are called."""
    first, second = _views(shown), _views(truth)
    if _is_one(shown) and _is_one(truth):
        return [(first[0], second[0])], 0
    others = {view.name: view for view in second}
    pairs = [(view, others[view.name]) for view in first if view.name in others]
    if not pairs:
        raise ValueError(f"{shown} and {truth}: no picture of the one has the name of one of the other")
    if _is_one(shown) or _is_one(truth):
        return pairs, 0  # one of many is asked for
    return pairs, len(first) + len(second) - 2 * len(pairs)


def _views(path: Path) -> list[View]:
    return list(capture_without_poses(path, [path]) if _is_one(path) else open_capture(path))


def _is_one(path: Path) -> bool:
    return is_picture(path) and path.is_file()


def _mask(folder: Path, view: View) -> Mask:
    if folder.is_file():
        return read_labels(folder) > 0
    file = pictures_below(folder).file_of(view.name, view.sensor)
    if file is None:
        raise ValueError(f"--masks {folder}: has no mask of {view.name}; expected {view.name}.png")
    return read_labels(file) > 0


def _compared(name: str, shown: Picture, truth: Picture, mask: Mask | None, distance: Distance | None) -> Comparison:
    a, b = (picture.astype(np.float32) / np.float32(255) for picture in (shown, truth))
    try:
        check_pair(a.shape, b.shape, None if mask is None else mask.shape)
        return Comparison.measured(name, a, b, mask, distance)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def _columns(rows: Sequence[Comparison]) -> dict[str, list[float]]:
    columns = {"psnr_db": [row.psnr_db for row in rows], "ssim": [row.ssim for row in rows]}
    lpips = [row.lpips for row in rows if row.lpips is not None]
    return {**columns, "lpips": lpips} if lpips else columns


def _print(rows: Sequence[Comparison], means: dict[str, MeanInterval], console: Console) -> None:
    titles = {"psnr_db": "PSNR dB", "ssim": "SSIM", "lpips": "LPIPS"}
    table = Table("picture", *(titles[name] for name in means), box=None)
    for row in rows if len(rows) <= _MOST_ROWS else sorted(rows, key=lambda row: row.psnr_db)[:_MOST_ROWS]:
        cells = [f"{row.psnr_db:.2f}", f"{row.ssim:.4f}", *([] if row.lpips is None else [f"{row.lpips:.4f}"])]
        table.add_row(row.name, *cells)
    told = f"mean of {len(rows)}" + (f", above the {_MOST_ROWS} worst" if len(rows) > _MOST_ROWS else "")
    table.add_row(bold(told), *(bold(f"{each.mean:.4g}") for each in means.values()))
    table.add_row("95 % of such means", *(f"{each.low:.4g} to {each.high:.4g}" for each in means.values()))
    console.print(table)


def _means(means: dict[str, MeanInterval]) -> dict[str, Any]:
    return {name: {part: _finite(value) for part, value in each._asdict().items()} for name, each in means.items()}


def _numbers(rows: Sequence[Comparison], shares: Sequence[float]) -> list[dict[str, Any]]:
    return [
        {
            "name": row.name,
            "psnr_db": _finite(row.psnr_db),
            "ssim": row.ssim,
            "lpips": row.lpips,
            "compared_share": share,
        }
        for row, share in zip(rows, shares, strict=True)
    ]


def _finite(value: float) -> float | None:
    """Replace infinity, the PSNR of equal pictures, which JSON lacks."""
    return value if math.isfinite(value) else None
