"""Detection sweep over views, rain rates and seeds: images, evaluation, result cache, and frames."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache, partial
from math import nan
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple, Protocol, runtime_checkable

import msgspec
import numpy as np
from jaxtyping import UInt8
from msgspec import structs

from ...appearance.capture_photos import CapturePhotos, as_copied
from ...appearance.scene_views import PlacedCamera
from ...datasets.capture import Capture, CaptureFrame
from ...datasets.undistort import undistort_frame
from ...rain.settings import RainSettings
from ...rain.simulation import RainSimulation
from ...render.draw import draw, meter
from ...render.frame_input import CameraMemory, FrameInput, Mount
from ...render.passes.glass import ego_motion
from ...render.provenance import PictureProvenance, provenance_of
from ...render.renderer import Renderer
from ...render.sky_color import SkyColor
from ...render.view import RenderView, ego_view
from ...safe_io.files import whole_file
from ...safe_io.limits import read_file
from ...scene.objects import scene_objects
from ...scene.scene import Scene
from .decoders import intersection_over_union
from .detector import Detection
from .ground_truth import LabeledObject, can_detect_class, ground_truth_from_boxes, ground_truth_from_scene
from .metrics import MIN_IOU, ObjectMatch, box_rows, match_detections


@runtime_checkable
class DetectorProtocol(Protocol):
    """Interface of object detectors, such as `Detector`; without `classes` it can name all of them."""

    @property
    def name(self) -> str: ...

    @property
    def classes(self) -> tuple[str, ...]: ...

    def detect(self, image: UInt8[np.ndarray, "h w 3"]) -> list[Detection]:
        """Detect objects in an image (RGB), by descending confidence."""
        ...


@runtime_checkable
class MatchingDetector(Protocol):
    """Interface of detectors that match what they find by themselves, such as those of boxes in space."""

    @property
    def name(self) -> str: ...

    def confidences(self, image: UInt8[np.ndarray, "h w 3"], frame: "EvaluatedFrame") -> Mapping[str, float]:
        """Confidence (0..1) of each object of a view that is found in an image (RGB), by its id; others are missed.

        `frame` has the objects (`truths`), and the camera in the world and the time of the view (`shot`).
        """
        ...


AnyDetector = DetectorProtocol | MatchingDetector

# Conditions

Kind = Literal["original", "clear", "rainy"]  # original photograph; the scene without rain; the scene in rain


class Condition(NamedTuple):
    """Weather condition of an image."""

    kind: Kind
    intensity_mm_h: float
    seeds: tuple[int, ...]
    """Seeds that it represents: one for rain, all for an image without rain."""
    variant: str = ""
    """Name of another rain or scene among `ConditionRenderer.variants`; empty for the evaluation's own."""


class RainVariant(NamedTuple):
    """Rain that differs from that of an evaluation, such as by its factors or drop sizes, and where it falls."""

    rain: RainSettings
    scene: Scene
    sky: SkyColor
    without: frozenset[str] = frozenset()
    """Passes that are left out."""


@dataclass(frozen=True, slots=True, eq=False)
class DetectionResult:
    """Evaluation of one detector on one image."""

    detector: str
    trial: Condition
    frame: str
    truths: tuple[LabeledObject, ...]
    """Objects large and visible enough to be evaluated."""
    matches: tuple[ObjectMatch, ...]
    """One for each of them."""
    detections: tuple[Detection, ...]
    """Without those that match an ignored object."""
    not_named: tuple[LabeledObject, ...] = ()
    """Evaluable objects of classes that the detector can't name, such as a sign."""
    has_boxes: bool = True
    """False for a detector that has matched by itself: without boxes there is no overlap and no average precision."""


# Frames and images


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedFrame:
    """One view. World: meters, z up."""

    name: str
    shot: RenderView
    truths: tuple[LabeledObject, ...]
    original: Callable[[], UInt8[np.ndarray, "h w 3"]] | None = None
    """Reads the original photograph, without distortion and in the size of the view; None if there is none."""
    recorded: CaptureFrame | None = None
    """That photograph as it was recorded."""


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedImage:
    """An image with the results of all detectors."""

    frame: EvaluatedFrame
    trial: Condition
    judgements: Mapping[str, DetectionResult]
    take: Callable[[], UInt8[np.ndarray, "h w 3"]]
    """Renders the image once, on demand: results from an earlier run need no image."""

    @property
    def image(self) -> UInt8[np.ndarray, "h w 3"]:
        return self.take()


@dataclass(frozen=True, slots=True, eq=False)
class ConditionRenderer:
    """Renders the images of views. The seed fixes the drops, so that rain rates of one seed are comparable.

    Without a scene, rain is drawn over the recorded photographs, as `gsrain export-rain` draws it.
    """

    renderer: Renderer
    scene: Scene
    rain: RainSettings
    """All settings except rain rate and seed."""
    sky: SkyColor
    photos: CapturePhotos | None = None
    """Photographs over which rain is drawn, in place of the scene."""
    variants: Mapping[str, RainVariant] = field(default_factory=dict[str, RainVariant])
    _rains: dict[tuple[float, int, str], RainSimulation] = field(
        default_factory=dict[tuple[float, int, str], RainSimulation]
    )

    _memory: CameraMemory = field(default_factory=CameraMemory)

    def take(self, frame: EvaluatedFrame, trial: Condition) -> UInt8[np.ndarray, "h w 3"]:
        """Render one image, deterministically; with wet colors in rain if the scene has them."""
        if trial.kind == "original":
            assert frame.original is not None
            return frame.original()
        picture = draw(self.renderer, self.frame_input(frame, trial)).read_uint8()
        if frame.recorded is None or self.photos is None:
            return picture
        copied = as_copied(frame.recorded, picture)
        return undistort_frame(replace(frame.recorded, image_source=copied), frame.shot.camera.width).image

    def provenance(self, frame: EvaluatedFrame, intensity_mm_h: float) -> PictureProvenance:
        """Return what the picture of a view in rain of the first seed holds."""
        return provenance_of(self.frame_input(frame, Condition("rainy", intensity_mm_h, (0,))))

    def lights(self, frames: Sequence[EvaluatedFrame], intensity_mm_h: float) -> dict[str, int]:
        """Count photographs by what was done to their light in the rain of the first seed; empty for a scene."""
        if self.photos is None:
            return {}
        rainfall = self._rainfall(Condition("rainy", intensity_mm_h, (0,)))
        views = [frame.recorded for frame in frames if frame.recorded is not None]
        return dict(Counter(self.photos.light(view, rainfall).kind for view in views))

    def _variant(self, trial: Condition) -> RainVariant:
        return self.variants[trial.variant] if trial.variant else RainVariant(self.rain, self.scene, self.sky)

    def _rainfall(self, trial: Condition) -> RainSimulation:
        key = trial.intensity_mm_h, trial.seeds[0], trial.variant
        if key not in self._rains:
            while len(self._rains) >= _MAX_RAINS:
                del self._rains[next(iter(self._rains))]
            rain = structs.replace(self._variant(trial).rain, intensity_mm_h=key[0], seed=key[1])
            self._rains[key] = RainSimulation.start(rain)
        return self._rains[key]

    def frame_input(self, frame: EvaluatedFrame, trial: Condition) -> FrameInput:
        """Return what the picture of a view in a weather holds: of the scene, or of the photograph as recorded."""
        rainfall, variant = self._rainfall(trial), self._variant(trial)
        if self.photos is not None:
            assert frame.recorded is not None
            return self.photos.frame(frame.recorded, rainfall)
        past = ego_motion(self.scene, frame.shot)
        mount = Mount(self._memory, frame.name, past.motion, past.camera_to_ego)
        meter(self.renderer, FrameInput.of(self.scene, rainfall, self.sky, frame.shot, mount=mount))  # same for all
        is_clear = trial.kind == "clear"
        return FrameInput.of(
            variant.scene, rainfall, variant.sky, frame.shot, is_clear=is_clear, without=variant.without, mount=mount
        )


_MAX_RAINS = 256  # number of rains kept ready


def evaluate_images(
    pictures: ConditionRenderer,
    detectors: Sequence[AnyDetector],
    frames: Sequence[EvaluatedFrame],
    trials: Sequence[Condition],
    memory: "ResultCache | None" = None,
) -> Iterator[EvaluatedImage]:
    """Render each image and run each detector on it, view by view; results in `memory` are reused, new ones added."""
    for frame in frames:
        for trial in trials:
            take = cache(partial(pictures.take, frame, trial))
            judgements: dict[str, DetectionResult] = {}
            for each in detectors:
                judgement = None if memory is None else memory.known(each.name, frame, trial)
                if judgement is None:
                    judgement = _judged(each, frame, trial, take())
                    if memory is not None:
                        memory.keep(judgement, frame)
                judgements[each.name] = judgement
            yield EvaluatedImage(frame, trial, judgements, take)


def _judged(
    detector: AnyDetector, frame: EvaluatedFrame, trial: Condition, image: UInt8[np.ndarray, "h w 3"]
) -> DetectionResult:
    if not isinstance(detector, MatchingDetector):
        return evaluate_detections(detector.name, frame, trial, detector.detect(image), detector.classes)
    found = detector.confidences(image, frame)
    truths = tuple(each for each in frame.truths if each.counts)
    wrong = next((value for value in found.values() if not 0 <= value <= 1), None)
    if wrong is not None:
        raise ValueError(f"{detector.name}: a confidence of {wrong}, expected 0 to 1")
    matches: list[ObjectMatch] = []
    for truth in truths:
        own = float(found.get(truth.id, 0.0))
        matches.append(ObjectMatch(own, nan, own, nan, truth.class_name if own > 0 else None, None))
    return DetectionResult(detector.name, trial, frame.name, truths, tuple(matches), (), has_boxes=False)


def evaluate_detections(
    detector: str, frame: EvaluatedFrame, trial: Condition, detections: Sequence[Detection], classes: Sequence[str] = ()
) -> DetectionResult:
    """Match detections with the objects of a view; `classes` are those of the detector, if known.

    Ignored objects take part in the matching, so that detections of them are not counted as errors: those too small or
    too occluded, and those of classes that the detector can't name.
    """
    counted = tuple(each for each in frame.truths if each.counts)
    truths = tuple(each for each in counted if can_detect_class(classes, each.class_name))
    matches = tuple(match_detections(truths, detections))
    others = [each for each in frame.truths if each not in truths]
    fair = tuple(detections)
    if others and detections:  # without those that overlap an ignored object more than any evaluated one
        boxes = box_rows(detections)
        ignored = intersection_over_union(box_rows(others), boxes).max(axis=0)
        counting = intersection_over_union(box_rows(truths), boxes).max(axis=0, initial=0.0)
        is_fair = ~((ignored >= MIN_IOU) & (ignored > counting))
        fair = tuple(each for each, fits in zip(detections, is_fair, strict=True) if fits)
    not_named = tuple(each for each in counted if each not in truths)
    return DetectionResult(detector, trial, frame.name, truths, matches, fair, not_named)


@dataclass(frozen=True, slots=True)
class ObjectRow:
    """One object in one image for one detector: a row of the tables."""

    detector: str
    picture: Kind
    intensity_mm_h: float
    seed: int
    frame: str
    object: str
    class_name: str
    confidence: float
    """Of the detection with the right class and an IoU of 0.5 or more; 0 if missed."""
    iou: float
    """Of that detection; 0 if missed."""
    confidence_any_class: float
    iou_any_class: float
    class_seen: str | None
    """Class of the detection; None without one."""
    visibility: float
    distance_m: float | None
    height_px: float

    def plain(self) -> dict[str, Any]:
        """Return its fields by the column names of the tables."""
        return {name if name != "class_name" else "class": getattr(self, name) for name in ObjectRow.__slots__}


def object_rows(judgement: DetectionResult) -> Iterator[ObjectRow]:
    """Yield one row per object and seed of an image, also at 0 mm/h, so that seeds pair across rain rates."""
    trial = judgement.trial
    for seed in trial.seeds:
        for truth, match in zip(judgement.truths, judgement.matches, strict=True):
            yield ObjectRow(
                judgement.detector, trial.kind, trial.intensity_mm_h, seed, judgement.frame, truth.id, truth.class_name,
                match.confidence, match.iou, match.confidence_any_class, match.iou_any_class, match.class_seen,
                truth.visibility, truth.distance_m, truth.height_px,
            )  # fmt: skip


# Result cache
# One JSON line per result, so that a stopped sweep can resume.

FINISHED_FILE = "finished.jsonl"
_FORM = b"3"  # format version; increased if the evaluation of the same inputs changes
_DIGITS = 16
_Image = tuple[str, str, float, int, str]  # key of detector and view, kind of image, rain rate, first seed, variant


class _CacheLine(msgspec.Struct, frozen=True, kw_only=True):
    """A line of the file: a result, and a hash of all its inputs."""

    key: str
    judgement: DetectionResult


class ResultCache:
    """Results in a file, one per line, each written immediately. A truncated last line is ignored.

    A result is reused if its detector, its view and all inputs of its image are unchanged: more seeds, rain rates,
    views or detectors only add to the file; results of other inputs are removed.
    """

    def __init__(self, file: Path, inputs: Mapping[str, Any], detectors: Mapping[str, str]) -> None:
        """Prepare the cache; `read` loads the file, which may be missing.

        `inputs` are all inputs of the images except the view: hashes of files, settings, versions; `detectors` has, by
        name, a hash of each detector's file and its usage.
        """
        common = msgspec.json.encode(inputs, order="sorted")
        self._bases = {name: _hash(_FORM, common, name.encode(), each.encode()) for name, each in detectors.items()}
        self._file = file
        self._known: dict[_Image, DetectionResult] = {}
        self._stream: BinaryIO | None = None

    def __enter__(self) -> "ResultCache":
        self._stream = self._file.open("ab")
        return self

    def __exit__(self, *error: object) -> None:
        if self._stream is not None:
            self._stream.close()

    def read(self, frames: list[EvaluatedFrame]) -> int:
        """Load the still valid results for these views and drop the others from the file; return their number."""
        if not self._file.is_file():
            return 0
        keys = {self._key(name, frame) for name in self._bases for frame in frames}
        lines = read_file(self._file).splitlines(keepends=True)
        valid: list[bytes] = []
        for line in lines:
            try:
                read = msgspec.json.decode(line, type=_CacheLine)
            except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):  # truncated by a killed run
                continue
            if read.key in keys and line.endswith(b"\n"):
                valid.append(line)
                self._known[_image(read.key, read.judgement.trial)] = read.judgement
        if len(valid) < len(lines):
            with whole_file(self._file) as temporary:
                temporary.write_bytes(b"".join(valid))
        return len(self._known)

    def known(self, detector: str, frame: EvaluatedFrame, trial: Condition) -> DetectionResult | None:
        found = self._known.get(_image(self._key(detector, frame), trial))
        return None if found is None else replace(found, trial=trial)

    def keep(self, judgement: DetectionResult, frame: EvaluatedFrame) -> None:
        assert self._stream is not None
        line = _CacheLine(key=self._key(judgement.detector, frame), judgement=judgement)
        self._stream.write(msgspec.json.encode(line, enc_hook=np.generic.item) + b"\n")
        self._stream.flush()

    def _key(self, detector: str, frame: EvaluatedFrame) -> str:
        return _hash(self._bases[detector].encode(), *_content_bytes((frame.name, frame.shot, frame.truths)))


def _image(key: str, trial: Condition) -> _Image:
    return key, trial.kind, trial.intensity_mm_h, trial.seeds[0], trial.variant


def _content_bytes(value: Any) -> list[bytes]:
    """The bytes of a value: whole arrays, dataclasses field by field."""
    if isinstance(value, np.ndarray):
        return [value.tobytes()]
    if isinstance(value, tuple):
        return [part for each in value for part in _content_bytes(each)]
    if is_dataclass(value):
        return [
            part for each in fields(value) for part in (each.name.encode(), *_content_bytes(getattr(value, each.name)))
        ]
    return [repr(value).encode()]


def _hash(*parts: bytes) -> str:
    found = hashlib.sha256()
    for part in parts:
        found.update(len(part).to_bytes(8, "little") + part)
    return found.hexdigest()[:_DIGITS]


# Frames

Labels = dict[str, tuple[LabeledObject, ...]]


def scene_frames(renderer: Renderer, scene: Scene, placed: Sequence[PlacedCamera]) -> list[EvaluatedFrame]:
    """Views of a scene with its actors and parked vehicles as ground truth; raises ValueError if it has none."""
    objects = scene_objects(scene)
    if not objects:
        raise ValueError(f"scene {scene.name!r} has no actors to be found; --capture or --truth says what is there")
    frames: list[EvaluatedFrame] = []
    for each in placed:
        truths = ground_truth_from_scene(renderer, scene, objects, each.camera, each.time_s)
        frames.append(EvaluatedFrame(each.name, ego_view(scene, each.camera, each.time_s), truths))
    return frames


def recorded_frames(
    scene: Scene, placed: Sequence[PlacedCamera], capture: Capture, labels: Labels | None = None
) -> list[EvaluatedFrame]:
    """Views of a scene, or of no scene, that a capture has images of, by the names of its views.

    Ground truth is the capture's 3D boxes, or `labels` by the names of views and of their files. Raises ValueError if
    both are missing.
    """
    if labels is None and not (capture.boxes and capture.is_metric):
        raise ValueError(f"{capture.name}: has no 3D boxes of what is to be found; --truth names a COCO file")
    views = {view.name: view for view in capture}
    frames: list[EvaluatedFrame] = []
    for each in placed:
        recorded = views[each.name]
        view = undistort_frame(recorded, each.camera.width)
        if labels is None:
            truths = ground_truth_from_boxes(capture.boxes, view.camera, view.time_s)
        else:
            truths = _labels_of(labels, each.name)
        shot = ego_view(scene, each.camera, each.time_s)
        frames.append(EvaluatedFrame(each.name, shot, truths, lambda view=view: view.image, recorded))
    return frames


def _labels_of(labels: Labels, name: str) -> tuple[LabeledObject, ...]:
    """Labels by a view's name, with or without folder and suffix; empty if the file lacks it."""
    file = name.rpartition("/")[2]
    stem = file.rpartition(".")[0] or file
    for known, truths in labels.items():
        known_stem = known.rpartition("/")[2].rpartition(".")[0] or known
        if name == known or known_stem in (file, stem):  # a view's name may have dots, and no suffix
            return truths
    return ()


def conditions_of(
    intensities_mm_h: tuple[float, ...], seeds: tuple[int, ...], *, originals: bool, scene: bool
) -> list[Condition]:
    """All conditions of a view: without rain first, then each rain rate with each seed."""
    clear = [Condition("original", 0.0, seeds)] if originals else []
    clear += [Condition("clear", 0.0, seeds)] if scene else []
    rainy = [Condition("rainy", rate, (seed,)) for rate in intensities_mm_h if rate > 0 for seed in seeds]
    return clear + rainy
