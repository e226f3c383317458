"""Detectors over views, rains and seeds: each picture is made once and shown to all of them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8

from .class_names import can_name
from .detector import Detection
from .frames import JudgedFrame
from .matching import LEAST_IOU, Match, matched
from .pictures import Kind, Pictures, Trial
from .suppression import intersection_over_union
from .truth import LabelledObject


@runtime_checkable
class Finder(Protocol):
    """What finds objects in pictures, such as a `Detector`."""

    @property
    def name(self) -> str:
        """What rows call it."""
        ...

    @property
    def classes(self) -> tuple[str, ...]:
        """Words that it has for objects; without any it is taken to know all."""
        ...

    def detect(self, image: UInt8[np.ndarray, "h w 3"]) -> list[Detection]:
        """Find objects in a picture (RGB), the most confident first."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """What one detector made of one picture."""

    detector: str
    trial: Trial
    frame: str
    truths: tuple[LabelledObject, ...]
    """Objects that are large and free enough to be asked for."""
    matches: tuple[Match, ...]
    """One for each of them."""
    detections: tuple[Detection, ...]
    """Without those that found an object which is not asked for."""
    not_named: tuple[LabelledObject, ...] = ()
    """Objects that would be asked for, had the detector a word for them: a sign, for one of COCO's classes."""


@dataclass(frozen=True, slots=True, eq=False)
class JudgedPicture:
    """A picture with what all detectors made of it."""

    frame: JudgedFrame
    trial: Trial
    judgements: Mapping[str, Judgement]
    """By detector."""
    take: Callable[[], UInt8[np.ndarray, "h w 3"]]
    """Makes the picture once: one judged in an earlier run is not made until somebody asks."""

    @property
    def image(self) -> UInt8[np.ndarray, "h w 3"]:
        return self.take()


@runtime_checkable
class Memory(Protocol):
    """What was judged before, such as `Finished`."""

    def known(self, detector: str, frame: JudgedFrame, trial: Trial) -> Judgement | None:
        """The judgement of a picture, if it was made before."""
        ...

    def keep(self, judgement: Judgement, frame: JudgedFrame) -> None:
        """Take note of one."""
        ...


def judged_pictures(
    pictures: Pictures,
    detectors: Sequence[Finder],
    frames: Sequence[JudgedFrame],
    trials: Sequence[Trial],
    memory: Memory | None = None,
) -> Iterator[JudgedPicture]:
    """Make each picture and show it to each detector; view by view, in the order of the trials.

    What the memory knows is not asked for again, and what it does not know it is told.
    """
    for frame in frames:
        for trial in trials:
            take = cache(partial(pictures.take, frame, trial))
            judgements: dict[str, Judgement] = {}
            for each in detectors:
                judgement = None if memory is None else memory.known(each.name, frame, trial)
                if judgement is None:
                    judgement = judged(each.name, frame, trial, each.detect(take()), each.classes)
                    if memory is not None:
                        memory.keep(judgement, frame)
                judgements[each.name] = judgement
            yield JudgedPicture(frame, trial, judgements, take)


def judged(
    detector: str, frame: JudgedFrame, trial: Trial, detections: Sequence[Detection], classes: tuple[str, ...] = ()
) -> Judgement:
    """Match detections with the objects of a view; `classes` are those that the detector can name, if it tells.

    Objects that are not asked for take part in the matching, so that who finds them is not wrong: those too small or
    too hidden, and those of classes that the detector has no word for.
    """
    counted = tuple(each for each in frame.truths if each.counts)
    truths = tuple(each for each in counted if can_name(classes, each.class_name))
    matches = tuple(matched(truths, detections))
    others = [each for each in frame.truths if each not in truths]
    fair = tuple(detections)
    if others and detections:
        fair = _without_finds(detections, truths, others)
    not_named = tuple(each for each in counted if each not in truths)
    return Judgement(detector, trial, frame.name, truths, matches, fair, not_named)


@dataclass(frozen=True, slots=True)
class Row:
    """One object in one picture, as one detector saw it: a line of the tables."""

    detector: str
    picture: Kind
    intensity_mm_h: float
    seed: int
    frame: str
    object: str
    class_name: str
    confidence: float
    """Of the detection of its own class with an IoU of 0.5 or more; 0 where it was missed."""
    iou: float
    """Of that detection; 0 where it was missed."""
    confidence_any_class: float
    iou_any_class: float
    class_seen: str | None
    """What it was taken for; None where nothing was found there."""
    visibility: float
    distance_m: float | None
    height_px: float

    def plain(self) -> dict[str, Any]:
        """Return its fields by the names of the tables."""
        fields = {name: getattr(self, name) for name in Row.__slots__}
        return {("class" if name == "class_name" else name): value for name, value in fields.items()}


def rows_of(judgement: Judgement) -> Iterator[Row]:
    """Lines of a picture: one for each object and each seed, so that seeds pair across intensities, 0 mm/h too."""
    trial = judgement.trial
    for seed in trial.seeds:
        for truth, match in zip(judgement.truths, judgement.matches, strict=True):
            yield Row(
                judgement.detector, trial.kind, trial.intensity_mm_h, seed, judgement.frame, truth.id, truth.class_name,
                match.confidence, match.iou, match.confidence_any_class, match.iou_any_class, match.class_seen,
                truth.visibility, truth.distance_m, truth.height_px,
            )  # fmt: skip


def _without_finds(
    detections: Sequence[Detection], truths: Sequence[LabelledObject], others: Sequence[LabelledObject]
) -> tuple[Detection, ...]:
    """Leave out detections that lie on an object that is not asked for, and better on it than on any that is."""
    boxes = np.array([each.box_xyxy for each in detections], np.float64)
    there = intersection_over_union(_boxes(others), boxes).max(axis=0)
    asked = intersection_over_union(_boxes(truths), boxes).max(axis=0) if truths else np.zeros(len(boxes))
    return tuple(each for each, o, a in zip(detections, there, asked, strict=True) if not (o >= LEAST_IOU and o > a))


def _boxes(objects: Sequence[LabelledObject]) -> np.ndarray:
    return np.array([each.box_xyxy for each in objects], np.float64).reshape(-1, 4)
