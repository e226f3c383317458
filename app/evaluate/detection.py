"""`gsrain evaluate detection`: effect of rain on object detectors."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from gsrain_engine.appearance.view_choice import ViewChoice
from gsrain_engine.choices import Backend
from gsrain_engine.evaluation.detection.settings import DetectionSettings
from gsrain_engine.optional_packages import has_package, missing_package
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.safe_io.errors import MissingInputsError

from ..console import print, print_lines, run_with_progress
from ..options import (
    BACKEND,
    AllowOutside,
    JsonFile,
    Preset,
    Wet,
    flag,
    let_names_lead_outside,
    named_options,
    option,
    options_of,
    takes_set,
)
from ..outputs import check_ending, claim_outputs, write_numbers

if TYPE_CHECKING:
    from gsrain_engine.evaluation.detection.sources import DetectionSource


ViewOptions = options_of(
    ViewChoice,
    "evaluate detection",
    defaults={"sensors": "the one ahead; of a capture, all", "width_px": "960"},
    topic="Views",
)
WeatherOptions = options_of(
    RainSettings,
    "evaluate detection",
    defaults={"exposure_s": "the camera's own"},
    topic="Rain",
    fixed={"intensity_mm_h": "--rain", "seed": "--seeds", "diameter_scale": "--diameter-scale"},
)
ConditionOptions = options_of(
    DetectionSettings,
    "evaluate detection",
    defaults={"diameter_scales": "1"},
    topic="Rain",
    fixed={"cameras": "--cameras"},
)


@takes_set
def detection(
    source: Annotated[str | None, option("Scene or capture; default: the built-in street.", "SCENE|CAPTURE")] = None,
    /,
    *,
    detector: Annotated[list[Path], flag("ONNX file of a detector; may be given several times.", "Detectors")],
    description: Annotated[
        list[str] | None,
        flag(
            "Description of the detectors, one for all or one each: a shipped name such as yolox, or a YAML file. "
            "Default: FILE.yaml next to the ONNX file, else from the file itself.",
            "Detectors",
        ),
    ] = None,
    conditions: ConditionOptions | None = None,
    views: ViewOptions | None = None,
    capture: Annotated[Path | None, option("Capture of the scene, whose images are tested too.", topic="Views")] = None,
    truth: Annotated[
        Path | None, option("COCO file with ground truth of the capture; default: its 3D boxes.", topic="Detectors")
    ] = None,
    wet: Wet = None,
    preset: Preset = None,
    weather: WeatherOptions | None = None,
    backend: Annotated[Backend, BACKEND] = "auto",
    output: Annotated[
        Path | None, option("Folder for tables, figures, report.html and numbers.", "--output", "-o", topic="Output")
    ] = None,
    video: Annotated[
        Path | None, option("MP4 or WebM: the views in each rain with the detections.", topic="Output")
    ] = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Measure what rain does to object detectors: confidence, boxes, classes and average precision by intensity.

    Each view is shown as recorded (if a capture has it), clear, and in rains of several seeds. Ground truth comes from
    the scene's actors (the street: its lead car, parked vehicles, people and traffic lights), from a capture's 3D
    boxes, or from a COCO file. Objects lower than 16 px or less than a quarter visible are ignored, and so are
    classes that a detector lacks (a sign), which are listed separately. Objects that a data set only calls vehicle
    match a car, truck, bus, van or trailer. With --output, finished results are stored there: the same command
    resumes after a stop, and more seeds, intensities or detectors are only added.
    """
    import msgspec

    from gsrain_engine.backends import open_renderer
    from gsrain_engine.evaluation.detection.detector import open_detector
    from gsrain_engine.evaluation.detection.session import evaluate_detection
    from gsrain_engine.rain.available import check_available
    from gsrain_engine.render.video import SUFFIXES as VIDEO_SUFFIXES
    from gsrain_engine.scene.scene import Scene

    from ..render import rainy_light

    let_names_lead_outside(allow_outside)
    cameras = (views or ViewOptions()).settings(ViewChoice(width_px=960))
    settings = (conditions or ConditionOptions()).settings(cameras=msgspec.to_builtins(cameras))
    chosen = weather or WeatherOptions()
    rain = chosen.settings(load_preset(preset) if preset is not None else None)
    check_ending("--video", video, VIDEO_SUFFIXES)
    texts = _descriptions(description, len(detector))
    claim_outputs(video, json, folders=[output], locked=[video])
    _check_inputs(detector, truth, (source, capture))
    detectors = [open_detector(file, text) for file, text in zip(detector, texts, strict=True)]
    with named_options(DetectionSettings, "detector", "capture", "truth"), open_renderer(backend) as renderer:
        opened = _source(source, capture, truth)
        check_available(chosen.changes(), rain, "scene" if opened.is_scene else "photographs")
        if isinstance(opened.views, Scene):
            lit, rain = rainy_light(opened.views, rain, wet, max(settings.intensities_mm_h))
            opened = opened.with_scene(lit)
        elif wet:
            raise ValueError(f"--wet: {source} is a capture; gsrain reconstruct makes a scene of it")
        work = evaluate_detection(renderer, opened, detectors, rain, settings, folder=output, video=video)
        report = run_with_progress(work)
    for table in report.printed:
        print(f"{table.title}:")
        print_lines(f"{table.text}\n")
    for sentence in filter(None, (report.settings["extinction"], *report.notes)):
        print(sentence)
    if output is not None:
        print(f"{output}: {', '.join(report.save(output))}")
    if video is not None:
        print(video)
    write_numbers(json, report.plain)


def _source(name: str | None, capture: Path | None, truth: Path | None) -> "DetectionSource":
    from gsrain_engine.datasets.open_capture import open_capture
    from gsrain_engine.datasets.open_source import open_source, source_hash
    from gsrain_engine.evaluation.detection.ground_truth import read_coco
    from gsrain_engine.evaluation.detection.sources import DetectionSource
    from gsrain_engine.scene.open import file_hash

    inputs = {"source": source_hash(name)}
    inputs |= {} if capture is None else {"capture": source_hash(capture)}
    inputs |= {} if truth is None else {"truth": file_hash(truth)}
    recording = None if capture is None else open_capture(capture)
    labels = None if truth is None else read_coco(truth)
    return DetectionSource(open_source(name), recording, labels, name, inputs)


def _check_inputs(detectors: Sequence[Path], truth: Path | None, sources: Sequence[Path | str | None]) -> None:
    """Raise `MissingInputsError` with all packages, files, scenes and captures that are missing."""
    from gsrain_engine.datasets.open_source import missing_source

    # Average precision, which needs one of these packages, is computed last.
    packages = [name for name in ("onnxruntime", "pycocotools") if not has_package(name)]
    missing = [missing_package(each, "gsrain evaluate detection") for each in packages]
    files = [*(("--detector", file) for file in detectors), *([] if truth is None else [("--truth", truth)])]
    missing += [f"{option} {file}: no such file" for option, file in files if not file.exists()]
    missing += [line for source in sources for line in missing_source(source)]
    if missing:
        raise MissingInputsError(missing)


def _descriptions(descriptions: Sequence[str] | None, count: int) -> list[str | None]:
    """Return the description of each detector; raises ValueError for a wrong number of them."""
    texts: list[str | None] = list(descriptions or [None])
    if len(texts) not in (1, count):
        raise ValueError(f"--description: {len(texts)} for {count} detectors; give one for all, or one each")
    return texts if len(texts) == count else texts * count
