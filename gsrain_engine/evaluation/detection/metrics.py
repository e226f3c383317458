"""Average precision of detections, as COCO defines it."""

import contextlib
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float64

from ..image_metrics import wilson_interval
from .decoders import intersection_over_union
from .detector import Detection
from .ground_truth import is_same_class, label_class

_ABSENT = -1
"""What the COCO evaluation gives for a class without labelled objects."""


@dataclass(frozen=True, slots=True)
class ClassPrecision:
    """Average precision of one class."""

    objects: int
    """Labelled ones, in all pictures."""
    map: float
    map50: float


@dataclass(frozen=True, slots=True)
class AveragePrecision:
    """Area under the curve of precision over recall, 0..1, averaged over the classes that objects are labelled with.

    Precision interpolated at 101 recalls, boxes of all sizes, at most 100 detections a picture (Lin et al. 2014; the
    evaluation of COCO 2017, by pycocotools). NaN where nothing is labelled.
    """

    map: float
    """Averaged over the IoU that counts as found: 0.5, 0.55, ... 0.95."""
    map50: float
    """With an IoU of 0.5 (PASCAL VOC's criterion)."""
    by_class: dict[str, ClassPrecision]
    """Of classes with labelled objects, by name."""


# § Which detection found which labelled object, and what a detector took it for.


@runtime_checkable
class LabeledBox(Protocol):
    """A labelled object: what it is and where it lies in the picture."""

    @property
    def class_name(self) -> str:
        """Its class; `is_same_class` tells which words of a detector are right for it."""
        ...

    @property
    def box_xyxy(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom in pixels."""
        ...


def average_precision(
    truths: Sequence[Sequence[LabeledBox]],
    detections: Sequence[Sequence[Detection]],
    ignored: Sequence[Sequence[LabeledBox]] | None = None,
) -> AveragePrecision:
    """Average precision over pictures: labelled objects and detections of each, in the same order.

    The area below precision over recall, at 101 recalls, mean over classes; mAP50 with matches from an IoU of 0.5 on,
    mAP the mean over 0.50, 0.55, ... 0.95 (Lin et al. 2014 and COCO's own program). 0 to 1, higher is better.
    A detection counts for the class that its word names (`is_same_class`); where it names several that are labelled, as
    car does a vehicle of unknown kind too, for that of the object which it lies on, and on none for its own.
    Detections of classes that nothing is labelled with do not count, neither for nor against; nor do those that lie
    in `ignored` objects of their class, which nobody has to find (COCO's crowds). Raises ValueError where the numbers
    of pictures differ, ModuleNotFoundError with what to install where pycocotools is missing.
    """
    ignored = [()] * len(truths) if ignored is None else ignored
    if not len(truths) == len(detections) == len(ignored):
        raise ValueError(f"labels of {len(truths)} pictures and detections of {len(detections)}; there must be as many")
    classes = sorted({each.class_name for picture in truths for each in picture})
    if not classes:
        return AveragePrecision(math.nan, math.nan, {})
    precision = _precision(truths, detections, ignored, classes)
    by_class: dict[str, ClassPrecision] = {}
    for number, name in enumerate(classes):
        objects = sum(each.class_name == name for picture in truths for each in picture)
        by_class[name] = ClassPrecision(objects, _mean(precision[:, :, number]), _mean(precision[0, :, number]))
    values = by_class.values()
    return AveragePrecision(
        float(np.mean([each.map for each in values])), float(np.mean([each.map50 for each in values])), by_class
    )


def _precision(
    truths: Sequence[Sequence[LabeledBox]],
    detections: Sequence[Sequence[Detection]],
    ignored: Sequence[Sequence[LabeledBox]],
    classes: Sequence[str],
) -> Any:
    """Precision by IoU (10), recall (101) and class."""
    try:
        from pycocotools.coco import COCO
        from pycocotools.cocoeval import COCOeval
    except ModuleNotFoundError:
        raise ModuleNotFoundError("average precision needs pycocotools: pip install 'gsrain[evaluate]'") from None
    numbers = {name: number for number, name in enumerate(classes, start=1)}
    labels = [
        *(_entry(image, box, numbers) for image, boxes in enumerate(truths) for box in boxes),
        *(_entry(image, box, numbers) | {"iscrowd": 1} for image, boxes in enumerate(ignored) for box in boxes),
    ]
    scored = [
        _entry(image, box, numbers, named) | {"score": box.confidence}
        for image, (boxes, there) in enumerate(zip(detections, truths, strict=True))
        for box, named in zip(boxes, _named(boxes, there, classes), strict=True)
    ]
    with contextlib.redirect_stdout(io.StringIO()):  # it prints its progress
        evaluation = COCOeval(
            _indexed(COCO(), labels, numbers, len(truths)), _indexed(COCO(), scored, numbers, len(truths)), "bbox"
        )
        evaluation.evaluate()
        evaluation.accumulate()
    return evaluation.eval["precision"][:, :, :, 0, -1]


def _named(detections: Sequence[Detection], truths: Sequence[LabeledBox], classes: Sequence[str]) -> list[str | None]:
    """Return the labelled class that each detection counts for; None for no class."""
    found: list[str | None] = []
    for each in detections:
        candidates = [name for name in classes if is_same_class(each.class_name, name)]
        if len(candidates) > 1:
            own = [truth for truth in truths if truth.class_name in candidates]
            overlaps = intersection_over_union(_boxes(own), _boxes([each]))[:, 0] if own else np.zeros(1)
            best = int(np.argmax(overlaps))
            exact = [name for name in candidates if name == label_class(each.class_name)]
            candidates = [own[best].class_name] if overlaps[best] >= MIN_IOU else exact or candidates
        found.append(candidates[0] if candidates else None)
    return found


def _boxes(objects: Sequence[LabeledBox]) -> np.ndarray:
    return np.array([each.box_xyxy for each in objects], np.float64).reshape(-1, 4)


def _entry(image: int, box: LabeledBox, numbers: dict[str, int], named: str | None = "") -> dict[str, Any]:
    """A box in COCO's words: corner and size; 0 is the category of classes that do not count.

    `named` is the class that it counts for where it is not its own.
    """
    left, top, right, bottom = box.box_xyxy
    width, height = right - left, bottom - top
    return {
        "image_id": image + 1,
        "category_id": numbers.get(box.class_name if named == "" else named or "", 0),
        "bbox": [left, top, width, height],
        "area": width * height,
        "iscrowd": 0,
    }


def _indexed(coco: Any, entries: list[dict[str, Any]], numbers: dict[str, int], images: int) -> Any:
    """A data set of COCO without a file. Entries are numbered from 1: it takes 0 for none."""
    counted = [entry for entry in entries if entry["category_id"]]
    coco.dataset = {
        "images": [{"id": image + 1} for image in range(images)],
        "annotations": [entry | {"id": number} for number, entry in enumerate(counted, start=1)],
        "categories": [{"id": number, "name": name} for name, number in numbers.items()],
    }
    coco.createIndex()
    return coco


def _mean(precision: Any) -> float:
    return float(np.mean(precision[precision != _ABSENT]))


MIN_IOU = 0.5


@dataclass(frozen=True, slots=True)
class ObjectMatch:
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


def match_detections(
    truths: Sequence[LabeledBox], detections: Sequence[Detection], least_iou: float = MIN_IOU
) -> list[ObjectMatch]:
    """For every labelled object the detection that found it.

    Detections choose in order of confidence, each the free object it overlaps most, by an IoU of at least `least_iou`
    (PASCAL VOC's criterion, Everingham et al. 2010, with COCO's greedy choice, Lin et al. 2014): no detection counts
    for two objects. Of any class: objects of the detection's own class first, then others.
    """
    order = sorted(detections, key=lambda each: -each.confidence)
    overlaps = intersection_over_union(
        _image_boxes([each.box_xyxy for each in truths]), _image_boxes([each.box_xyxy for each in order])
    )
    same = np.array([[is_same_class(each.class_name, truth.class_name) for each in order] for truth in truths], bool)
    same = same.reshape(overlaps.shape)
    own = _greedy([np.where(same, overlaps, 0.0)], least_iou)
    anything = _greedy([np.where(same, overlaps, 0.0), overlaps], least_iou)
    matches: list[ObjectMatch] = []
    for row, truth in enumerate(truths):
        mine, seen = own.get(row), anything.get(row)
        class_seen = None if seen is None else order[seen].class_name
        matches.append(
            ObjectMatch(
                confidence=0.0 if mine is None else order[mine].confidence,
                iou=0.0 if mine is None else float(overlaps[row, mine]),
                confidence_any_class=0.0 if seen is None else order[seen].confidence,
                iou_any_class=0.0 if seen is None else float(overlaps[row, seen]),
                class_seen=class_seen,
                flipped_to=None if class_seen is None or is_same_class(class_seen, truth.class_name) else class_seen,
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


def _image_boxes(rows: Sequence[tuple[float, float, float, float]]) -> Float64[np.ndarray, "n 4"]:
    return np.array(rows, np.float64).reshape(-1, 4)


# § How many labelled objects are found, by their distance.


@dataclass(frozen=True, slots=True)
class DistanceRecall:
    """Recall of objects between two distances."""

    from_m: float
    to_m: float
    objects: int
    found: int

    @property
    def recall(self) -> float:
        """Share that was found, 0..1; NaN without objects."""
        return self.found / self.objects if self.objects else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the recall (Wilson 1927); 0..1 without objects.

        Holds for objects seen independently: frames of one drive are not, it is then too narrow.
        """
        return wilson_interval(self.found, self.objects)


def recall_by_distance(
    distances_m: Float[np.ndarray, " n"],
    confidences: Float[np.ndarray, " n"],
    edges_m: Sequence[float],
    least_confidence: float = 0.25,
) -> tuple[DistanceRecall, ...]:
    """Recall between neighbouring `edges_m` (the nearer one belongs to a bin, the farther does not).

    The share of labelled objects that were found, 0 to 1, higher is better; with Wilson's interval (1927).
    An object is found where the confidence of its match (`ObjectMatch.confidence`, 0 where missed) is at least
    `least_confidence`. Objects outside the edges do not count. Raises ValueError for edges that do not rise.
    """
    edges = np.asarray(edges_m, float)
    if len(edges) < 2 or not (np.diff(edges) > 0).all():
        raise ValueError(
            f"distances between which recall is taken must rise, not {', '.join(f'{e:g}' for e in edges)} m"
        )
    found = (confidences >= least_confidence) & (confidences > 0)
    bins: list[DistanceRecall] = []
    for near, far in pairwise(edges):
        inside = (distances_m >= near) & (distances_m < far)
        bins.append(DistanceRecall(float(near), float(far), int(inside.sum()), int((inside & found).sum())))
    return tuple(bins)


# § How much of a detector's performance is left in rain.


@dataclass(frozen=True, slots=True)
class Robustness:
    """Performance under corruption (Michaelis et al. 2019, equations 1 and 2), rain being the one corruption."""

    mpc: float
    """Mean performance over the intensities, in the unit of the performance (mAP: 0..1)."""
    rpc: float
    """That over the performance without rain: 1 where rain does no harm; NaN where nothing was found without it."""


def robustness(clear: float, rainy: Sequence[float]) -> Robustness:
    """Compare one measure of performance without rain with its values in rain, one each intensity: mPC and rPC.

    mPC is the mean in rain, in the measure's own unit; rPC is mPC over the value without rain: 1 where rain costs
    nothing, 0 where nothing is left (Michaelis et al. 2019, eq. 1 and 2).
    Intensities count alike, as severities do there. Raises ValueError without an intensity.
    """
    if not rainy:
        raise ValueError("performance under rain needs at least one intensity above 0 mm/h")
    mean = float(np.mean(rainy))
    return Robustness(mean, mean / clear if clear > 0 else float("nan"))
