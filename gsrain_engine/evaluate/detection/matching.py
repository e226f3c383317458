"""Which detection found which labelled object, and what a detector took it for."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from .class_names import names_class
from .detector import Detection
from .suppression import intersection_over_union

LEAST_IOU = 0.5


@runtime_checkable
class Boxed(Protocol):
    """A labelled object: what it is and where it lies in the picture."""

    @property
    def class_name(self) -> str:
        """Its class; `names_class` tells which words of a detector are right for it."""
        ...

    @property
    def box_xyxy(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom in pixels."""
        ...


@dataclass(frozen=True, slots=True)
class Match:
    """How a detector saw one labelled object."""

    confidence: float
    """0..1, of the detection of its own class; 0 where it was missed."""
    iou: float
    """0..1, with that detection; 0 where it was missed."""
    confidence_any_class: float
    """0..1, of the detection of whatever class; 0 where nothing was found there. At least `confidence`."""
    iou_any_class: float
    class_seen: str | None
    """Class of that detection; None where nothing was found there."""
    flipped_to: str | None
    """`class_seen` where that is no word for the object; else None."""


def matched(truths: Sequence[Boxed], detections: Sequence[Detection], least_iou: float = LEAST_IOU) -> list[Match]:
    """For every labelled object the detection that found it.

    Detections choose in order of confidence, each the free object it overlaps most, by an IoU of at least `least_iou`
    (PASCAL VOC's criterion, Everingham et al. 2010, with COCO's greedy choice, Lin et al. 2014): no detection counts
    for two objects. Of any class: objects of the detection's own class first, then others.
    """
    order = sorted(detections, key=lambda each: -each.confidence)
    overlaps = intersection_over_union(
        _boxes([each.box_xyxy for each in truths]), _boxes([each.box_xyxy for each in order])
    )
    same = np.array([[names_class(each.class_name, truth.class_name) for each in order] for truth in truths], bool)
    same = same.reshape(overlaps.shape)
    own = _greedy([np.where(same, overlaps, 0.0)], least_iou)
    anything = _greedy([np.where(same, overlaps, 0.0), overlaps], least_iou)
    matches: list[Match] = []
    for row, truth in enumerate(truths):
        mine, seen = own.get(row), anything.get(row)
        class_seen = None if seen is None else order[seen].class_name
        matches.append(
            Match(
                confidence=0.0 if mine is None else order[mine].confidence,
                iou=0.0 if mine is None else float(overlaps[row, mine]),
                confidence_any_class=0.0 if seen is None else order[seen].confidence,
                iou_any_class=0.0 if seen is None else float(overlaps[row, seen]),
                class_seen=class_seen,
                flipped_to=None if class_seen is None or names_class(class_seen, truth.class_name) else class_seen,
            )
        )
    return matches


def _greedy(choices: Sequence[Float64[np.ndarray, "t d"]], least_iou: float) -> dict[int, int]:
    """Detection of each row that was chosen; a column looks into the first table with something for it."""
    taken: dict[int, int] = {}
    for column in range(choices[0].shape[1]):
        for table in choices:
            free = [row for row in range(len(table)) if row not in taken and table[row, column] >= least_iou]
            if free:
                taken[max(free, key=lambda row: table[row, column])] = column
                break
    return taken


def _boxes(rows: Sequence[tuple[float, float, float, float]]) -> Float64[np.ndarray, "n 4"]:
    return np.array(rows, np.float64).reshape(-1, 4)
