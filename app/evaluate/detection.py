"""`gsrain evaluate detection`: effect of rain on object detectors."""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
import numpy as np
from jaxtyping import Float64, UInt8
from PIL import Image

from gsrain_engine.appearance.capture_photos import CapturePhotos
from gsrain_engine.appearance.scene_views import (
    PlacedCamera,
    ViewChoice,
    chosen_cameras,
    chosen_views,
    evenly_spaced_indices,
)
from gsrain_engine.backends import Backend, open_renderer
from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.undistort import undistort_frame
from gsrain_engine.evaluation.attribution.factors import NO_FACTORS, factor_names, is_attributed, overcast_twin
from gsrain_engine.evaluation.attribution.results import (
    OVER,
    Attribution,
    method_of,
    share_figure,
    share_table,
    write_share_csv,
)
from gsrain_engine.evaluation.detection import run as evaluation
from gsrain_engine.evaluation.detection import summary
from gsrain_engine.evaluation.detection.attribution import (
    DropSizeScore,
    RainAttribution,
    drop_size_figure,
    drop_size_scores,
    rain_attributions,
    size_variant,
)
from gsrain_engine.evaluation.detection.detector import Detector, open_detector
from gsrain_engine.evaluation.detection.drawing import draw_truths
from gsrain_engine.evaluation.detection.figures import detection_sheet, figure_pixels, object_figure, precision_figure
from gsrain_engine.evaluation.detection.ground_truth import MIN_HEIGHT_PX, MIN_VISIBILITY, read_coco
from gsrain_engine.evaluation.detection.metrics import Robustness
from gsrain_engine.evaluation.report import ReportFigure, ReportTable, RunReport, input_fingerprint, write_report
from gsrain_engine.rain.available import check_available
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.properties import extinction_note
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import OVERCAST
from gsrain_engine.render.images import write_image
from gsrain_engine.render.photograph import light_words
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.sequence import find_rig_cameras
from gsrain_engine.render.sky_color import SkyColor, sky_color
from gsrain_engine.render.video import SUFFIXES as VIDEO_SUFFIXES
from gsrain_engine.render.video import VideoWriter
from gsrain_engine.safe_io.errors import MissingInputsError
from gsrain_engine.safe_io.limits import file_sha256
from gsrain_engine.scene.open import file_hash, load_sorted_scene, scene_hash
from gsrain_engine.scene.scene import Scene

from ..console import Console, print, progress_bar, table_of
from ..options import (
    BACKEND,
    AllowOutside,
    JsonFile,
    Preset,
    Wet,
    as_number,
    check_within,
    converted_options,
    flag,
    let_names_lead_outside,
    option,
    options_of,
    parse_intensities,
    setting,
    split_words,
)
from ..outputs import check_ending, claim_outputs, command_line, finite_numbers, version_of, write_numbers
from ..render import rainy_light
from ..scene import missing_source, names_scene
from .attribution import print_shares

_COLUMNS = 150
ViewOptions = options_of(
    ViewChoice, "evaluate detection", defaults={"sensors": "the one ahead; of a capture, all", "width_px": "960"}
)
WeatherOptions = options_of(RainSettings, "evaluate detection", defaults={"exposure_s": "the camera's own"})


def detection(
    source: Annotated[str | None, option("Scene or capture; default: the built-in street.", "SCENE|CAPTURE")] = None,
    /,
    *,
    detector: Annotated[list[Path], flag("ONNX file of a detector; may be given several times.")],
    description: Annotated[
        list[str] | None,
        flag(
            "Description of the detectors, one for all or one each: a shipped name such as yolox, or a YAML file. "
            "Default: FILE.yaml next to the ONNX file, else from the file itself."
        ),
    ] = None,
    rain: Annotated[
        str, setting(RainSettings, "intensity_mm_h", "Several with commas; 0 is always included.")
    ] = "0,1.2,8.5,12",
    diameter_scale: Annotated[
        str | None,
        setting(RainSettings, "diameter_scale", "Several with commas are compared at equal mm/h. Default: 1."),
    ] = None,
    seeds: Annotated[int, option("Number of rains of each intensity: seeds 0 to N-1.")] = 5,
    attribute: Annotated[
        str,
        option(
            "Share of each part of the rain in its effect: all that it has, or those of a list, of which it then "
            f"consists ({', '.join(factor_names(of_drives=False))}).",
            "--attribute",
        ),
    ] = NO_FACTORS,
    frames: Annotated[int, option("Number of moments of the drive; of a capture, images of each camera.")] = 4,
    first: Annotated[float | None, option("First moment in seconds of scene time.", "--from")] = None,
    last: Annotated[float | None, option("Last moment in seconds of scene time.", "--to")] = None,
    views: ViewOptions | None = None,
    capture: Annotated[Path | None, option("Capture of the scene, whose images are tested too.")] = None,
    truth: Annotated[Path | None, option("COCO file with ground truth of the capture; default: its 3D boxes.")] = None,
    wet: Wet = None,
    preset: Preset = None,
    weather: WeatherOptions | None = None,
    backend: Annotated[Backend, BACKEND] = "auto",
    output: Annotated[
        Path | None, option("Folder for tables, figures, report.html and numbers.", "--output", "-o")
    ] = None,
    video: Annotated[Path | None, option("MP4 or WebM: the views in each rain with the detections.")] = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Measure what rain does to object detectors: confidence, boxes, classes and average precision by intensity.

    Each view is shown as recorded (if a capture has it), clear, and in rains of several seeds. Ground truth comes from
    the scene's actors (the street: its lead car, parked vehicles, people and traffic lights), from a capture's 3D
    boxes, or from a COCO file. Objects lower than 16 px or less than a quarter visible are ignored, and so are
    classes that a detector lacks (a sign), which are listed separately. Objects that a data set only calls vehicle
    match a car, truck, bus, van or trailer. With --output, finished results are stored there: the same command
    resumes after a stop, and more seeds,
    intensities or detectors are only added.
    """
    let_names_lead_outside(allow_outside)
    view_choice = (views or ViewOptions()).settings(ViewChoice(width_px=960))
    check_within("--width", view_choice.width_px, 64, 16384, "px")
    intensities = parse_intensities(rain)
    scales = None if diameter_scale is None else parse_scales(diameter_scale)
    factors = tuple(split_words(attribute))
    is_decomposed = _named(is_attributed, factors)
    check_within("--seeds", seeds, 1, 1000)
    check_within("--frames", frames, 1, 10_000)
    if first is not None and last is not None and not first < last:
        raise ValueError(f"--from {first:g} --to {last:g}: the second must be later")
    check_ending("--video", video, VIDEO_SUFFIXES)
    texts = _descriptions(description, len(detector))
    claim_outputs(video, json, folders=[output], locked=[video])
    _check_inputs(detector, truth, (source, capture))
    detectors = _detectors(detector, texts)
    chosen = DetectionSource(
        source, capture, truth, frames, first, last, view_choice.sensors, view_choice.width_px, wet,
        max(intensities),
    )  # fmt: skip
    base = load_preset(preset) if preset is not None else RainSettings()
    scales = scales or [base.diameter_scale]
    with open_renderer(backend) as renderer:
        own_scale, chosen_rain = 1.0 if 1.0 in scales else scales[0], weather or WeatherOptions()
        rain_of_all = chosen_rain.settings(base, diameter_scale=own_scale)
        is_scene = chosen.source is None or names_scene(chosen.source)
        check_available(chosen_rain.changes(), rain_of_all, "scene" if is_scene else "photographs")
        load_calibration(rain_of_all.calibration)  # before the views are drawn
        prepared = opened_source(renderer, chosen, rain_of_all)
        parts: list[RainAttribution] = []
        if is_decomposed:
            prepared, parts = _named(decomposed_source, prepared, chosen.source, factors, intensities, seeds)
        originals = all(frame.original is not None for frame in prepared.frames)
        trials = evaluation.conditions_of(
            tuple(intensities), tuple(range(seeds)), originals=originals, scene=prepared.pictures.photos is None
        )
        sizes = size_conditions(trials, scales, own_scale)
        prepared = with_sizes(prepared, scales, own_scale)
        further = [part.conditions for part in parts] + list(sizes.values())
        trials = list(dict.fromkeys(chain(trials, *further)))
        collector = DetectionVideo(video, prepared.frame_rate, parts[-1].steps if parts else ())
        with ExitStack() as open_files:
            cache = None
            if output is not None:
                output.mkdir(parents=True, exist_ok=True)
                cache = open_cache(output, prepared, detectors, renderer.name, wet)
                open_files.enter_context(cache)
            advance = open_files.enter_context(progress_bar("Detecting", len(prepared.frames) * len(trials)))
            open_files.callback(collector.close)
            networks = list(detectors.values())
            for image in evaluation.evaluate_images(prepared.pictures, networks, prepared.frames, trials, cache):
                collector.add(image)
                advance()
            collector.finish_view()
    numbers = detection_numbers(collector.results, detectors, renderer.name, prepared, seeds)
    numbers = replace(
        numbers,
        shares=[share for part in parts for share in part.attributed(collector.results)],
        drop_sizes=drop_size_scores(collector.results, prepared.pictures.rain, sizes) if len(sizes) > 1 else [],
    )
    print_scores(numbers.scores, Console(width=_COLUMNS))
    if numbers.shares:
        print_shares(numbers.plain["attribution"], ("detector",), Console(width=_COLUMNS))
    if numbers.drop_sizes:
        print_drop_sizes(numbers.drop_sizes, Console(width=_COLUMNS))
    for sentence in filter(None, (numbers.settings["extinction"], *detector_notes(numbers))):
        print(sentence)
    if numbers.settings["light"]:
        print(f"light of the photographs: {light_words(numbers.settings['light'])}")
    if video is not None:
        print(f"{video}: {collector.frames} frames")
    if output is not None:
        print(f"{output}: {', '.join(write_outputs(output, numbers, collector.samples, collector.step_sheet))}")
    write_numbers(json, numbers.plain)


def _check_inputs(detectors: Sequence[Path], truth: Path | None, sources: Sequence[Path | str | None]) -> None:
    """Raise `MissingInputsError` with all packages, files, scenes and captures that are missing."""
    # Average precision, which needs one of these packages, is computed last.
    packages = [name for name in ("onnxruntime", "pycocotools") if find_spec(name) is None]
    missing = [f"gsrain evaluate detection needs {each}: pip install 'gsrain[evaluate]'" for each in packages]
    files = [*(("--detector", file) for file in detectors), *([] if truth is None else [("--truth", truth)])]
    missing += [f"{option} {file}: no such file" for option, file in files if not file.exists()]
    missing += [line for source in sources for line in missing_source(source)]
    if missing:
        raise MissingInputsError(missing)


_Detectors = dict[Path, Detector]
"""Detectors by their files."""


def _descriptions(descriptions: Sequence[str] | None, count: int) -> list[str | None]:
    """Return the description of each detector; raises ValueError for a wrong number of them."""
    texts: list[str | None] = list(descriptions or [None])
    if len(texts) not in (1, count):
        raise ValueError(f"--description: {len(texts)} for {count} detectors; give one for all, or one each")
    return texts if len(texts) == count else texts * count


def _detectors(files: Sequence[Path], texts: Sequence[str | None]) -> _Detectors:
    detectors = [open_detector(file, text) for file, text in zip(files, texts, strict=True)]
    names = [detector.name for detector in detectors]
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled is not None:
        raise ValueError(f"--detector: two files are called {doubled}; rows are told apart by that name")
    return dict(zip(files, detectors, strict=True))


# Evaluated views


@dataclass(frozen=True, slots=True, eq=False)
class PreparedSource:
    """Views with their ground truth, and the renderer of their images."""

    name: str
    pictures: evaluation.ConditionRenderer
    frames: list[evaluation.EvaluatedFrame]
    frame_rate: float
    """Frame rate of a video of the views."""
    inputs: dict[str, str]
    """Inputs of the images by name: hashes of files; for a capture, a hash of names, sizes and times."""


# Cached results, for resuming

_PACKAGES = ("gsrain", "onnxruntime", "numpy", "numba", "opencv-python-headless")
"""Packages that affect images and detections."""


def open_cache(
    folder: Path, source: PreparedSource, detectors: _Detectors, backend: str, wet: bool | None
) -> evaluation.ResultCache:
    """Open the cached results in a folder, and report how many of an earlier run are still valid."""
    inputs = {
        "inputs": source.inputs,
        "wet": wet,
        "rain": msgspec.to_builtins(source.pictures.rain),
        "sky": msgspec.to_builtins(source.pictures.sky),
        "rain_before_pictures": source.pictures.photos is not None,
        "backend": backend,
        "versions": {name: version_of(name) for name in _PACKAGES},
    }
    used = {
        each.name: file_hash(file) + msgspec.json.encode(each.description, order="sorted").decode()
        for file, each in detectors.items()
    }
    cache = evaluation.ResultCache(folder / evaluation.FINISHED_FILE, inputs, used)
    count = cache.read(source.frames)
    if count:
        print(f"{folder / evaluation.FINISHED_FILE}: {count} pictures judged before")
    return cache


# Numbers on the screen and as JSON


@dataclass(frozen=True, slots=True, eq=False)
class DetectionNumbers:
    """Results of the command."""

    rows: list[evaluation.ObjectRow]
    scores: list[summary.ScoreByIntensity]
    distances: list[summary.DistanceScore]
    robustness: dict[str, Robustness]
    settings: dict[str, Any]
    not_named: dict[str, dict[str, int]]
    """Number of objects by detector and class that the detector can't name; they are not scored."""
    silent: list[str]
    """Detectors that found nothing in any image without rain."""
    shares: Sequence[Attribution] = ()
    """Shares of the factors of the rain, if it was taken apart."""
    drop_sizes: Sequence[DropSizeScore] = ()
    """Scores by drop size, if several were compared."""

    @property
    def plain(self) -> dict[str, Any]:
        attribution = {"attribution": [each.plain for each in self.shares]} if self.shares else {}
        sizes = {"drop_sizes": [each.plain for each in self.drop_sizes]} if self.drop_sizes else {}
        return self._own | attribution | sizes

    @property
    def _own(self) -> dict[str, Any]:
        return {
            "settings": self.settings,
            "robustness": finite_numbers({name: asdict(each) for name, each in self.robustness.items()}),
            "not_named": self.not_named,
            "finds_nothing": self.silent,
            "scores": [summary.plain(each) for each in self.scores],
            "recall_by_distance": [summary.plain(each) for each in self.distances],
            "rows": [row.plain() for row in self.rows],
        }


def detection_numbers(
    judgements: Sequence[evaluation.DetectionResult],
    detectors: _Detectors,
    backend: str,
    source: PreparedSource,
    seeds: int,
) -> DetectionNumbers:
    """Compute the numbers of the evaluation's own conditions.

    Raises ValueError if no view shows a detectable object.
    """
    judgements = [each for each in judgements if not each.trial.variant]
    rows = [row for each in judgements for row in evaluation.object_rows(each)]
    not_named = _not_named(judgements)
    if not rows and any(not_named.values()):
        words = "; ".join(f"{name} has no word for {_listed(each)}" for name, each in not_named.items() if each)
        raise ValueError(f"{source.name}: nothing there can be named: {words}")
    if not rows:
        raise ValueError(
            f"{source.name}: none of {len(source.frames)} views shows an object of {MIN_HEIGHT_PX:g} px or more, "
            f"{MIN_VISIBILITY:.0%} visible; choose others by --frames, --from, --to, --cameras or --width"
        )
    scored = summary.scores(rows, judgements)
    camera = source.frames[0].shot.camera
    rain = msgspec.to_builtins(source.pictures.rain)
    del rain["intensity_mm_h"], rain["seed"]
    settings = {
        "source": source.name,
        "command": command_line(),
        "detectors": {each.name: {"file": file.name, "sha256": file_sha256(file)} for file, each in detectors.items()},
        "inputs": source.inputs,
        "frames": [each.name for each in source.frames],
        "size_px": [camera.width, camera.height],
        "seeds": list(range(seeds)),
        "rain": rain,
        "extinction": extinction_note(
            msgspec.structs.replace(source.pictures.rain, intensity_mm_h=each.intensity_mm_h) for each in scored
        ),
        "rain_before_pictures": source.pictures.photos is not None,
        "light": source.pictures.lights(source.frames, max((row.intensity_mm_h for row in rows), default=0.0)),
        "pictures": {
            f"{intensity:g} mm/h": msgspec.to_builtins(source.pictures.provenance(source.frames[0], intensity))
            for intensity in sorted({row.intensity_mm_h for row in rows if row.picture == "rainy"})
        },
        "least_iou": 0.5,
        "found_from_confidence": summary.FOUND_FROM,
        "least_height_px": MIN_HEIGHT_PX,
        "least_visibility": MIN_VISIBILITY,
        "backend": backend,
        "versions": {name: version_of(name) for name in _PACKAGES},
    }
    distances, robustness = summary.distance_scores(rows), summary.robustness_of(scored)
    return DetectionNumbers(
        rows, scored, distances, robustness, settings, not_named, summary.silent_detectors(judgements)
    )


def _not_named(judgements: Sequence[evaluation.DetectionResult]) -> dict[str, dict[str, int]]:
    found: dict[str, set[tuple[str, str, str]]] = {each.detector: set() for each in judgements}
    for each in judgements:
        found[each.detector] |= {(each.frame, truth.id, truth.class_name) for truth in each.not_named}
    return {
        name: dict(sorted(Counter(class_name for _, _, class_name in objects).items()))
        for name, objects in found.items()
    }


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} ({count})" for name, count in counts.items())


def detector_notes(numbers: DetectionNumbers) -> list[str]:
    """Return a sentence for each detector that finds nothing, or that has no class for some of the objects."""
    silent = [
        f"Warning: {name} finds nothing in any clear picture (confidence of {summary.FOUND_FROM:g} or more): its "
        "description may be wrong in channels, scale, mean, deviation, fit or padding."
        for name in numbers.silent
    ]
    return silent + [
        f"Not asked of {name}, which has no word for them: {_listed(each)}."
        for name, each in numbers.not_named.items()
        if each
    ]


def print_scores(scored: Sequence[summary.ScoreByIntensity], console: Console) -> None:
    """Print one line for each detector and condition: means over seeds, and the lowest and highest seed."""
    columns = f"objects,confidence,change,recall@{summary.FOUND_FROM:g},IoU,flips,mAP50,mAP"
    table = table_of("detector,picture,mm/h", columns, wraps=True)
    for each in scored:
        table.add_row(
            each.detector, each.picture, f"{each.intensity_mm_h:g}", str(each.objects),
            f"{each.confidence.mean:.3f} ({each.confidence.low:.3f}..{each.confidence.high:.3f})",
            "" if each.change is None else _change(each.change.mean, each.change.low, each.change.high),
            f"{each.recall.mean:.0%}", f"{each.iou.mean:.2f}", f"{each.flips.mean:.0%}",
            f"{each.map50.mean:.3f}", f"{each.map.mean:.3f}",
        )  # fmt: skip
    console.print(table)
    console.print(
        "Means over objects and seeds, misses as 0 (lowest..highest seed); change from without rain, 95 % over seeds."
    )


def print_drop_sizes(scores: Sequence[DropSizeScore], console: Console) -> None:
    """Print one line for each detector, rain rate and scale of the diameters."""
    columns = f"diameters x,mean mm,drops/m³,confidence,change,recall@{summary.FOUND_FROM:g}"
    table = table_of("detector,mm/h", columns, wraps=True)
    for each in scores:
        table.add_row(
            each.detector, f"{each.intensity_mm_h:g}", f"{each.diameter_scale:g}", f"{each.mean_diameter_mm:.2f}",
            f"{each.drops_per_m3:,.0f}", f"{each.confidence.mean:.3f}",
            _change(each.change.mean, each.change.low, each.change.high), f"{each.recall.mean:.0%}",
        )  # fmt: skip
    console.print(table)


def _change(mean: float, low: float, high: float) -> str:
    return f"{mean:+.3f}" if low != low else f"{mean:+.3f} ({low:+.3f}..{high:+.3f})"


# Tables, figures, report and video

_SAMPLES = 4  # number of views in the report

_BANDS = (
    "A point is the mean over frames and seeds; a band reaches from the lowest to the highest seed. Crosses: the "
    "pictures as they were taken, where the scene is a reconstruction."
)

_Sheet = UInt8[np.ndarray, "h w 3"]


class SampleView(NamedTuple):
    """Pictures of one view for the output folder."""

    name: str
    sheet: _Sheet
    """The view in each condition, with the detections."""
    truth: _Sheet
    """The view as taken, else without rain, with its ground truth."""


class DetectionVideo:
    """Collects detection results and sample views, and writes the video.

    A video frame shows a view in all its conditions, with the first seed.
    """

    def __init__(self, file: Path | None, fps: float, steps: Sequence[tuple[str, evaluation.Condition]] = ()) -> None:
        """`file` is the video to write, or None; `steps` are the conditions of a sheet of the first view, by title."""
        self.results: list[evaluation.DetectionResult] = []
        self.samples: list[SampleView] = []
        self.frames = 0
        self._file, self._fps, self._steps = file, fps, dict(steps)
        self._step_images: dict[evaluation.Condition, evaluation.EvaluatedImage] = {}
        self._video: VideoWriter | None = None
        self._view: list[evaluation.EvaluatedImage] = []

    def add(self, image: evaluation.EvaluatedImage) -> None:
        """Add the next image; the images of a view must be consecutive."""
        self.results += image.judgements.values()
        if self._view and self._view[0].frame is not image.frame:
            self.finish_view()
        if image.trial in self._steps.values() and not self.samples:
            self._step_images[image.trial] = image
        if image.trial.seeds[0] == 0 and not image.trial.variant:
            self._view.append(image)

    def finish_view(self) -> None:
        """Write the view of the last images, after which another one begins."""
        view, self._view = self._view, []
        if not view or (self._file is None and len(self.samples) >= _SAMPLES):
            return
        sheet = detection_sheet(view)
        if len(self.samples) < _SAMPLES:
            truths = next(iter(view[0].judgements.values())).truths
            self.samples.append(SampleView(view[0].frame.name, sheet, draw_truths(view[0].image, truths)))
        if self._file is not None:
            if self._video is None:
                self._size = sheet.shape[:2]
                self._video = VideoWriter(self._file, sheet.shape[1], sheet.shape[0], self._fps)
            if sheet.shape[:2] == self._size:  # a video has one size: cameras of other aspect ratios are skipped
                self._video.write(sheet)
                self.frames += 1

    @property
    def step_sheet(self) -> _Sheet | None:
        """The first view while the parts of the rain are added one by one; None without an attribution."""
        images = [self._step_images[each] for each in self._steps.values() if each in self._step_images]
        return detection_sheet(images, list(self._steps), max_columns=4) if images else None

    def close(self) -> None:
        if self._video is not None:
            self._video.close()


def write_outputs(
    folder: Path, numbers: DetectionNumbers, samples: list[SampleView], steps: _Sheet | None = None
) -> list[str]:
    """Write tables, figures and the report into a folder; returns the names of the files."""
    folder.mkdir(parents=True, exist_ok=True)
    written = ["rows.csv", "detection.json"]
    summary.write_csv(folder / "rows.csv", numbers.rows)
    if summary.write_parquet(folder / "rows.parquet", numbers.rows):
        written.append("rows.parquet")
    write_numbers(folder / "detection.json", numbers.plain)
    figures = {
        "confidence.png": ReportFigure("Confidence", figure_pixels(object_figure(numbers.rows, "confidence")), _BANDS),
        "iou.png": ReportFigure("Overlap of boxes", figure_pixels(object_figure(numbers.rows, "iou")), _BANDS),
        "precision.png": ReportFigure("Average precision", figure_pixels(precision_figure(numbers.scores)), _BANDS),
    }
    figures = _attribution_figures(numbers, steps) | figures
    if numbers.shares:
        write_share_csv(folder / "attribution.csv", numbers.shares)
        written.append("attribution.csv")
    caption = "Full lines: found. Dashed: labelled, red where it was missed."
    for number, sample in enumerate(samples):
        figures[f"view_{number}.png"] = ReportFigure(sample.name, sample.sheet, caption, is_photograph=True)
    truths = {f"truth_{number}.png": sample.truth for number, sample in enumerate(samples)}
    for name, pixels in ({name: figure.pixels for name, figure in figures.items()} | truths).items():
        write_image(folder / name, Image.fromarray(pixels))
    write_report(folder / "report.html", _report(numbers, list(figures.values())))
    return [*written, *figures, *truths, "report.html"]


def _attribution_figures(numbers: DetectionNumbers, steps: _Sheet | None) -> dict[str, ReportFigure]:
    figures: dict[str, ReportFigure] = {}
    if numbers.shares:
        every = [each for each in numbers.shares if each.measure.object is None]
        figures["attribution.png"] = ReportFigure(
            "Shares of the factors", share_figure(every), method_of(every[0].plain) + OVER
        )
    if steps is not None:
        added = "The heaviest rain with the first seed, while its factors are added one by one."
        figures["attribution_steps.png"] = ReportFigure("Factors of the rain", steps, added, is_photograph=True)
    if numbers.drop_sizes:
        pixels = drop_size_figure(numbers.drop_sizes)
        words = "At equal mm/h: larger drops are fewer. Student's intervals, 95 %, over the seeds."
        figures["drop_sizes.png"] = ReportFigure("Drop sizes", pixels, words)
    return figures


def _report(numbers: DetectionNumbers, figures: list[ReportFigure]) -> RunReport:
    settings = numbers.settings
    headlines = {
        "objects": str(len({row.object for row in numbers.rows})),
        "views": str(len(settings["frames"])),
        "seeds": str(len(settings["seeds"])),
    }
    for name, each in numbers.robustness.items():
        headlines[f"rPC of {name} (mAP in rain over mAP without)"] = "-" if each.rpc != each.rpc else f"{each.rpc:.2f}"
    return RunReport(
        title=f"Detection in rain: {settings['source']}",
        settings={name: _output_words(value) for name, value in settings.items()},
        figures=tuple(figures),
        notes=tuple(detector_notes(numbers)),
        tables=(
            *([share_table(numbers.shares)] if numbers.shares else []),
            *([_size_table(numbers.drop_sizes)] if numbers.drop_sizes else []),
            _scores_table(numbers),
            _distance_table(numbers),
        ),
        headlines=headlines,
    )


def _scores_table(numbers: DetectionNumbers) -> ReportTable:
    return ReportTable(
        "Scores",
        ("detector", "picture", "mm/h", "objects", "confidence", "lowest seed", "highest seed", "change", "95 % from",
         "95 % to", "IoU", "recall", "flips", "mAP50", "mAP"),
        tuple(
            (
                each.detector, each.picture, f"{each.intensity_mm_h:g}", each.objects,
                each.confidence.mean, each.confidence.low, each.confidence.high,
                *((None, None, None) if each.change is None else (each.change.mean, each.change.low, each.change.high)),
                each.iou.mean, each.recall.mean, each.flips.mean, each.map50.mean, each.map.mean,
            )
            for each in numbers.scores
        ),
        caption="Means over objects and seeds, misses counted as 0. Change: of the confidence from the same views "
        "without rain, paired by seed, with Student's interval over the seeds: it tells how much drops matter, not how "
        "other streets would fare.",
    )  # fmt: skip


def _distance_table(numbers: DetectionNumbers) -> ReportTable:
    return ReportTable(
        "Recall by distance",
        ("detector", "picture", "mm/h", "distance (m)", "objects", "found", "recall", "95 % from", "95 % to"),
        tuple(
            (
                each.detector, each.picture, f"{each.intensity_mm_h:g}",
                f"{each.recall.from_m:g} to {each.recall.to_m:g}", each.recall.objects, each.recall.found,
                each.recall.recall, *each.recall.interval,
            )
            for each in numbers.distances
        ),
        caption="Wilson's interval; frames of one drive and seeds of one view are not independent, it is too narrow.",
    )  # fmt: skip


def _size_table(scores: Sequence[DropSizeScore]) -> ReportTable:
    return ReportTable(
        "Drop sizes",
        (
            "detector", "mm/h", "diameters x", "mean diameter (mm)", "drops per m3", "extinction (1/km)", "confidence",
            "recall", "change", "95 % from", "95 % to",
        ),
        tuple(
            (
                each.detector, f"{each.intensity_mm_h:g}", f"{each.diameter_scale:g}", each.mean_diameter_mm,
                each.drops_per_m3, 1000 * each.extinction_per_m, each.confidence.mean, each.recall.mean,
                each.change.mean, each.change.low, each.change.high,
            )
            for each in scores
        ),
        caption="Rain of equal mm/h whose diameters are multiplied. Change: of the confidence from the scene without "
        "rain, paired by seed, with Student's interval over the seeds.",
    )  # fmt: skip


def _output_words(value: Any) -> object:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_output_words(each)}" for name, each in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else value


# Rains that differ from the evaluation's own

_Result = TypeVar("_Result")


def parse_scales(text: str) -> list[float]:
    """Turn "0.5,1,2" into numbers, rising; raises ValueError, which names the option."""
    words = split_words(text)
    if not words:
        raise ValueError(f"--diameter-scale {text!r}: expected numbers with commas between, such as 0.5,1,2")
    found = [converted_options({"diameter_scale": as_number(each)}, RainSettings) for each in words]
    return sorted({each.diameter_scale for each in found})


def _named(function: Callable[..., _Result], *arguments: Any) -> _Result:
    """Call a function whose errors begin with the name of the setting `attribute`, which here is an option."""
    try:
        return function(*arguments)
    except ValueError as error:
        raise ValueError(re.sub("^attribute", "--attribute", str(error))) from None


def decomposed_source(
    source: PreparedSource,
    name: str | None,
    factors: Sequence[str],
    intensities: Sequence[float],
    seeds: int,
) -> tuple[PreparedSource, list[RainAttribution]]:
    """Return a source whose rain has the chosen factors, and the attribution at each intensity.

    `name` is that of the scene. Raises ValueError for factors that it lacks.
    """
    pictures, view = source.pictures, source.frames[0].shot
    rain, in_front = pictures.rain, pictures.photos is not None
    parts = rain_attributions(
        rain, factors, name, pictures.scene, intensities, range(seeds), in_front=in_front,
        softens_light=pictures.photos is not None and pictures.photos.have_distances,
    )  # fmt: skip
    rain = msgspec.structs.replace(parts[-1].factors.rain, intensity_mm_h=rain.intensity_mm_h)
    own = evaluation.RainVariant(rain, pictures.scene, pictures.sky)
    twin = None
    if not in_front and any("light" in part.factors.names for part in parts):
        scene = load_sorted_scene(overcast_twin(name))  # its hash is not an input: it has the source of the street
        twin = own._replace(scene=scene, sky=sky_color(pictures.renderer, scene, view.camera, view.time_s))
    variants = {name: each for part in parts for name, each in part.variants(own, twin).items()}
    pictures = replace(pictures, rain=own.rain, variants={**pictures.variants, **variants})
    return replace(source, pictures=pictures), parts


def size_conditions(
    trials: Sequence[evaluation.Condition], scales: Sequence[float], own: float
) -> dict[float, list[evaluation.Condition]]:
    """Return the rainy conditions with each scale of the diameters; `own` is that of the evaluation."""
    rainy = [each for each in trials if each.kind == "rainy"]
    return {
        scale: [each._replace(variant="" if scale == own else size_variant(scale)) for each in rainy]
        for scale in scales
    }


def with_sizes(source: PreparedSource, scales: Sequence[float], own: float) -> PreparedSource:
    """Return a source that also has rains with the scaled diameters."""
    pictures = source.pictures
    variants = {
        size_variant(scale): evaluation.RainVariant(
            msgspec.structs.replace(pictures.rain, diameter_scale=scale), pictures.scene, pictures.sky
        )
        for scale in scales
        if scale != own
    }
    return replace(source, pictures=replace(pictures, variants={**pictures.variants, **variants}))


# Sources of views

_SLOW_FPS = 2.0  # frame rate of videos of frames far apart in time


@dataclass(frozen=True, slots=True)
class DetectionSource:
    """Options that select the views."""

    source: str | None
    capture: Path | None
    truth: Path | None
    frames: int
    first_s: float | None
    last_s: float | None
    cameras: tuple[str, ...]
    width_px: int
    wet: bool | None
    heaviest_mm_h: float


def opened_source(renderer: Renderer, choice: DetectionSource, rain: RainSettings) -> PreparedSource:
    """Open the chosen source. Raises ValueError, which names the option, for options that contradict each other."""
    if choice.source is None or names_scene(choice.source):
        return _of_scene(renderer, choice, rain)
    if choice.capture is not None:
        raise ValueError(f"--capture: {choice.source} is a capture itself")
    if choice.wet:
        raise ValueError(f"--wet: {choice.source} is a capture; gsrain reconstruct makes a scene of it")
    return _of_capture(renderer, choice, rain)


def _of_scene(renderer: Renderer, choice: DetectionSource, rain: RainSettings) -> PreparedSource:
    scene = load_sorted_scene(choice.source)
    scene, rain = rainy_light(scene, rain, choice.wet, choice.heaviest_mm_h)
    if choice.capture is not None:
        capture = _chosen(open_capture(choice.capture), choice)
        placed = chosen_cameras(scene, ViewChoice(source="recorded", width_px=choice.width_px), capture)
        labels = None if choice.truth is None else read_coco(choice.truth)
        frames = evaluation.recorded_frames(scene, placed, capture, labels)
    else:
        if choice.truth is not None:
            raise ValueError("--truth: needs --capture, whose pictures the file is about")
        placed = _placed(scene, choice)
        frames = evaluation.scene_frames(renderer, scene, placed)
    sky = sky_color(renderer, scene, placed[0].camera, placed[0].time_s)
    inputs = {"scene": scene_hash(choice.source)} | _hashes(choice)
    return PreparedSource(
        scene.name, evaluation.ConditionRenderer(renderer, scene, rain, sky), frames, _frame_rate(placed), inputs
    )


def _of_capture(renderer: Renderer, choice: DetectionSource, rain: RainSettings) -> PreparedSource:
    capture = _chosen(open_capture(str(choice.source)), choice)
    if not capture.is_metric and capture.has_poses:
        raise ValueError(
            f"{capture.name}: its unit of length is unknown, and rain falls in meters; take the folder of its pictures "
            "alone, or a reconstruction that was scaled to meters with --capture"
        )
    photos = CapturePhotos(capture)
    world = photos.world
    placed = [_of_view(undistort_frame(view), photos, choice.width_px) for view in capture]
    labels = None if choice.truth is None else read_coco(choice.truth)
    frames = evaluation.recorded_frames(world, placed, capture, labels)
    pictures = evaluation.ConditionRenderer(renderer, world, rain, SkyColor(OVERCAST, False), photos)
    inputs = {"capture": input_fingerprint(Path(str(choice.source)))} | _hashes(choice)
    return PreparedSource(capture.name, pictures, frames, _frame_rate(placed), inputs)


def _hashes(choice: DetectionSource) -> dict[str, str]:
    """Return hashes of the inputs other than the source."""
    found = {} if choice.capture is None else {"capture": input_fingerprint(choice.capture)}
    return found if choice.truth is None else found | {"truth": file_hash(choice.truth)}


def _of_view(view: CaptureFrame, photos: CapturePhotos, width_px: int) -> PlacedCamera:
    """Return the world camera of a captured view without distortion; without poses, a level one over the road."""
    camera = photos.view(view).camera
    return PlacedCamera(view.name, camera, view.time_s, view.sensor).at_width(width_px)


def _chosen(capture: Capture, choice: DetectionSource) -> Capture:
    """Return the chosen views of each camera, evenly spaced between two times."""
    sensors = () if choice.cameras == ("all",) else choice.cameras
    low = -np.inf if choice.first_s is None else choice.first_s
    high = np.inf if choice.last_s is None else choice.last_s
    within = [view for view in chosen_views(capture, ViewChoice(sensors=sensors)) if low <= view.time_s <= high]
    if not within:
        raise ValueError(f"--from --to: {capture.name} has no picture between these moments")
    views: list[CaptureFrame] = []
    for sensor in dict.fromkeys(view.sensor for view in within):
        own = [view for view in within if view.sensor == sensor]
        views += [own[i] for i in evenly_spaced_indices(len(own), choice.frames)]
    return replace(capture, views=tuple(views))


def _placed(scene: Scene, choice: DetectionSource) -> list[PlacedCamera]:
    """Return every chosen rig camera at every time; in a scene without a rig, cameras along its path or around it."""
    if not scene.rigs or scene.ego is None or not len(scene.ego.times):
        if choice.cameras:
            raise ValueError(f"--cameras: scene {scene.name!r} has no vehicle with cameras")
        return chosen_cameras(scene, ViewChoice(count=choice.frames, width_px=choice.width_px))
    mounted = find_rig_cameras(scene, choice.cameras or (_front(scene),))
    placed: list[PlacedCamera] = []
    for time_s in _moments(scene.ego.times, choice):
        for each in mounted:
            camera = PlacedCamera(f"{each.name}_{time_s:07.3f}s", each.at(time_s), time_s, f"{each.rig}/{each.name}")
            placed.append(camera.at_width(choice.width_px))
    return placed


def _moments(times: Float64[np.ndarray, " t"], choice: DetectionSource) -> list[float]:
    """Return times from first to last if both are set, else the middle of each equal share of the drive."""
    low = float(times[0]) if choice.first_s is None else choice.first_s
    high = float(times[-1]) if choice.last_s is None else choice.last_s
    if choice.first_s is not None and choice.last_s is None and choice.frames == 1:
        return [low]
    if choice.first_s is not None and choice.last_s is not None and choice.frames > 1:
        return np.linspace(low, high, choice.frames).tolist()
    return (low + (high - low) * (np.arange(choice.frames) + 0.5) / choice.frames).tolist()


def _front(scene: Scene) -> str:
    """Return the camera of the first rig that looks most straight ahead."""
    rig, cameras = next((rig, cameras) for rig, cameras in scene.rigs.items() if cameras)
    return f"{rig}/{max(cameras, key=lambda each: each.camera_to_ego[0, 2]).name}"


def _frame_rate(placed: Sequence[PlacedCamera]) -> float:
    """Return the frame rate of the times if they are dense enough for a video."""
    times = sorted({each.time_s for each in placed})
    step = float(np.median(np.diff(times))) if len(times) > 1 else np.inf
    return float(np.clip(1 / step, _SLOW_FPS, 60.0)) if step > 0 else _SLOW_FPS
