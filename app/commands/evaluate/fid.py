"""`gsrain evaluate fid`: how far made pictures are from real ones as distributions, and how sure that is."""

import logging
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.evaluate.distribution.bootstrap import CONFIDENCE, Interval
from gsrain_engine.evaluate.distribution.comparison import DistributionDistance, compared, seen
from gsrain_engine.evaluate.distribution.extractor import Extractor, ExtractorChoice
from gsrain_engine.evaluate.distribution.extractors import EXTRACTORS, open_extractor
from gsrain_engine.evaluate.distribution.feature_cache import FeatureCache
from gsrain_engine.evaluate.report.report_file import write_report
from gsrain_engine.evaluate.report.run_report import ReportTable, RunReport

from ...console import Console, Table, bold, print
from ..arguments import AllowOutside, JsonFileOrScreen, let_names_lead_outside, words_go_to, write_numbers
from ..outputs import check_page
from ..progress import progress_bar
from .run_facts import run_facts, set_hash, told_facts, write_beside

_COLUMNS = 200
_LEAST_RESAMPLES, _MOST_RESAMPLES = 20, 10_000
_RESAMPLES, _MANY, _LEAST_DEFAULT = 200, 500, 40  # of many pictures each takes seconds, and the values vary less
_CAPTION = (
    "low and high: ends of the 95 % interval over pictures drawn again. same: what the distance would be of two sets "
    "so large of one distribution, for want of pictures alone."
)
_log = logging.getLogger(__name__)


def fid(
    real: Annotated[Path, Parameter(name="REAL", help="Folder of pictures, or a capture: what cameras saw.")],
    fake: Annotated[
        tuple[Path, ...],
        Parameter(name="FAKE", help="Folders of pictures, captures, or what gsrain transfer wrote; each by itself."),
    ],
    /,
    *,
    extractor: Annotated[
        str,
        Parameter(
            help=f"What looks at the pictures, several with commas: {', '.join(EXTRACTORS)}. Only the first is FID."
        ),
    ] = "inception",
    weights: Annotated[Path | None, Parameter(help="File of the extractor's weights; default: this machine's.")] = None,
    torchscript: Annotated[
        bool, Parameter(negative="", help="Let a TorchScript file of Inception run: it brings a program of its own.")
    ] = False,
    device: Annotated[Literal["cpu", "cuda"], Parameter(help="Where torch computes features.")] = "cpu",
    resamples: Annotated[
        int | None,
        Parameter(
            help="How often pictures are drawn again for the intervals. Default: 200, fewer of over 500 pictures."
        ),
    ] = None,
    seed: Annotated[int, Parameter(help="Same seed, same intervals.")] = 0,
    cache: Annotated[bool, Parameter(help="Keep features of pictures, and use kept ones.")] = True,
    report: Annotated[
        Path | None, Parameter(help="Also write a page of HTML, with the numbers as JSON beside it.")
    ] = None,
    allow_outside: AllowOutside = False,
    json: JsonFileOrScreen = None,
) -> None:
    """Compare sets of pictures as distributions: FID with KID beside it, both with intervals of 95 %.

    FID of few pictures is too high: "same" says what it would be if both sets came from one distribution. KID is
    not, and is 0 then. Other extractors give distances under names of their own: FD- and KD-.
    """
    let_names_lead_outside(allow_outside)
    names = [name.strip() for name in extractor.split(",")]
    _check(names, weights, resamples)
    check_page(report, json)
    kept = FeatureCache() if cache else None
    extractors = [
        _extractor(ExtractorChoice(name=name, weights=weights, device=device, allows_torchscript=torchscript))
        for name in names
    ]
    sets = [(folder, _opened(folder)) for folder in (real, *fake)]
    most = max(len(capture) for _, capture in sets)
    times = resamples or max(_RESAMPLES * _MANY // max(most, _MANY), _LEAST_DEFAULT)
    hashes: dict[str, str] = {}
    rows = [row for each in extractors for row in _rows(each, sets, kept, times, seed, hashes)]
    _print(rows, Console(file=words_go_to(json), width=_COLUMNS, highlight=False))
    settings = {"resamples": times, "seed": seed, "confidence": CONFIDENCE}
    facts = run_facts(hashes, ("torch", "onnxruntime"))
    numbers = {**settings, **facts, "rows": [_numbers(row) for row in rows]}
    write_numbers(json, numbers)
    if report is not None:
        write_report(report, _page(rows, {**settings, **told_facts(facts)}))
        beside = write_beside(report, json, numbers)
        print(f"wrote {report}" + (f", {beside}" if beside else ""), file=sys.stderr)


def _check(names: Sequence[str], weights: Path | None, resamples: int | None) -> None:
    for name in names:
        if name not in EXTRACTORS:
            raise ValueError(f"--extractor {name}: expected one of {', '.join(EXTRACTORS)}")
    if weights is not None and len(names) > 1:
        raise ValueError("--weights: belongs to one extractor, several are chosen")
    if resamples is not None and not _LEAST_RESAMPLES <= resamples <= _MOST_RESAMPLES:
        raise ValueError(f"--resamples {resamples}: must be within {_LEAST_RESAMPLES}..{_MOST_RESAMPLES}")


def _opened(folder: Path) -> Capture:
    capture = open_capture(folder)
    for problem in capture.problems if capture.has_poses else capture.problems[1:]:  # poses are of no use here
        _log.warning("%s: %s", folder, problem)
    return capture


def _extractor(choice: ExtractorChoice) -> Extractor:
    try:
        return open_extractor(choice)
    except ModuleNotFoundError as error:
        raise ValueError(f"--extractor {choice.name} needs {error.name}: pip install 'gsrain[evaluate]'") from None


def _rows(
    extractor: Extractor,
    sets: Sequence[tuple[Path, Capture]],
    cache: FeatureCache | None,
    resamples: int,
    seed: int,
    hashes: dict[str, str],
) -> list[DistributionDistance]:
    """Look at all sets and compare them with the first; hashes of their pixels come into `hashes`."""
    with progress_bar("Looking at pictures", sum(len(capture) for _, capture in sets)) as advance:
        looked = [seen(str(folder), capture, extractor, cache, advance) for folder, capture in sets]
    hashes |= {each.name: set_hash(each.hashes) for each in looked}
    with progress_bar("Resampling", 2 * resamples * (len(sets) - 1)) as advance:
        return [
            compared(extractor, looked[0], each, resamples=resamples, seed=seed, advance=advance) for each in looked[1:]
        ]


def _print(rows: Sequence[DistributionDistance], console: Console) -> None:
    table = Table(
        "set", "distance", "", "95 %", "same", "kernel distance", "x 1000", "95 %", "N real", "N", "extractor", box=None
    )
    for row in rows:
        table.add_row(
            _short(row.fake),
            row.metric,
            bold(f"{row.frechet:.4g}"),
            _range(row.frechet_interval),
            f"{row.same.mean:.4g} ({_range(row.same.interval)})",
            row.kernel_metric,
            bold(f"{1000 * row.kernel:.4g}"),
            _range(Interval(1000 * row.kernel_interval.low, 1000 * row.kernel_interval.high)),
            str(row.real_pictures),
            str(row.fake_pictures),
            row.extractor,
        )
    console.print(table)
    console.print(
        f'Compared with {rows[0].real}. "same": what the distance would be of two sets so large of one distribution.'
    )
    for row in rows:
        for warning in row.warnings:
            console.print(f"{_short(row.fake)}, {row.metric}: {warning}.", soft_wrap=True, markup=False)


def _short(folder: str) -> str:
    """Return the end of a path, which tells sets apart in a table."""
    return str(Path(*Path(folder).parts[-2:]))


def _range(interval: Interval) -> str:
    return f"{interval.low:.4g} to {interval.high:.4g}"


def _numbers(row: DistributionDistance) -> dict[str, Any]:
    return {
        **asdict(row),
        "frechet_interval": list(row.frechet_interval),
        "kernel_interval": list(row.kernel_interval),
        "same": {"mean": row.same.mean, "interval": list(row.same.interval)},
    }


def _page(rows: Sequence[DistributionDistance], settings: dict[str, Any]) -> RunReport:
    notes = tuple(f"{_short(row.fake)}, {row.metric}: {warning}." for row in rows for warning in row.warnings)
    sets = {f"set {_short(row.fake)}": row.fake for row in rows}
    return RunReport(
        title="Distances of distributions",
        settings={"real pictures": rows[0].real, **sets, **settings},
        headlines={f"{row.metric} of {_short(row.fake)}": f"{row.frechet:.4g}" for row in rows},
        tables=(_frechet_table(rows), _kernel_table(rows)),
        notes=notes,
    )


def _frechet_table(rows: Sequence[DistributionDistance]) -> ReportTable:
    columns = ("set", "distance", "value", "low", "high", "same", "N real", "N", "extractor")
    values = tuple(
        (
            _short(row.fake),
            row.metric,
            row.frechet,
            *row.frechet_interval,
            row.same.mean,
            row.real_pictures,
            row.fake_pictures,
            row.extractor,
        )
        for row in rows
    )
    return ReportTable("Frechet distances", columns, values, caption=_CAPTION)


def _kernel_table(rows: Sequence[DistributionDistance]) -> ReportTable:
    columns = ("set", "distance", "x 1000", "low", "high", "N real", "N", "extractor")
    values = tuple(
        (
            _short(row.fake),
            row.kernel_metric,
            *(1000 * each for each in (row.kernel, *row.kernel_interval)),
            row.real_pictures,
            row.fake_pictures,
            row.extractor,
        )
        for row in rows
    )
    return ReportTable("Kernel distances", columns, values, caption="Expected to be 0 for sets of one distribution.")
