"""What `gsrain evaluate transfers` shows: a table on the screen, and a page of HTML."""

from collections.abc import Mapping

import msgspec

from gsrain_engine.evaluate.comparison.run import ComparisonResult
from gsrain_engine.evaluate.comparison.settings import ComparedMethod, Comparison
from gsrain_engine.evaluate.report.run_report import Figure, ReportTable, RunReport

from ...console import Console, Table, bold

_WITHOUT_CAMERAS = "Nobody knows where these pictures were taken: whether views agree with each other is not measured."


def transfers_page(result: ComparisonResult, told: Comparison, facts: Mapping[str, object]) -> RunReport:
    """Lay out the page of a comparison; `facts` come first among its settings."""
    rows, distance = result.rows, result.rows[0].distance
    caption = (
        f'{distance.metric} with the ends of its 95 % interval; "same" is what it would be of two sets so large of one '
        "distribution. Errors: neighbouring views warped onto each other, in levels of 255; dry: outside the water."
    )
    notes = [f"{row.name}: {warning}." for row in rows for warning in row.distance.warnings]
    if not result.has_cameras:
        notes.append(_WITHOUT_CAMERAS)
    notes += result.notes
    methods = {f"method {each.name}": _changed(each) for each in told.methods}
    about = {"extractor": distance.extractor, "resamples": told.resamples, "seed": told.seed}
    values = tuple(tuple(row.values.values()) for row in rows)
    return RunReport(
        title="Comparison of transfers",
        settings={**facts, **about, **methods},
        headlines={f"{distance.metric}, {row.name}": f"{row.distance.frechet:.4g}" for row in rows},
        figures=(Figure("Views by method", result.figure, ", ".join(result.shown), is_photograph=True),),
        tables=(ReportTable("Methods", tuple(rows[0].values), values, caption=caption),),
        notes=tuple(notes),
    )


def print_transfers(result: ComparisonResult, console: Console) -> None:
    """Print the table, what was not run again, and what is to be said about the distances."""
    distance = result.rows[0].distance
    kernel = f"{distance.kernel_metric} x1000"
    table = Table(
        "method",
        "N",
        distance.metric,
        "95 %",
        "same",
        kernel,
        "95 %",
        "error",
        "ratio",
        "per contrast",
        "dry",
        "s",
        box=None,
    )
    for row in result.rows:
        values = {name: _cell(value) for name, value in row.values.items()}
        frechet, kernel_value = (
            (bold(values[name]), f"{values[f'{name} low']} to {values[f'{name} high']}")
            for name in (distance.metric, kernel)
        )
        agreement = (values[name] for name in ("error after", "ratio", "per contrast", "dry ratio", "seconds"))
        table.add_row(row.name, values["N"], *frechet, values["same"], *kernel_value, *agreement)
    console.print(table)
    console.print(
        f"Compared with {distance.real_pictures} real pictures by {distance.extractor}. Error: neighbouring views, in "
        "levels of 255; ratio: to that before; dry: outside the water film.",
        soft_wrap=True,
        markup=False,
    )
    if not result.has_cameras:
        console.print(_WITHOUT_CAMERAS, soft_wrap=True)
    for note in result.notes:
        console.print(note, soft_wrap=True, markup=False)
    if result.kept:
        console.print(f"Not run again, for their pictures stand: {', '.join(result.kept)}.", soft_wrap=True)
    for row in result.rows:
        for warning in row.distance.warnings:
            console.print(f"{row.name}, {distance.metric}: {warning}.", soft_wrap=True, markup=False)


def _changed(method: ComparedMethod) -> str:
    """Say what differs from the method's usual settings."""
    values = msgspec.to_builtins(method, enc_hook=str)
    usual = {each.name: each.default for each in msgspec.structs.fields(method)}
    own = {key: value for key, value in values.items() if key not in ("name", "method") and value != usual[key]}
    return ", ".join([method.method, *(f"{key} {value}" for key, value in own.items())])


def _cell(value: str | float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
