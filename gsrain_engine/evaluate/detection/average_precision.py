"""Average precision of detections, as COCO defines it."""

import contextlib
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .class_names import label_class, names_class
from .detector import Detection
from .matching import LEAST_IOU, Boxed
from .suppression import intersection_over_union

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


def average_precision(
    truths: Sequence[Sequence[Boxed]],
    detections: Sequence[Sequence[Detection]],
    ignored: Sequence[Sequence[Boxed]] | None = None,
) -> AveragePrecision:
    """Average precision over pictures: labelled objects and detections of each, in the same order.

    The area below precision over recall, at 101 recalls, mean over classes; mAP50 with matches from an IoU of 0.5 on,
    mAP the mean over 0.50, 0.55, ... 0.95 (Lin et al. 2014 and COCO's own program). 0 to 1, higher is better.
    A detection counts for the class that its word names (`names_class`); where it names several that are labelled, as
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
    truths: Sequence[Sequence[Boxed]],
    detections: Sequence[Sequence[Detection]],
    ignored: Sequence[Sequence[Boxed]],
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


def _named(detections: Sequence[Detection], truths: Sequence[Boxed], classes: Sequence[str]) -> list[str | None]:
    """Return the labelled class that each detection counts for; None for no class."""
    found: list[str | None] = []
    for each in detections:
        candidates = [name for name in classes if names_class(each.class_name, name)]
        if len(candidates) > 1:
            own = [truth for truth in truths if truth.class_name in candidates]
            overlaps = intersection_over_union(_boxes(own), _boxes([each]))[:, 0] if own else np.zeros(1)
            best = int(np.argmax(overlaps))
            exact = [name for name in candidates if name == label_class(each.class_name)]
            candidates = [own[best].class_name] if overlaps[best] >= LEAST_IOU else exact or candidates
        found.append(candidates[0] if candidates else None)
    return found


def _boxes(objects: Sequence[Boxed]) -> np.ndarray:
    return np.array([each.box_xyxy for each in objects], np.float64).reshape(-1, 4)


def _entry(image: int, box: Boxed, numbers: dict[str, int], named: str | None = "") -> dict[str, Any]:
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
