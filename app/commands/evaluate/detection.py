"""`gsrain evaluate detection`: what rain does to an object detector."""

import re
from collections.abc import Sequence
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from gsrain_engine.backends import Backend, open_renderer
from gsrain_engine.evaluate.detection.detector import Detector, open_detector
from gsrain_engine.render.video import SUFFIXES as VIDEO_SUFFIXES

from ...console import Console, print
from ..arguments import AllowOutside, JsonFile, let_names_lead_outside, write_numbers
from ..outputs import check_ending, check_writable, hold
from ..progress import progress_bar
from .detection_memory import opened_memory
from .detection_numbers import detection_numbers, print_scores, told_not_named
from .detection_outputs import DetectionVideo, write_outputs
from .detection_source import DetectionSource, base_rain, opened_source

_MOST_SEEDS, _MOST_FRAMES = 1000, 10_000
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

    Each view is shown as it was taken (where a capture has it), clear, and in rains of several seeds. What is there
    to be found comes from the scene's actors (the street: its lead car, parked cars and trucks), from a capture's 3D
    boxes, or from a COCO file; objects lower than 16 px or less than a quarter visible are neither asked for nor held
    against anybody who finds them, nor are classes that a detector has no word for (a sign), which are listed apart.
    What a data set only calls vehicle may be found as a car, truck, bus, van or trailer. With --output, what is
    finished is kept there: the same command goes on after a stop, and more seeds, intensities or detectors only add to
    it.
    """
    let_names_lead_outside(allow_outside)
    _check_installed()
    intensities = _intensities(rain)
    _check(seeds=seeds, frames=frames, width=width, first=first, last=last)
    check_ending("--video", video, VIDEO_SUFFIXES)
    check_writable(video, json, folders=[output])
    hold(output, video)
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
    for sentence in told_not_named(numbers):
        print(sentence)
    if video is not None:
        print(f"{video}: {recorder.frames} frames")
    if output is not None:
        written = write_outputs(output, numbers, recorder.samples)
        print(f"{output}: {', '.join(written)}")
    write_numbers(json, numbers.plain)


def _check_installed() -> None:
    """Average precision comes last: who lacks what it needs is told at once."""
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
    if not 1 <= seeds <= _MOST_SEEDS:
        raise ValueError(f"--seeds {seeds}: must be within 1..{_MOST_SEEDS}")
    if not 1 <= frames <= _MOST_FRAMES:
        raise ValueError(f"--frames {frames}: must be within 1..{_MOST_FRAMES}")
    if not 64 <= width <= 16384:
        raise ValueError(f"--width {width}: must be within 64..16384 px")
    if first is not None and last is not None and not first < last:
        raise ValueError(f"--from {first:g} --to {last:g}: the second must be later")


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]
