"""Detection metrics: COCO average precision, object matches, recall by distance, and robustness to rain."""

import contextlib
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float64

from ...optional_packages import require_package
from ...report.interval import Interval
from .decoders import intersection_over_union
from .detector import Detection
from .ground_truth import is_same_class, label_class


@dataclass(frozen=True, slots=True)
class AveragePrecision:
    """Area under the precision-recall curve, 0..1, averaged over the labeled classes.

    Precision interpolated at 101 recalls, boxes of all sizes, at most 100 detections per image (Lin et al. 2014; the
    evaluation of COCO 2017, by pycocotools). NaN without labels.
    """

    map: float
    """Averaged over the IoU thresholds 0.5, 0.55, ... 0.95."""
    map50: float
    """At an IoU threshold of 0.5 (PASCAL VOC's criterion)."""


# Labeled boxes


@runtime_checkable
class LabeledBox(Protocol):
    """A labeled object: its class, and its box (left, top, right, bottom in pixels)."""

    @property
    def class_name(self) -> str: ...

    @property
    def box_xyxy(self) -> tuple[float, float, float, float]: ...


def average_precision(
    truths: Sequence[Sequence[LabeledBox]], detections: Sequence[Sequence[Detection]]
) -> AveragePrecision:
    """Average precision over images, given labeled objects and detections of each in the same order.

    The area below precision over recall, at 101 recalls, mean over classes; mAP50 with matches from an IoU of 0.5, mAP
    the mean over 0.50, 0.55, ... 0.95 (Lin et al. 2014 and COCO's own program). 0 to 1, higher is better. A detection
    counts for the labeled class that matches it (`is_same_class`). If several match, as for a car and a vehicle of
    unknown kind, it counts for the class of the object it overlaps, otherwise for its own class. Detections without a
    matching labeled class are ignored. Raises ValueError if the numbers of images differ, MissingPackageError with the
    package to install if pycocotools is missing.
    """
    if len(truths) != len(detections):
        raise ValueError(f"labels of {len(truths)} pictures and detections of {len(detections)}; there must be as many")
    classes = sorted({each.class_name for picture in truths for each in picture})
    if not classes:
        return AveragePrecision(math.nan, math.nan)
    precision = _precision(truths, detections, classes)
    known = [precision[:, :, number] for number in range(len(classes))]
    by_class = [[float(np.mean(part[part != -1])) for part in (each, each[0])] for each in known]  # -1: no objects
    return AveragePrecision(*(float(np.mean(values)) for values in zip(*by_class, strict=True)))


def _precision(
    truths: Sequence[Sequence[LabeledBox]], detections: Sequence[Sequence[Detection]], classes: Sequence[str]
) -> Any:
    """Precision by IoU (10), recall (101) and class."""
    require_package("pycocotools", "average precision")
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    numbers = {name: number for number, name in enumerate(classes, start=1)}
    labels = [_entry(image, box, numbers[box.class_name]) for image, boxes in enumerate(truths) for box in boxes]
    scored = [
        _entry(image, box, numbers[name]) | {"score": box.confidence}
        for image, (boxes, there) in enumerate(zip(detections, truths, strict=True))
        for box, name in zip(boxes, _labeled_classes(boxes, there, classes), strict=True)
        if name is not None
    ]
    with contextlib.redirect_stdout(io.StringIO()):  # pycocotools prints its progress
        evaluation = COCOeval(
            _indexed(COCO(), labels, numbers, len(truths)), _indexed(COCO(), scored, numbers, len(truths)), "bbox"
        )
        evaluation.evaluate()
        evaluation.accumulate()
    return evaluation.eval["precision"][:, :, :, 0, -1]


def _labeled_classes(
    detections: Sequence[Detection], truths: Sequence[LabeledBox], classes: Sequence[str]
) -> list[str | None]:
    """Return the labeled class that each detection counts for; None for no class."""
    found: list[str | None] = []
    for each in detections:
        candidates = [name for name in classes if is_same_class(each.class_name, name)]
        if len(candidates) > 1:
            own = [truth for truth in truths if truth.class_name in candidates]
            overlaps = intersection_over_union(box_rows(own), box_rows([each]))[:, 0] if own else np.zeros(1)
            best = int(np.argmax(overlaps))
            exact = [name for name in candidates if name == label_class(each.class_name)]
            candidates = [own[best].class_name] if overlaps[best] >= MIN_IOU else exact or candidates
        found.append(candidates[0] if candidates else None)
    return found


def box_rows(objects: Sequence[LabeledBox]) -> Float64[np.ndarray, "n 4"]:
    """Boxes as rows of left, top, right, bottom."""
    return np.array([each.box_xyxy for each in objects], np.float64).reshape(-1, 4)


def _entry(image: int, box: LabeledBox, category: int) -> dict[str, Any]:
    """A box in COCO's format: corner and size."""
    left, top, right, bottom = box.box_xyxy
    width, height = right - left, bottom - top
    corner_and_size = [left, top, width, height]
    return {
        "image_id": image + 1, "category_id": category, "bbox": corner_and_size, "area": width * height, "iscrowd": 0,
    }  # fmt: skip


def _indexed(coco: Any, entries: list[dict[str, Any]], numbers: dict[str, int], images: int) -> Any:
    """An in-memory COCO dataset. Entries are numbered from 1, since COCO uses 0 for none."""
    coco.dataset = {
        "images": [{"id": image + 1} for image in range(images)],
        "annotations": [entry | {"id": number} for number, entry in enumerate(entries, start=1)],
        "categories": [{"id": number, "name": name} for name, number in numbers.items()],
    }
    coco.createIndex()
    return coco


MIN_IOU = 0.5


@dataclass(frozen=True, slots=True)
class ObjectMatch:
    """Match of a detector with one labeled object."""

    confidence: float
    """0..1, of the detection with the right class; 0 if missed."""
    iou: float
    """0..1, with that detection; 0 if missed."""
    confidence_any_class: float
    """0..1, of the detection with any class; 0 without a detection. At least `confidence`."""
    iou_any_class: float
    class_seen: str | None
    """Class of that detection; None without a detection."""
    flipped_to: str | None
    """`class_seen` if it does not match the object; else None."""


def match_detections(truths: Sequence[LabeledBox], detections: Sequence[Detection]) -> list[ObjectMatch]:
    """Match each labeled object with a detection.

    In order of confidence, each detection takes the free object that it overlaps most, with an IoU of at least
    `MIN_IOU` (PASCAL VOC's criterion, Everingham et al. 2010, with COCO's greedy choice, Lin et al. 2014): no detection
    counts for two objects. Matches of any class prefer objects of the detection's own class.
    """
    order = sorted(detections, key=lambda each: -each.confidence)
    overlaps = intersection_over_union(box_rows(truths), box_rows(order))
    same = np.array([[is_same_class(each.class_name, truth.class_name) for each in order] for truth in truths], bool)
    of_class = np.where(same.reshape(overlaps.shape), overlaps, 0.0)
    own, anything = _greedy([of_class]), _greedy([of_class, overlaps])
    matches: list[ObjectMatch] = []
    for row, truth in enumerate(truths):
        confidence, iou, _ = _match(own.get(row), order, overlaps[row])
        confidence_any, iou_any, name = _match(anything.get(row), order, overlaps[row])
        flipped_to = None if name is None or is_same_class(name, truth.class_name) else name
        matches.append(ObjectMatch(confidence, iou, confidence_any, iou_any, name, flipped_to))
    return matches


def _match(
    column: int | None, detections: Sequence[Detection], overlaps: Float64[np.ndarray, " d"]
) -> tuple[float, float, str | None]:
    """Confidence, IoU and class of a detection; zeros without one."""
    if column is None:
        return 0.0, 0.0, None
    return detections[column].confidence, float(overlaps[column]), detections[column].class_name


def _greedy(choices: Sequence[Float64[np.ndarray, "t d"]]) -> dict[int, int]:
    """Greedily assign each column to its best free row, in the first table with a match; returns columns by row."""
    matched: dict[int, int] = {}
    for column in range(choices[0].shape[1]):
        for table in choices:
            free = [row for row in range(len(table)) if row not in matched and table[row, column] >= MIN_IOU]
            if free:
                matched[max(free, key=lambda row: table[row, column])] = column
                break
    return matched


# Recall by distance


@dataclass(frozen=True, slots=True)
class DistanceRecall:
    """Recall of objects between two distances."""

    from_m: float
    to_m: float
    objects: int
    found: int

    @property
    def recall(self) -> float:
        """Share of found objects, 0..1; NaN without objects."""
        return self.found / self.objects if self.objects else float("nan")

    @property
    def interval(self) -> Interval:
        """Recall with its interval (Wilson 1927), 0..1 without objects; too narrow for frames of one drive."""
        return Interval.wilson(self.found, self.objects, "sightings")


def recall_by_distance(
    distances_m: Float[np.ndarray, " n"],
    confidences: Float[np.ndarray, " n"],
    edges_m: Sequence[float],
    min_confidence: float = 0.25,
) -> tuple[DistanceRecall, ...]:
    """Recall between neighboring `edges_m` (a bin includes its nearer edge, not its farther one).

    The share of labeled objects that were found, 0 to 1, higher is better; with Wilson's interval (1927). An object is
    found if the confidence of its match (`ObjectMatch.confidence`, 0 if missed) is at least `min_confidence`. Objects
    outside the edges do not count. Raises ValueError for edges that do not increase.
    """
    edges = np.asarray(edges_m, float)
    if len(edges) < 2 or not (np.diff(edges) > 0).all():
        raise ValueError(
            f"distances between which recall is taken must rise, not {', '.join(f'{e:g}' for e in edges)} m"
        )
    found = (confidences >= min_confidence) & (confidences > 0)
    bins: list[DistanceRecall] = []
    for near, far in pairwise(edges):
        inside = (distances_m >= near) & (distances_m < far)
        bins.append(DistanceRecall(float(near), float(far), int(inside.sum()), int((inside & found).sum())))
    return tuple(bins)


# Robustness to rain


@dataclass(frozen=True, slots=True)
class Robustness:
    """Performance under corruption (Michaelis et al. 2019, equations 1 and 2), with rain as the only corruption."""

    mpc: float
    """Mean performance over the rain rates, in the unit of the performance (mAP: 0..1)."""
    rpc: float
    """`mpc` over the performance without rain: 1 if rain has no effect; NaN if that performance is 0."""


def robustness(clear: float, rainy: Sequence[float]) -> Robustness:
    """Compute mPC and rPC from a metric without rain and its values in rain, one per rain rate.

    mPC is the mean in rain, in the metric's own unit; rPC is mPC over the value without rain: 1 for no loss, 0 for a
    total loss (Michaelis et al. 2019, eq. 1 and 2). Rain rates have equal weights, like severities there. Raises
    ValueError without a rain rate.
    """
    if not rainy:
        raise ValueError("performance under rain needs at least one intensity above 0 mm/h")
    mean = float(np.mean(rainy))
    return Robustness(mean, mean / clear if clear > 0 else float("nan"))
