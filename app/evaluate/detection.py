"""`gsrain evaluate detection`: effect of rain on object detectors."""

import hashlib
import json
import re
import shlex
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any

import msgspec
import numpy as np
from cyclopts import Parameter
from jaxtyping import Float64, UInt8
from PIL import Image

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
from gsrain_engine.evaluation.detection.detector import Detector, open_detector
from gsrain_engine.evaluation.detection.figures import detection_sheet, figure_pixels, object_figure, precision_figure
from gsrain_engine.evaluation.detection.ground_truth import MIN_HEIGHT_PX, MIN_VISIBILITY, read_coco
from gsrain_engine.evaluation.detection.metrics import Robustness
from gsrain_engine.evaluation.detection.run import (
    FINISHED_FILE,
    Condition,
    ConditionRenderer,
    DetectionResult,
    EvaluatedFrame,
    EvaluatedImage,
    ObjectRow,
    ResultCache,
    ResultCacheProtocol,
    conditions_of,
    evaluate_images,
    object_rows,
    recorded_frames,
    scene_frames,
)
from gsrain_engine.evaluation.detection.summary import (
    FOUND_FROM,
    DistanceScore,
    ScoreByIntensity,
    SeedSpread,
    distance_scores,
    plain,
    robustness_of,
    scores,
    write_csv,
    write_parquet,
)
from gsrain_engine.evaluation.input_fingerprint import input_fingerprint
from gsrain_engine.evaluation.report import ReportFigure, ReportTable, RunReport, write_report
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import OVERCAST
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.sequence import find_rig_cameras
from gsrain_engine.render.sky_color import SkyColor, sky_color
from gsrain_engine.render.video import SUFFIXES as VIDEO_SUFFIXES
from gsrain_engine.render.video import VideoWriter
from gsrain_engine.safe_io.limits import open_file
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.files import whole_file
from gsrain_engine.scene.open import file_hash, load_sorted_scene, scene_hash
from gsrain_engine.scene.scene import Scene

from ..console import Console, Table, print
from ..options import (
    RAIN_OPTIONS,
    AllowOutside,
    JsonFile,
    check_ending,
    check_writable,
    converted_options,
    let_names_lead_outside,
    lock_outputs,
    write_numbers,
)
from ..progress import followed, progress_bar
from ..scene_options import names_scene
from .run_facts import version_of

_MAX_SEEDS, _MAX_FRAMES = 1000, 10_000
_COLUMNS = 150


def detection(
    source: Annotated[
        str | None, Parameter(name="SCENE|CAPTURE", help="Scene or capture; without one, the built-in street.")
    ] = None,
    /,
    *,
    detector: Annotated[
        list[Path], Parameter(help="ONNX file of a detector; may be given several times.", negative="")
    ],
    description: Annotated[
        list[str] | None,
        Parameter(
            help="How the detectors are used, one for all or one each: a shipped name such as yolox, or a YAML file. "
            "Default: FILE.yaml beside the ONNX file, else what the file gives away.",
            negative="",
        ),
    ] = None,
    rain: Annotated[
        str, Parameter(help="Intensities in mm/h, 0..100, with commas between; 0 is always tried.")
    ] = "0,1.2,8.5,12",
    seeds: Annotated[int, Parameter(help="Rains of each intensity: seeds 0 to N-1, the same at each.")] = 5,
    frames: Annotated[
        int, Parameter(help="Moments, evenly over the drive; of a capture that many pictures of each camera.")
    ] = 4,
    first: Annotated[float | None, Parameter(name="--from", help="First moment in seconds of scene time.")] = None,
    last: Annotated[float | None, Parameter(name="--to", help="Last moment in seconds of scene time.")] = None,
    cameras: Annotated[
        str, Parameter(help="Rig cameras, with commas: RIG/NAME, NAME or all. Default: ahead; of a capture all.")
    ] = "",
    width: Annotated[int, Parameter(help="Width of the pictures in pixels; their proportions stay.")] = 960,
    capture: Annotated[
        Path | None, Parameter(help="What the scene was reconstructed from: its pictures are tried too.")
    ] = None,
    truth: Annotated[
        Path | None,
        Parameter(help="COCO file that says what is in the pictures of the capture; default: its 3D boxes."),
    ] = None,
    wet: Annotated[
        bool, Parameter(help="First give the scene wet colours, as the window's preview job does.", negative="")
    ] = False,
    preset: Annotated[str | None, Parameter(help="Rain preset for all but intensity and seed.")] = None,
    exposure: Annotated[float | None, Parameter(help="Shutter time in seconds; default: the camera's own.")] = None,
    backend: Annotated[Backend, Parameter(help="auto takes OpenGL on a GPU, else the processor.")] = "auto",
    output: Annotated[
        Path | None,
        Parameter(name=["--output", "-o"], help="Folder for tables (CSV, Parquet), figures, report.html and numbers."),
    ] = None,
    video: Annotated[Path | None, Parameter(help="MP4 or WebM: the views in each rain with what was found.")] = None,
    allow_outside: AllowOutside = False,
    json: JsonFile = None,
) -> None:
    """Measure what rain does to object detectors: confidence, boxes, classes and average precision by intensity.

    Each view is shown as recorded (if a capture has it), clear, and in rains of several seeds. Ground truth comes from
    the scene's actors (the street: its lead car, parked cars and trucks), from a capture's 3D boxes, or from a COCO
    file. Objects lower than 16 px or less than a quarter visible are ignored, and so are classes that a detector lacks
    (a sign), which are listed separately. Objects that a data set only calls vehicle match a car, truck, bus, van or
    trailer. With --output, finished results are stored there: the same command resumes after a stop, and more seeds,
    intensities or detectors are only added.
    """
    let_names_lead_outside(allow_outside)
    _check_installed()
    intensities = _intensities(rain)
    _check(seeds=seeds, frames=frames, width=width, first=first, last=last)
    check_ending("--video", video, VIDEO_SUFFIXES)
    check_writable(video, json, folders=[output])
    lock_outputs(output, video)
    detectors = _detectors(detector, description)
    asked = DetectionSource(source, capture, truth, frames, first, last, tuple(_words(cameras)), width, wet)
    rainfall = base_rain(preset, exposure)
    with open_renderer(backend) as renderer:
        prepared = opened_source(renderer, asked, rainfall)
        trials = prepared.trials(intensities, tuple(range(seeds)))
        recorder = DetectionVideo(video, prepared.frame_rate)
        with ExitStack() as open_files:
            memory = None
            if output is not None:
                output.mkdir(parents=True, exist_ok=True)
                memory = opened_memory(output, prepared, detectors, detector, renderer.name, asked.is_wet)
                open_files.enter_context(memory)
            advance = open_files.enter_context(
                progress_bar("Detecting", len(prepared.frames) * len(trials), draws=True)
            )
            open_files.enter_context(recorder)
            for picture in prepared.judged(detectors, trials, memory):
                recorder.take(picture)
                advance()
    numbers = detection_numbers(recorder.judgements, detectors, detector, renderer.name, prepared, seeds)
    print_scores(numbers.scores, Console(width=_COLUMNS))
    for sentence in unnamed_object_notes(numbers):
        print(sentence)
    if video is not None:
        print(f"{video}: {recorder.frames} frames")
    if output is not None:
        written = write_outputs(output, numbers, recorder.samples)
        print(f"{output}: {', '.join(written)}")
    write_numbers(json, numbers.plain)


def _check_installed() -> None:
    """Check for packages before the work: average precision, which needs one of them, is computed last."""
    missing = [name for name in ("onnxruntime", "pycocotools") if find_spec(name) is None]
    if missing:
        raise ValueError(f"gsrain evaluate detection needs {' and '.join(missing)}: pip install 'gsrain[evaluate]'")


def _detectors(files: Sequence[Path], descriptions: Sequence[str] | None) -> list[Detector]:
    given: list[str | None] = list(descriptions or [None])
    if len(given) not in (1, len(files)):
        raise ValueError(f"--description: {len(given)} for {len(files)} detectors; give one for all, or one each")
    each = given if len(given) == len(files) else given * len(files)
    detectors = [open_detector(file, how) for file, how in zip(files, each, strict=True)]
    names = [detector.name for detector in detectors]
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled is not None:
        raise ValueError(f"--detector: two files are called {doubled}; rows are told apart by that name")
    return detectors


def _intensities(text: str) -> tuple[float, ...]:
    words = _words(text)
    if not words or not all(re.fullmatch(r"\d*\.?\d+", word) and float(word) <= 100 for word in words):
        raise ValueError(f"--rain {text}: expected mm/h within 0..100 with commas between, such as 0,1.2,8.5,12")
    return tuple(sorted({float(word) for word in words}))


def _check(*, seeds: int, frames: int, width: int, first: float | None, last: float | None) -> None:
    if not 1 <= seeds <= _MAX_SEEDS:
        raise ValueError(f"--seeds {seeds}: must be within 1..{_MAX_SEEDS}")
    if not 1 <= frames <= _MAX_FRAMES:
        raise ValueError(f"--frames {frames}: must be within 1..{_MAX_FRAMES}")
    if not 64 <= width <= 16384:
        raise ValueError(f"--width {width}: must be within 64..16384 px")
    if first is not None and last is not None and not first < last:
        raise ValueError(f"--from {first:g} --to {last:g}: the second must be later")


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


# Evaluated views


@dataclass(frozen=True, slots=True, eq=False)
class PreparedSource:
    """Views with their ground truth, and the renderer of their images."""

    name: str
    pictures: ConditionRenderer
    frames: list[EvaluatedFrame]
    frame_rate: float
    """Frame rate of a video of the views."""
    inputs: dict[str, str]
    """Inputs of the images by name: hashes of files; for a capture, a hash of names, sizes and times."""

    def trials(self, intensities_mm_h: tuple[float, ...], seeds: tuple[int, ...]) -> list[Condition]:
        originals = all(frame.original is not None for frame in self.frames)
        return conditions_of(intensities_mm_h, seeds, originals=originals, scene=not self.pictures.is_in_front)

    def judged(
        self, detectors: Sequence[Detector], trials: Sequence[Condition], memory: ResultCacheProtocol | None = None
    ) -> Iterator[EvaluatedImage]:
        """Run each detector on each view in each condition, skipping results in the cache."""
        return evaluate_images(self.pictures, detectors, self.frames, trials, memory)


# Cached results, for resuming


def opened_memory(
    folder: Path,
    source: PreparedSource,
    detectors: Sequence[Detector],
    files: Sequence[Path],
    backend: str,
    is_wet: bool,
) -> ResultCache:
    """Open the cached results in a folder, and report how many of an earlier run are still valid."""
    inputs = {
        "inputs": source.inputs,
        "wet": is_wet,
        "rain": msgspec.to_builtins(source.pictures.rain),
        "sky": msgspec.to_builtins(source.pictures.sky),
        "rain_before_pictures": source.pictures.is_in_front,
        "backend": backend,
        "versions": package_versions(),
    }
    used = {
        each.name: file_hash(file) + msgspec.json.encode(each.description, order="sorted").decode()
        for each, file in zip(detectors, files, strict=True)
    }
    memory = ResultCache(folder / FINISHED_FILE, inputs, used)
    kept = memory.read(source.frames)
    if kept:
        print(f"{folder / FINISHED_FILE}: {kept} pictures judged before")
    return memory


# Numbers on the screen and as JSON

_PACKAGES = ("gsrain", "onnxruntime", "numpy", "numba", "opencv-python-headless")


@dataclass(frozen=True, slots=True, eq=False)
class DetectionNumbers:
    """Results of the command."""

    rows: list[ObjectRow]
    scores: list[ScoreByIntensity]
    distances: list[DistanceScore]
    robustness: dict[str, Robustness]
    settings: dict[str, Any]
    not_named: dict[str, dict[str, int]]
    """Number of objects by detector and class that the detector can't name; they are not scored."""

    @property
    def plain(self) -> dict[str, Any]:
        left = {name: asdict(each) for name, each in self.robustness.items()}
        return {
            "settings": self.settings,
            "robustness": {n: {k: None if v != v else v for k, v in each.items()} for n, each in left.items()},
            "not_named": self.not_named,
            "scores": [plain(each) for each in self.scores],
            "recall_by_distance": [plain(each) for each in self.distances],
            "rows": [row.plain() for row in self.rows],
        }


def detection_numbers(
    judgements: Sequence[DetectionResult],
    detectors: Sequence[Detector],
    files: Sequence[Path],
    backend: str,
    source: PreparedSource,
    seeds: int,
) -> DetectionNumbers:
    """Compute all numbers. Raises ValueError if no view shows a detectable object."""
    rows = [row for each in judgements for row in object_rows(each)]
    not_named = _not_named(judgements)
    if not rows and any(not_named.values()):
        words = "; ".join(f"{name} has no word for {_listed(each)}" for name, each in not_named.items() if each)
        raise ValueError(f"{source.name}: nothing there can be named: {words}")
    if not rows:
        raise ValueError(
            f"{source.name}: none of {len(source.frames)} views shows an object of {MIN_HEIGHT_PX:g} px or more, "
            f"{MIN_VISIBILITY:.0%} visible; choose others by --frames, --from, --to, --cameras or --width"
        )
    scored = scores(rows, judgements)
    camera = source.frames[0].shot.camera
    settings = {
        "source": source.name,
        "command": shlex.join(["gsrain", *sys.argv[1:]]),
        "detectors": {
            each.name: {"file": file.name, "sha256": _sha256(file)} for each, file in zip(detectors, files, strict=True)
        },
        "inputs": source.inputs,
        "frames": [each.name for each in source.frames],
        "size_px": [camera.width, camera.height],
        "seeds": list(range(seeds)),
        "rain": {
            name: value
            for name, value in msgspec.to_builtins(source.pictures.rain).items()
            if name not in ("intensity_mm_h", "seed")
        },
        "rain_before_pictures": source.pictures.is_in_front,
        "least_iou": 0.5,
        "found_from_confidence": FOUND_FROM,
        "least_height_px": MIN_HEIGHT_PX,
        "least_visibility": MIN_VISIBILITY,
        "backend": backend,
        "versions": package_versions(),
    }
    return DetectionNumbers(rows, scored, distance_scores(rows), robustness_of(scored), settings, not_named)


def _not_named(judgements: Sequence[DetectionResult]) -> dict[str, dict[str, int]]:
    found: dict[str, set[tuple[str, str, str]]] = {each.detector: set() for each in judgements}
    for each in judgements:
        found[each.detector] |= {(each.frame, truth.id, truth.class_name) for truth in each.not_named}
    return {
        name: dict(sorted(Counter(class_name for _, _, class_name in objects).items()))
        for name, objects in found.items()
    }


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} ({count})" for name, count in counts.items())


def unnamed_object_notes(numbers: DetectionNumbers) -> list[str]:
    """Return a sentence for each detector that has no class for some of the objects."""
    return [
        f"Not asked of {name}, which has no word for them: {_listed(each)}."
        for name, each in numbers.not_named.items()
        if each
    ]


def package_versions() -> dict[str, str | None]:
    """Return versions of the packages that affect images and detections."""
    return {name: version_of(name) for name in _PACKAGES}


def print_scores(scored: Sequence[ScoreByIntensity], console: Console) -> None:
    """Print one line for each detector and condition: means over seeds, and the lowest and highest seed."""
    table = Table("detector", "picture", "mm/h", box=None)
    for title in ("objects", "confidence", "change", f"recall@{FOUND_FROM:g}", "IoU", "flips", "mAP50", "mAP"):
        table.add_column(title, justify="right")
    for each in scored:
        table.add_row(
            each.detector,
            each.picture,
            f"{each.intensity_mm_h:g}",
            str(each.objects),
            _spread(each.confidence),
            "" if each.change is None else _change(each.change.mean, each.change.low, each.change.high),
            f"{each.recall.mean:.0%}",
            f"{each.iou.mean:.2f}",
            f"{each.flips.mean:.0%}",
            f"{each.map50.mean:.3f}",
            f"{each.map.mean:.3f}",
        )
    console.print(table)
    console.print(
        "Means over objects and seeds, misses as 0 (lowest..highest seed); change from without rain, 95 % over seeds."
    )


def _spread(spread: SeedSpread) -> str:
    return f"{spread.mean:.3f} ({spread.low:.3f}..{spread.high:.3f})"


def _change(mean: float, low: float, high: float) -> str:
    return f"{mean:+.3f}" if low != low else f"{mean:+.3f} ({low:+.3f}..{high:+.3f})"


def _sha256(file: Path) -> str:
    with open_file(file) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


# Tables, figures, report and video

_SAMPLES = 4  # number of views in the report

_BANDS = (
    "A point is the mean over frames and seeds; a band reaches from the lowest to the highest seed. Crosses: the "
    "pictures as they were taken, where the scene is a reconstruction."
)

_Sheet = UInt8[np.ndarray, "h w 3"]


class DetectionVideo:
    """Collects detection results and sample views, and writes the video.

    A video frame shows a view in all its conditions, with the first seed.
    """

    def __init__(self, file: Path | None, fps: float) -> None:
        """`file` is the video to write, or None."""
        self.judgements: list[DetectionResult] = []
        self.samples: list[tuple[str, _Sheet]] = []
        self.frames = 0
        self._file, self._fps = file, fps
        self._video: VideoWriter | None = None
        self._view: list[EvaluatedImage] = []

    def take(self, picture: EvaluatedImage) -> None:
        """Add the next image; the images of a view must be consecutive."""
        self.judgements += picture.judgements.values()
        if self._view and self._view[0].frame is not picture.frame:
            self._finish_view()
        if picture.trial.seeds[0] == 0:
            self._view.append(picture)

    def __enter__(self) -> "DetectionVideo":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._finish_view()
        if self._video is not None:
            self._video.close()

    def _finish_view(self) -> None:
        view, self._view = self._view, []
        if not view or (self._file is None and len(self.samples) >= _SAMPLES):
            return
        sheet = detection_sheet(view)
        if len(self.samples) < _SAMPLES:
            self.samples.append((view[0].frame.name, sheet))
        if self._file is not None:
            if self._video is None:
                self._size = sheet.shape[:2]
                self._video = VideoWriter(self._file, sheet.shape[1], sheet.shape[0], self._fps)
            if sheet.shape[:2] == self._size:  # a video has one size: cameras of other aspect ratios are skipped
                self._video.write(sheet)
                self.frames += 1


def write_outputs(folder: Path, numbers: DetectionNumbers, samples: list[tuple[str, _Sheet]]) -> list[str]:
    """Write tables, figures and the report into a folder; returns the names of the files."""
    folder.mkdir(parents=True, exist_ok=True)
    written = ["rows.csv", "detection.json"]
    write_csv(folder / "rows.csv", numbers.rows)
    if write_parquet(folder / "rows.parquet", numbers.rows):
        written.append("rows.parquet")
    with whole_file(folder / "detection.json") as beside:
        beside.write_text(json.dumps(numbers.plain, indent=1) + "\n", encoding="utf-8")
    figures = {
        "confidence.png": ("Confidence", figure_pixels(object_figure(numbers.rows, "confidence")), _BANDS),
        "iou.png": ("Overlap of boxes", figure_pixels(object_figure(numbers.rows, "iou")), _BANDS),
        "precision.png": ("Average precision", figure_pixels(precision_figure(numbers.scores)), _BANDS),
    }
    for name, (_, image, _) in figures.items():
        _write_png(folder / name, image)
    for number, (_, sheet) in enumerate(samples):
        _write_png(folder / f"view_{number}.png", sheet)
    shown = [ReportFigure(title, image, caption) for title, image, caption in figures.values()]
    shown += [
        ReportFigure(name, sheet, "Full lines: found. Dashed: labelled, red where it was missed.", is_photograph=True)
        for name, sheet in samples
    ]
    write_report(folder / "report.html", _report(numbers, shown))
    return [*written, *figures, *(f"view_{number}.png" for number in range(len(samples))), "report.html"]


def _report(numbers: DetectionNumbers, figures: list[ReportFigure]) -> RunReport:
    left = {
        f"rPC of {name} (mAP in rain over mAP without)": "-" if each.rpc != each.rpc else f"{each.rpc:.2f}"
        for name, each in numbers.robustness.items()
    }
    objects = {row.object for row in numbers.rows}
    settings = numbers.settings
    return RunReport(
        title=f"Detection in rain: {settings['source']}",
        settings={name: _output_words(value) for name, value in settings.items()},
        figures=tuple(figures),
        notes=tuple(unnamed_object_notes(numbers)),
        tables=(_scores_table(numbers), _distance_table(numbers)),
        headlines={
            "objects": str(len(objects)),
            "views": str(len(settings["frames"])),
            "seeds": str(len(settings["seeds"])),
            **left,
        },
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


def _output_words(value: Any) -> object:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_output_words(each)}" for name, each in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else value


def _write_png(file: Path, image: UInt8[np.ndarray, "h w 3"]) -> None:
    with whole_file(file) as beside:
        Image.fromarray(image).save(beside, format="PNG")


_SLOW_FPS = 2.0  # frame rate of videos of frames far apart in time
_LEVEL = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 0], [0, 0, 0, 1]])
"""World-to-camera transform that looks ahead over a road, for images without poses."""


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
    is_wet: bool


def base_rain(preset: str | None, exposure_s: float | None) -> RainSettings:
    """Return the rain settings, except for intensity and seed."""
    rain = load_preset(preset) if preset is not None else RainSettings()
    values = msgspec.to_builtins(rain) | ({} if exposure_s is None else {"exposure_s": exposure_s})
    return converted_options(values, RainSettings, RAIN_OPTIONS)


def opened_source(renderer: Renderer, asked: DetectionSource, rain: RainSettings) -> PreparedSource:
    """Open the chosen source. Raises ValueError, which names the option, for options that contradict each other."""
    if asked.source is None or names_scene(asked.source):
        return _of_scene(renderer, asked, rain)
    if asked.capture is not None:
        raise ValueError(f"--capture: {asked.source} is a capture itself")
    if asked.is_wet:
        raise ValueError(f"--wet: {asked.source} is a capture; gsrain reconstruct makes a scene of it")
    return _of_capture(renderer, asked, rain)


def _of_scene(renderer: Renderer, asked: DetectionSource, rain: RainSettings) -> PreparedSource:
    scene = load_sorted_scene(asked.source)
    if asked.is_wet:
        from gsrain_engine.recolor.wet_scene import wet_scene  # kernels take a second to load

        scene = followed(wet_scene(scene))
    if asked.capture is not None:
        capture = _chosen(open_capture(asked.capture), asked)
        placed = chosen_cameras(scene, ViewChoice(source="recorded", width_px=asked.width_px), capture)
        labels = None if asked.truth is None else read_coco(asked.truth)
        frames = recorded_frames(scene, placed, capture, labels)
    else:
        if asked.truth is not None:
            raise ValueError("--truth: needs --capture, whose pictures the file is about")
        placed = _placed(scene, asked)
        frames = scene_frames(renderer, scene, placed)
    sky = sky_color(renderer, scene, placed[0].camera, placed[0].time_s)
    inputs = {"scene": scene_hash(asked.source)} | _hashes(asked)
    return PreparedSource(
        scene.name, ConditionRenderer(renderer, scene, rain, sky), frames, _frame_rate(placed), inputs
    )


def _of_capture(renderer: Renderer, asked: DetectionSource, rain: RainSettings) -> PreparedSource:
    capture = _chosen(open_capture(str(asked.source)), asked)
    if not capture.is_metric and capture.has_poses:
        raise ValueError(
            f"{capture.name}: its unit of length is unknown, and rain falls in metres; take the folder of its pictures "
            "alone, or a reconstruction that was scaled to metres with --capture"
        )
    world = Scene(capture.name, up=capture.up, ego=capture.ego)
    placed = [_of_view(undistort_frame(view), world, capture, asked.width_px) for view in capture]
    labels = None if asked.truth is None else read_coco(asked.truth)
    frames = recorded_frames(world, placed, capture, labels)
    pictures = ConditionRenderer(renderer, world, rain, SkyColor(OVERCAST, False), is_in_front=True)
    inputs = {"capture": input_fingerprint(Path(str(asked.source)))} | _hashes(asked)
    return PreparedSource(capture.name, pictures, frames, _frame_rate(placed), inputs)


def _hashes(asked: DetectionSource) -> dict[str, str]:
    """Return hashes of the inputs other than the source."""
    found = {} if asked.capture is None else {"capture": input_fingerprint(asked.capture)}
    return found if asked.truth is None else found | {"truth": file_hash(asked.truth)}


def _of_view(view: CaptureFrame, world: Scene, capture: Capture, width_px: int) -> PlacedCamera:
    """Return the world camera of a captured view; without poses, a level camera over the road."""
    camera = view.camera.moved(world.scene_to_world) if capture.has_poses else _level(view.camera)
    return PlacedCamera(view.name, camera, view.time_s, view.sensor).at_width(width_px)


def _level(camera: Camera) -> Camera:
    return replace(camera, world_to_camera=_LEVEL)


def _chosen(capture: Capture, asked: DetectionSource) -> Capture:
    """Return the chosen views of each camera, evenly spaced between two times."""
    sensors = () if asked.cameras == ("all",) else asked.cameras
    there = chosen_views(capture, ViewChoice(sensors=sensors))
    low, high = asked.first_s, asked.last_s
    within = [view for view in there if (low is None or view.time_s >= low) and (high is None or view.time_s <= high)]
    if not within:
        raise ValueError(f"--from --to: {capture.name} has no picture between these moments")
    views: list[CaptureFrame] = []
    for sensor in dict.fromkeys(view.sensor for view in within):
        own = [view for view in within if view.sensor == sensor]
        views += [own[i] for i in evenly_spaced_indices(len(own), asked.frames)]
    return replace(capture, views=tuple(views))


def _placed(scene: Scene, asked: DetectionSource) -> list[PlacedCamera]:
    """Return every chosen rig camera at every time; in a scene without a rig, cameras along its path or around it."""
    if not scene.rigs or scene.ego is None or not len(scene.ego.times):
        if asked.cameras:
            raise ValueError(f"--cameras: scene {scene.name!r} has no vehicle with cameras")
        return chosen_cameras(scene, ViewChoice(count=asked.frames, width_px=asked.width_px))
    mounted = find_rig_cameras(scene, asked.cameras or (_front(scene),))
    placed: list[PlacedCamera] = []
    for time_s in _moments(scene.ego.times, asked):
        for each in mounted:
            camera = PlacedCamera(f"{each.name}_{time_s:07.3f}s", each.at(time_s), time_s, f"{each.rig}/{each.name}")
            placed.append(camera.at_width(asked.width_px))
    return placed


def _moments(times: Float64[np.ndarray, " t"], asked: DetectionSource) -> list[float]:
    """Return times from first to last if both are set, else the middle of each equal share of the drive."""
    low = float(times[0]) if asked.first_s is None else asked.first_s
    high = float(times[-1]) if asked.last_s is None else asked.last_s
    if asked.first_s is not None and asked.last_s is None and asked.frames == 1:
        return [low]
    if asked.first_s is not None and asked.last_s is not None and asked.frames > 1:
        return np.linspace(low, high, asked.frames).tolist()
    return (low + (high - low) * (np.arange(asked.frames) + 0.5) / asked.frames).tolist()


def _front(scene: Scene) -> str:
    """Return the camera of the first rig that looks most straight ahead."""
    rig, cameras = next((rig, cameras) for rig, cameras in scene.rigs.items() if cameras)
    return f"{rig}/{max(cameras, key=lambda each: each.camera_to_ego[0, 2]).name}"


def _frame_rate(placed: Sequence[PlacedCamera]) -> float:
    """Return the frame rate of the times if they are dense enough for a video."""
    times = sorted({each.time_s for each in placed})
    step = float(np.median(np.diff(times))) if len(times) > 1 else np.inf
    return float(np.clip(1 / step, _SLOW_FPS, 60.0)) if step > 0 else _SLOW_FPS
