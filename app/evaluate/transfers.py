"""`gsrain evaluate transfers COMPARISON.yaml -o DIR`: comparison of transfers as in the paper."""

import json as json_text
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from cyclopts import Parameter
from PIL import Image

from gsrain_engine.appearance.registry import find_method
from gsrain_engine.datasets.capture import Capture
from gsrain_engine.editor.jobs.training import HOW_TO_GET_DIFFUSION, require_torch
from gsrain_engine.evaluation.compare_results import (
    CLEAR,
    SHIPPED,
    ComparedMethod,
    TransferComparison,
    comparison_csv,
    load_comparison,
    markdown_table,
    plain_row,
)
from gsrain_engine.evaluation.compare_translators import (
    ComparedSource,
    ComparisonResult,
    capture_source,
    check_methods,
    held_out_images,
    real_images,
    run_comparison,
)
from gsrain_engine.evaluation.fid import FeatureCache
from gsrain_engine.evaluation.fid_features import Extractor, ExtractorChoice
from gsrain_engine.evaluation.fid_registry import open_extractor
from gsrain_engine.evaluation.input_fingerprint import input_fingerprint
from gsrain_engine.evaluation.report import ReportFigure, ReportTable, RunReport, write_report
from gsrain_engine.presets import shipped_config_names
from gsrain_engine.scene.files import whole_file
from gsrain_engine.scene.open import scene_hash

from ..console import Console, Table, bold, print
from ..options import (
    AllowOutside,
    JsonFileOrScreen,
    Trust,
    check_writable,
    let_names_lead_outside,
    lock_outputs,
    table_stream,
    with_trust,
    write_numbers,
)
from ..progress import followed
from ..scene_options import names_scene
from .run_facts import provenance_lines, run_provenance

_COLUMNS = 160


def transfers(
    comparison: Annotated[
        str, Parameter(help=f"YAML file, or a shipped comparison: {', '.join(shipped_config_names(SHIPPED))}.")
    ],
    /,
    *,
    output: Annotated[
        Path, Parameter(name=["--output", "-o"], help="Folder for pictures, table, figure; run again, it goes on.")
    ],
    only: Annotated[str, Parameter(help="Only these of its methods, by name, commas between.")] = "",
    device: Annotated[Literal["cpu", "cuda"], Parameter(help="Where torch computes features.")] = "cpu",
    trust: Trust = False,
    allow_outside: AllowOutside = False,
    json: JsonFileOrScreen = None,
) -> None:
    """Make the same views rainy by several methods, and compare each with real rainy images.

    FID (or the like) and KID with intervals of 95 %, agreement of neighboring views, seconds, and a figure. Methods
    whose images are in DIR, made with the same settings, are not run again.
    """
    let_names_lead_outside(allow_outside)
    told = with_trust(lambda: load_comparison(comparison), trust)
    names = tuple(name.strip() for name in only.split(",") if name.strip())
    told = told.only(names) if names else told
    check_writable(output / "table.md", json, folders=[output, *(output / each.name for each in told.methods)])
    lock_outputs(output)
    for each in told.methods:
        if each.method != CLEAR and find_method(each.method).needs_torch:
            require_torch(f"method {each.name!r}", HOW_TO_GET_DIFFUSION)
    check_methods(told, output)
    extractor = _extractor(ExtractorChoice(name=told.extractor, weights=told.extractor_weights, device=device))
    source, real = _opened(told)
    result = followed(run_comparison(told, source, real, extractor, FeatureCache(), output))
    numbers = _numbers(comparison, told, source, real, result)
    _write(output, numbers, result, told, source, real)
    print_transfers(result, Console(file=table_stream(json), width=_COLUMNS, highlight=False))
    print(f"wrote {output}: table.md, table.csv, table.json, figure.png, report.html", file=sys.stderr)
    write_numbers(json, numbers)


def _extractor(choice: ExtractorChoice) -> Extractor:
    try:
        return open_extractor(choice)
    except ModuleNotFoundError as error:
        raise ValueError(f"extractor {choice.name} needs {error.name}: pip install 'gsrain[evaluate]'") from None


def _opened(told: TransferComparison) -> tuple[ComparedSource, Capture]:
    if told.pictures is not None:
        return held_out_images(told.pictures, told.width_px)
    assert told.source is not None
    real = real_images(told.real, told.width_px)
    choice = msgspec.structs.replace(told.views, width_px=told.width_px)
    if names_scene(told.source):
        from ..translate import source_views  # kernels take a second to load

        opened = source_views(told.source, choice, told.capture)
        stamps = "-".join(input_fingerprint(Path(each)) for each in (told.source, told.capture) if each is not None)
        return ComparedSource(
            opened.name, opened.views, opened.surroundings, opened.to_world, opened.mask, True, stamps
        ), real
    from gsrain_engine.appearance.scene_views import chosen_views
    from gsrain_engine.datasets.open_capture import open_capture

    capture = chosen_views(open_capture(told.source), choice)
    return capture_source(capture, told.width_px, input_fingerprint(Path(told.source))), real


def _inputs(told: TransferComparison, source: ComparedSource) -> dict[str, str]:
    """Return hashes of the inputs: of a scene's bytes, and of names, sizes and times of all other files."""
    is_scene = told.source is not None and names_scene(told.source)
    found = {"clear views": scene_hash(told.source) if is_scene else source.stamp}
    rainy = told.real if told.pictures is None else [Path(each.path) for each in told.pictures.rainy]
    files: dict[str, Path | None] = {f"real pictures {path}": Path(path) for path in rainy}
    files |= {"capture": told.capture, "weights of the extractor": told.extractor_weights}
    for each in told.methods:
        files |= {f"{name} of {each.name}": getattr(each, name) for name in ("weights", "images", "base")}
    return found | {name: input_fingerprint(path) for name, path in files.items() if path is not None}


def _numbers(
    name: str, told: TransferComparison, source: ComparedSource, real: Capture, result: ComparisonResult
) -> dict[str, Any]:
    return {
        "gsrain": version("gsrain"),
        **run_provenance(_inputs(told, source), ("torch", "diffusers", "onnxruntime")),
        "comparison": name,
        "source": source.name,
        "views": len(source.views),
        "real_pictures": len(real),
        "resamples": told.resamples,
        "seed": told.seed,
        "shown": list(result.shown),
        "kept": list(result.kept),
        "notes": list(result.notes),
        "rows": [plain_row(row) for row in result.rows],
        "settings": msgspec.to_builtins(told, enc_hook=str),
    }


def _write(
    output: Path,
    numbers: dict[str, Any],
    result: ComparisonResult,
    told: TransferComparison,
    source: ComparedSource,
    real: Capture,
) -> None:
    texts = {
        "table.md": markdown_table(result.rows),
        "table.csv": comparison_csv(result.rows),
        "table.json": json_text.dumps(numbers, indent=1) + "\n",
    }
    for name, text in texts.items():
        with whole_file(output / name) as beside:
            beside.write_text(text, encoding="utf-8")
    with whole_file(output / "figure.png") as beside:
        Image.fromarray(result.figure).save(beside, "png")
    facts = {"views": f"{len(source.views)} of {source.name}", "real pictures": len(real), **provenance_lines(numbers)}
    write_report(output / "report.html", transfers_page(result, told, facts))


# Table and HTML page

_WITHOUT_CAMERAS = "Nobody knows where these pictures were taken: whether views agree with each other is not measured."


def transfers_page(result: ComparisonResult, told: TransferComparison, facts: Mapping[str, object]) -> RunReport:
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
        figures=(ReportFigure("Views by method", result.figure, ", ".join(result.shown), is_photograph=True),),
        tables=(ReportTable("Methods", tuple(rows[0].values), values, caption=caption),),
        notes=tuple(notes),
    )


def print_transfers(result: ComparisonResult, console: Console) -> None:
    """Print the table, the reused methods, and warnings about the distances."""
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
    values = msgspec.to_builtins(method, enc_hook=str)
    usual = {each.name: each.default for each in msgspec.structs.fields(method)}
    own = {key: value for key, value in values.items() if key not in ("name", "method") and value != usual[key]}
    return ", ".join([method.method, *(f"{key} {value}" for key, value in own.items())])


def _cell(value: str | float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
