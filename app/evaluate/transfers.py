"""`gsrain evaluate transfers COMPARISON.yaml -o DIR`: comparison of transfers as in the paper."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import msgspec

from gsrain_engine.optional_packages import require_package
from gsrain_engine.presets import shipped_config_names
from gsrain_engine.report.numbers import provenance_lines, run_provenance, version_of, write_text
from gsrain_engine.safe_io.errors import MissingInputsError
from gsrain_engine.safe_io.fingerprints import input_fingerprint

from .. import outputs
from ..console import print, print_lines, run_with_progress
from ..options import AllowOutside, JsonFileOrScreen, Trust, let_names_lead_outside, option, split_words, with_trust
from .consistency import film_note
from .images import FeatureDevice, extractor_of

if TYPE_CHECKING:
    from gsrain_engine.datasets.capture import Capture
    from gsrain_engine.evaluation import compare_results as results
    from gsrain_engine.evaluation import compare_translators as translators
    from gsrain_engine.report.page import RunReport


def transfers(
    comparison: Annotated[
        str, option(f"YAML file, or shipped comparison: {', '.join(shipped_config_names('comparisons'))}.")
    ],
    /,
    *,
    output: Annotated[Path, option("Folder for images, table, figure; a second run resumes.", "--output", "-o")],
    only: Annotated[
        str, option("Run only these methods, by name, with commas; table and figure have this order.")
    ] = "",
    device: FeatureDevice = "cpu",
    trust: Trust = False,
    allow_outside: AllowOutside = False,
    json: JsonFileOrScreen = None,
) -> None:
    """Make the same views rainy by several methods, and compare each with real rainy images.

    FID (or the like) and KID with intervals of 95 %, agreement of neighboring views, seconds, and a figure. Methods
    whose images are in DIR, made with the same settings, are not run again. All missing inputs are named before any
    work.
    """
    from PIL import Image

    from gsrain_engine.appearance import output_folder
    from gsrain_engine.evaluation import compare_results as results
    from gsrain_engine.evaluation import compare_translators as translators
    from gsrain_engine.evaluation.fid import FeatureCache
    from gsrain_engine.evaluation.fid_features import ExtractorChoice
    from gsrain_engine.render.images import write_image
    from gsrain_engine.report.page import write_report

    let_names_lead_outside(allow_outside)
    settings = with_trust(lambda: results.load_comparison(comparison), trust)
    names = tuple(split_words(only))
    settings = settings.only(names) if names else settings
    folders = [output, *(output / each.name for each in settings.methods)]
    outputs.claim_outputs(output / "table.md", json, folders=folders)
    for each in settings.methods:
        output_folder.check_transferred_folder(output / each.name)
    _check_inputs(settings)
    choice = ExtractorChoice(name=settings.extractor, weights=settings.extractor_weights, device=device)
    extractor = extractor_of(choice, "extractor")
    source, real = _opened(settings)
    result = run_with_progress(translators.run_comparison(settings, source, real, extractor, FeatureCache(), output))
    numbers = {
        "gsrain": version_of("gsrain"),
        **run_provenance(_inputs(settings, source), ("torch", "diffusers", "onnxruntime")),
        "comparison": comparison,
        "source": source.name,
        "views": len(source.views),
        "real_pictures": len(real),
        "resamples": settings.resamples,
        "seed": settings.seed,
        "shown": list(result.figure_views),
        "kept": list(result.reused),
        "notes": list(result.notes),
        "rows": [results.plain_row(row) for row in result.rows],
        "settings": msgspec.to_builtins(settings, enc_hook=str),
    }
    table = results.comparison_table(result.rows)
    write_text(output / "table.md", table.markdown)
    table.write_csv(output / "table.csv")
    outputs.write_numbers(output / "table.json", numbers)
    write_image(output / "figure.png", Image.fromarray(result.figure))
    facts = {"views": f"{len(source.views)} of {source.name}", "real pictures": len(real)}
    facts |= provenance_lines(numbers)
    write_report(output / "report.html", transfers_page(result, settings, facts))
    print_transfers(result, outputs.table_stream(json))
    print(f"wrote {output}: table.md, table.csv, table.json, figure.png, report.html", file=sys.stderr)
    outputs.write_numbers(json, numbers)


def _check_inputs(settings: "results.TransferComparison") -> None:
    """Raise `MissingInputsError` with everything that a comparison lacks on this machine, torch among it."""
    from gsrain_engine.appearance.registry import find_method
    from gsrain_engine.evaluation import compare_results as results
    from gsrain_engine.evaluation import compare_translators as translators

    learned = [each.name for each in settings.methods if each.method != results.CLEAR
               and find_method(each.method).needs_torch]  # fmt: skip
    missing: list[str] = []
    try:
        if learned:
            require_package("torch", f"method {learned[0]!r}", "diffusion")
    except ValueError as error:
        missing.append(str(error))
    missing += translators.missing_inputs(settings)
    if missing:
        raise MissingInputsError(missing)


def _opened(settings: "results.TransferComparison") -> "tuple[translators.ComparedSource, Capture]":
    from gsrain_engine.appearance.scene_views import chosen_views
    from gsrain_engine.appearance.session import source_views
    from gsrain_engine.datasets.open_capture import open_capture
    from gsrain_engine.datasets.open_source import names_scene
    from gsrain_engine.evaluation import compare_translators as translators
    from gsrain_engine.scene.open import load_scene

    if settings.pictures is not None:
        weights = [each.weights for each in settings.methods if each.weights is not None]
        return translators.held_out_images(settings.pictures, settings.width_px, weights)
    assert settings.source is not None
    real = translators.real_images(settings.real, settings.width_px)
    choice = msgspec.structs.replace(settings.views, width_px=settings.width_px)
    if not names_scene(settings.source):
        capture = chosen_views(open_capture(settings.source), choice)
        stamp = input_fingerprint(Path(settings.source))
        return translators.capture_source(capture, settings.width_px, stamp), real
    recording = None if settings.capture is None else open_capture(settings.capture)
    opened = source_views(load_scene(settings.source), choice, recording)
    files = [each for each in (settings.source, settings.capture) if each is not None]
    stamp = "-".join(input_fingerprint(Path(each)) for each in files)
    views = opened.views, opened.surroundings, opened.to_world, opened.mask
    return translators.ComparedSource(opened.name, *views, True, stamp), real


def _inputs(settings: "results.TransferComparison", source: "translators.ComparedSource") -> dict[str, str]:
    """Return hashes of the inputs: of a scene's bytes, and of names, sizes and times of all other files."""
    from gsrain_engine.datasets.open_source import names_scene
    from gsrain_engine.scene.open import scene_hash

    is_scene = settings.source is not None and names_scene(settings.source)
    found = {"clear views": scene_hash(settings.source) if is_scene else source.stamp}
    rainy = settings.real if settings.pictures is None else [Path(each.path) for each in settings.pictures.rainy]
    files: dict[str, Path | None] = {f"real pictures {path}": Path(path) for path in rainy}
    files |= {"capture": settings.capture, "weights of the extractor": settings.extractor_weights}
    for each in settings.methods:
        files |= {f"{name} of {each.name}": getattr(each, name) for name in ("weights", "images", "base")}
    return found | {name: input_fingerprint(path) for name, path in files.items() if path is not None}


# Table and HTML page

_WITHOUT_CAMERAS = "Nobody knows where these pictures were taken: whether views agree with each other is not measured."


def transfers_page(
    result: "translators.ComparisonResult", settings: "results.TransferComparison", facts: Mapping[str, object]
) -> "RunReport":
    """Lay out the page of a comparison; `facts` come first among its settings."""
    from gsrain_engine.evaluation import compare_results as results
    from gsrain_engine.report.page import ReportFigure, RunReport

    rows, distance = result.rows, result.rows[0].distance
    notes = [f"{row.name}: {warning}." for row in rows for warning in row.distance.warnings]
    if not result.has_cameras:
        notes.append(_WITHOUT_CAMERAS)
    notes += [*_without_film(result), *result.notes]
    methods = {f"method {each.name}": _changed(each) for each in settings.methods}
    about = {"extractor": distance.extractor, "resamples": settings.resamples, "seed": settings.seed}
    return RunReport(
        title="Comparison of transfers",
        settings={**facts, **about, **methods},
        headlines={f"{distance.metric}, {row.name}": f"{row.distance.frechet.value:.4g}" for row in rows},
        figures=(ReportFigure("Views by method", result.figure, ", ".join(result.figure_views), is_photograph=True),),
        tables=(results.comparison_table(rows),),
        notes=tuple(notes),
    )


def print_transfers(result: "translators.ComparisonResult", file: TextIO) -> None:
    """Print the table, the reused methods, and warnings about the distances."""
    from gsrain_engine.evaluation import compare_results as results

    print_lines(results.comparison_table(result.rows).text, file=file)
    if not result.has_cameras:
        print(_WITHOUT_CAMERAS, file=file)
    for note in (*_without_film(result), *result.notes):
        print(note, file=file)
    if result.reused:
        print(f"Not run again, for their pictures stand: {', '.join(result.reused)}.", file=file)
    for row in result.rows:
        for warning in row.distance.warnings:
            print(f"{row.name}, {row.distance.metric}: {warning}.", file=file)


def _without_film(result: "translators.ComparisonResult") -> list[str]:
    """Return a sentence that explains empty numbers outside the water film, if there are any."""
    from gsrain_engine.evaluation import compare_results as results

    rows = [row for row in result.rows if row.pairs and row.outside_film is None and row.method != results.CLEAR]
    names = [row.name for row in rows]
    return [film_note(names)] if names else []


def _changed(method: "results.ComparedMethod") -> str:
    values = msgspec.to_builtins(method, enc_hook=str)
    defaults = {each.name: each.default for each in msgspec.structs.fields(method)}
    own = {key: value for key, value in values.items() if key not in ("name", "method") and value != defaults[key]}
    return ", ".join([method.method, *(f"{key} {value}" for key, value in own.items())])
