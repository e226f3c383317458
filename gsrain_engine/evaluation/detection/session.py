"""An evaluation of detectors from its start to its report: views, conditions, images, results and their numbers."""

import logging
from collections.abc import Generator, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain
from pathlib import Path

import msgspec

from ...rain.calibration import load_calibration
from ...rain.settings import RainSettings
from ...render.renderer import Renderer
from ...render.sky_color import sky_color
from ...render.video import VideoWriter
from ...report.numbers import version_of
from ...safe_io.limits import file_sha256
from ...scene.open import file_hash, load_sorted_scene
from ...scene.progress import Progress
from ..attribution.factors import is_attributed, overcast_twin
from .attribution import RainAttribution, drop_size_scores, rain_attributions, size_variant
from .detector import Detector
from .drawing import draw_truths
from .figures import detection_sheet
from .report import PACKAGES, DetectionReport, SampleView, Sheet, detection_report
from .run import (
    FINISHED_FILE,
    AnyDetector,
    Condition,
    DetectionResult,
    EvaluatedImage,
    RainVariant,
    ResultCache,
    conditions_of,
    evaluate_images,
)
from .settings import DetectionSettings
from .sources import DetectionSource, EvaluatedViews, place_views

logger = logging.getLogger("gsrain")


def evaluate_detection(
    renderer: Renderer,
    source: DetectionSource,
    detectors: Sequence[AnyDetector],
    rain: RainSettings,
    settings: DetectionSettings,
    *,
    folder: Path | None = None,
    video: Path | None = None,
) -> Generator[Progress, None, DetectionReport]:
    """Show each view as recorded (if a capture has it), clear, and in rains of several seeds, to each detector.

    Args:
        renderer: Draws the views.
        source: The scene or capture; wet colors that a scene has come with the rain.
        detectors: Detectors of different names.
        rain: All of the rain but for its intensity and seed.
        settings: Intensities, seeds and views.
        folder: Folder in which finished results are kept: the same evaluation resumes after a stop, and more seeds,
            intensities or detectors are only added.
        video: MP4 or WebM to write: the views in each rain with the detections.

    Raises:
        ValueError: For a source without anything to find, and for settings that it can't honor; begins with their name.
    """
    _check_names(detectors)
    load_calibration(rain.calibration)  # before the views are drawn
    scales = sorted(set(settings.diameter_scales)) or [rain.diameter_scale]
    own_scale = 1.0 if 1.0 in scales else scales[0]
    rain = msgspec.structs.replace(rain, diameter_scale=own_scale)
    views = place_views(renderer, source, settings, rain)
    parts: list[RainAttribution] = []
    if is_attributed(settings.attribute):
        views, parts = _decomposed(views, source.name, settings)
    originals = all(frame.original is not None for frame in views.frames)
    intensities, seeds = _rising(settings.intensities_mm_h), tuple(range(settings.seeds))
    trials = conditions_of(intensities, seeds, originals=originals, scene=source.is_scene)
    sizes = _size_conditions(trials, scales, own_scale)
    views = _with_sizes(views, scales, own_scale)
    trials = list(dict.fromkeys(chain(trials, *(part.conditions for part in parts), *sizes.values())))
    collected = DetectionVideo(video, views.frame_rate, parts[-1].steps if parts else ())
    with ExitStack() as open_files:
        cache = None
        if folder is not None:
            cache = open_files.enter_context(_open_cache(folder, source, views, detectors, renderer.name))
            if known := cache.read(views.frames):
                logger.info("%s: %d pictures judged before", folder / FINISHED_FILE, known)
        open_files.callback(collected.close)
        count = len(views.frames) * len(trials)
        for number, image in enumerate(evaluate_images(views.pictures, detectors, views.frames, trials, cache), 1):
            collected.add(image)
            yield Progress(number / count, f"Picture {number} of {count}")
        collected.finish_view()
    facts = {
        "detectors": {each.name: _described(each) for each in detectors},
        "inputs": dict(source.inputs),
        "seeds": list(seeds),
        "backend": renderer.name,
    }
    report = detection_report(collected.results, views, facts)
    return replace(
        report,
        shares=[share for part in parts for share in part.attributed(collected.results)],
        drop_sizes=drop_size_scores(collected.results, views.pictures.rain, sizes) if len(sizes) > 1 else [],
        samples=collected.samples,
        steps=collected.step_sheet,
    )


def _check_names(detectors: Sequence[AnyDetector]) -> None:
    """Raise ValueError if there is none, or two have one name."""
    names = [detector.name for detector in detectors]
    if not names:
        raise ValueError("detector: expected one at least")
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled is not None:
        raise ValueError(f"detector: two are called {doubled}; rows are told apart by that name")


def _described(detector: AnyDetector) -> dict[str, str]:
    """Return file and hash of a detector; of one of Python, its type."""
    if isinstance(detector, Detector):
        return {"file": detector.file.name, "sha256": file_sha256(detector.file)}
    return {"python": type(detector).__qualname__}


def _rising(intensities: Iterable[float]) -> tuple[float, ...]:
    return tuple(sorted(set(intensities)))


# Finished results, for resuming


def _open_cache(
    folder: Path, source: DetectionSource, views: EvaluatedViews, detectors: Sequence[AnyDetector], backend: str
) -> ResultCache:
    """Open the finished results in a folder, of which those of an earlier run that are still valid are reused."""
    inputs = {
        "inputs": dict(source.inputs),
        "rain": msgspec.to_builtins(views.pictures.rain),
        "sky": msgspec.to_builtins(views.pictures.sky),
        "rain_before_pictures": not source.is_scene,
        "backend": backend,
        "versions": {name: version_of(name) for name in PACKAGES},
    }
    folder.mkdir(parents=True, exist_ok=True)
    return ResultCache(folder / FINISHED_FILE, inputs, {each.name: _fingerprint(each) for each in detectors})


def _fingerprint(detector: AnyDetector) -> str:
    """Return a text that differs for detectors that may find something else."""
    if not isinstance(detector, Detector):
        raise ValueError(f"folder: finished results are kept for detectors of files, which {detector.name} is not")
    return file_hash(detector.file) + msgspec.json.encode(detector.description, order="sorted").decode()


# Images of the report and the video

_SAMPLES = 4  # number of views in the report


class DetectionVideo:
    """Collects detection results and sample views, and writes the video.

    A video frame shows a view in all its conditions, with the first seed.
    """

    def __init__(self, file: Path | None, fps: float, steps: Sequence[tuple[str, Condition]] = ()) -> None:
        """`file` is the video to write, or None; `steps` are the conditions of a sheet of the first view, by title."""
        self.results: list[DetectionResult] = []
        self.samples: list[SampleView] = []
        self.frames = 0
        self._file, self._fps, self._steps = file, fps, dict(steps)
        self._step_images: dict[Condition, EvaluatedImage] = {}
        self._video: VideoWriter | None = None
        self._view: list[EvaluatedImage] = []

    def add(self, image: EvaluatedImage) -> None:
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
    def step_sheet(self) -> Sheet | None:
        """The first view while the parts of the rain are added one by one; None without an attribution."""
        images = [self._step_images[each] for each in self._steps.values() if each in self._step_images]
        return detection_sheet(images, list(self._steps), max_columns=4) if images else None

    def close(self) -> None:
        if self._video is not None:
            self._video.close()


# Rains that differ from the evaluation's own


def _decomposed(
    views: EvaluatedViews, name: str | None, settings: DetectionSettings
) -> tuple[EvaluatedViews, list[RainAttribution]]:
    """Return views whose rain has the chosen factors, and the attribution at each intensity.

    `name` is that of the scene. Raises ValueError for factors that it lacks.
    """
    pictures, view = views.pictures, views.frames[0].shot
    rain, in_front = pictures.rain, pictures.photos is not None
    parts = rain_attributions(
        rain, settings.attribute, name, pictures.scene, _rising(settings.intensities_mm_h), range(settings.seeds),
        in_front=in_front, softens_light=pictures.photos is not None and pictures.photos.have_distances,
    )  # fmt: skip
    rain = msgspec.structs.replace(parts[-1].factors.rain, intensity_mm_h=rain.intensity_mm_h)
    own = RainVariant(rain, pictures.scene, pictures.sky)
    twin = None
    if not in_front and any("light" in part.factors.names for part in parts):
        scene = load_sorted_scene(overcast_twin(name))  # its hash is not an input: it has the source of the street
        twin = own._replace(scene=scene, sky=sky_color(pictures.renderer, scene, view.camera, view.time_s))
    variants = {name: each for part in parts for name, each in part.variants(own, twin).items()}
    pictures = replace(pictures, rain=own.rain, variants={**pictures.variants, **variants})
    return replace(views, pictures=pictures), parts


def _size_conditions(trials: Sequence[Condition], scales: Sequence[float], own: float) -> dict[float, list[Condition]]:
    """Return the rainy conditions with each scale of the diameters; `own` is that of the evaluation."""
    rainy = [each for each in trials if each.kind == "rainy"]
    return {
        scale: [each._replace(variant="" if scale == own else size_variant(scale)) for each in rainy]
        for scale in scales
    }


def _with_sizes(views: EvaluatedViews, scales: Sequence[float], own: float) -> EvaluatedViews:
    """Return views that also have rains with the scaled diameters."""
    pictures = views.pictures
    variants = {
        size_variant(scale): RainVariant(
            msgspec.structs.replace(pictures.rain, diameter_scale=scale), pictures.scene, pictures.sky
        )
        for scale in scales
        if scale != own
    }
    return replace(views, pictures=replace(pictures, variants={**pictures.variants, **variants}))
