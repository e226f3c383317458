import math

import numpy as np
import pytest

pytest.importorskip("pycocotools")

from gsrain_engine.evaluation.detection.decoders import intersection_over_union
from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.evaluation.detection.metrics import average_precision

IOUS = np.arange(0.5, 0.96, 0.05)


def _at(x: float, width: float = 40.0, name: str = "car", confidence: float = 1.0) -> Detection:
    return Detection(name, confidence, (x, 0.0, x + width, 40.0))


def test_perfect_and_absent_detections():
    truths = [[_at(0), _at(100)], [_at(50, name="person")]]
    assert average_precision(truths, truths).map == pytest.approx(1)
    nothing = average_precision(truths, [[], []])
    assert (nothing.map, nothing.map50) == (0, 0)
    assert math.isnan(average_precision([[]], [[_at(0)]]).map)


def test_boxes_that_fit_less_count_at_fewer_overlaps():
    result = average_precision([[_at(0)]], [[_at(0, width=32.8, confidence=0.3)]])  # IoU 0.82: up to 0.8, 7 of 10
    assert result.map50 == pytest.approx(1)
    assert result.map == pytest.approx(0.7)


def test_classes_count_alike_and_others_not_at_all():
    truths = [[_at(x) for x in (0, 100, 200)] + [_at(300, name="bus")]]
    seen = [[_at(x) for x in (0, 100, 200)] + [_at(300, name="dog"), _at(400, name="dog")]]
    result = average_precision(truths, seen)
    assert result.map == pytest.approx(0.5)
    assert result.map50 == pytest.approx(0.5)


def test_vehicles_are_found_by_any_of_their_kinds_and_each_detection_counts_once():
    truths = [[_at(0, name="vehicle"), _at(100, name="vehicle"), _at(200)]]
    seen = [[_at(0, name="truck"), _at(100), _at(200)]]
    assert average_precision(truths, seen).map50 == pytest.approx(1)
    astray = [[*seen[0], _at(400, confidence=2.0)]]  # a car where nothing is: wrong among the cars alone
    assert average_precision(truths, astray).map50 == pytest.approx((1 + 0.5) / 2)


def test_pictures_must_go_together():
    with pytest.raises(ValueError, match="labels of 2 pictures and detections of 1"):
        average_precision([[], []], [[]])


def _slow(truths: list[list[Detection]], seen: list[list[Detection]], name: str, least_iou: float) -> float:
    """Interpolated average precision at 101 recalls, written down from its definition."""
    order = sorted(
        ((each, image) for image, boxes in enumerate(seen) for each in boxes if each.class_name == name),
        key=lambda pair: -pair[0].confidence,
    )
    labelled = [[each for each in boxes if each.class_name == name] for boxes in truths]
    taken: set[tuple[int, int]] = set()
    hits: list[bool] = []
    for each, image in order:
        free = [i for i in range(len(labelled[image])) if (image, i) not in taken]
        overlap = {
            i: intersection_over_union(np.array([each.box_xyxy]), np.array([labelled[image][i].box_xyxy]))[0, 0]
            for i in free
        }
        best = max(overlap, key=lambda i: overlap[i], default=None)
        hits.append(best is not None and overlap[best] >= least_iou)
        if hits[-1]:
            taken.add((image, best))
    found = np.cumsum(hits)
    precision, recall = found / np.arange(1, len(hits) + 1), found / sum(map(len, labelled))
    return float(np.mean([max(precision[recall >= r - 1e-12], default=0.0) for r in np.linspace(0, 1, 101)]))


def test_it_is_the_area_under_precision_over_recall():
    generator = np.random.default_rng(8)
    truths: list[list[Detection]] = []
    seen: list[list[Detection]] = []
    for _ in range(12):
        boxes = [
            _at(float(x), name=str(generator.choice(["car", "person"])))
            for x in 80 * np.arange(generator.integers(1, 6))
        ]
        truths.append(boxes)
        seen.append(
            [
                Detection(
                    each.class_name,
                    float(generator.uniform()),
                    tuple(float(v) for v in np.array(each.box_xyxy) + generator.normal(0, 5, 4)),
                )
                for each in boxes
                if generator.uniform() < 0.8
            ]
            + [_at(float(generator.uniform(0, 400)), confidence=float(generator.uniform(0, 0.7)))]
        )
    result = average_precision(truths, seen)
    expected = np.array([[_slow(truths, seen, name, iou) for iou in IOUS] for name in ("car", "person")])
    assert (expected.mean(axis=1) > 0.05).all() and (expected.mean(axis=1) < 0.9).all()
    assert result.map == pytest.approx(expected.mean(), abs=1e-9)
    assert result.map50 == pytest.approx(expected[:, 0].mean(), abs=1e-9)
