"""Average precision, matches, recall by distance and robustness, against their definitions."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pycocotools")

from gsrain_engine.evaluation.detection.decoders import intersection_over_union
from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.evaluation.detection.metrics import (
    LabeledBox,
    average_precision,
    match_detections,
    recall_by_distance,
    robustness,
)


def at(x: float, width: float = 40.0, name: str = "car", confidence: float = 1.0) -> Detection:
    """A detection, or what it detects: anything with a class and a box can be labeled."""
    return Detection(name, confidence, (x, 0.0, x + width, 40.0))


ROW = [at(x) for x in (0, 100, 200)]
VEHICLES = [at(0, name="vehicle"), at(100, name="vehicle"), at(200)]
FOUND, BUS = [at(0, name="truck"), at(100), at(200)], at(300, name="bus")


@pytest.mark.parametrize(
    ("truths", "found", "map_", "map50"),
    [
        ([[at(0), at(100)], [at(50, name="person")]], [[at(0), at(100)], [at(50, name="person")]], 1, 1),
        ([[at(0)]], [[]], 0, 0),
        ([[]], [[at(0)]], math.nan, math.nan),
        ([[at(0)]], [[at(0, width=32.8, confidence=0.3)]], 0.7, 1),  # IoU 0.82: up to 0.8, 7 of 10
        ([[*ROW, at(300, name="bus")]], [[*ROW, at(300, name="dog"), at(400, name="dog")]], 0.5, 0.5),
        ([VEHICLES], [FOUND], 1, 1),  # a vehicle is any of its kinds, and each detection counts once
        ([VEHICLES], [[*FOUND, at(400, confidence=2.0)]], None, (1 + 0.5) / 2),  # wrong among the cars alone
        (
            [[*VEHICLES[:2], BUS]],
            [[*VEHICLES[:2], BUS, at(400, name="vehicle", confidence=2.0)]],
            None,
            (1 + 2 / 3) / 2,
        ),
    ],
)
def test_average_precision_of_known_cases(truths, found, map_, map50):
    result = average_precision(truths, found)
    assert isinstance(ROW[0], LabeledBox)
    assert result.map50 == pytest.approx(map50, nan_ok=True)
    assert map_ is None or result.map == pytest.approx(map_, nan_ok=True)


def slow_precision(truths: list[list[Detection]], found: list[list[Detection]], name: str, min_iou: float) -> float:
    """Interpolated average precision at 101 recalls, written down from its definition."""
    order = sorted(
        ((each, image) for image, boxes in enumerate(found) for each in boxes if each.class_name == name),
        key=lambda pair: -pair[0].confidence,
    )
    labels = [[each for each in boxes if each.class_name == name] for boxes in truths]
    matched: set[tuple[int, int]] = set()
    hits: list[bool] = []
    for each, image in order:
        overlap = {
            i: intersection_over_union(np.array([each.box_xyxy]), np.array([label.box_xyxy]))[0, 0]
            for i, label in enumerate(labels[image])
            if (image, i) not in matched
        }
        best = max(overlap, key=lambda i: overlap[i], default=None)
        hits.append(best is not None and overlap[best] >= min_iou)
        if hits[-1]:
            matched.add((image, best))
    count = np.cumsum(hits)
    precision, recall = count / np.arange(1, len(hits) + 1), count / sum(map(len, labels))
    return float(np.mean([max(precision[recall >= r - 1e-12], default=0.0) for r in np.linspace(0, 1, 101)]))


def test_it_is_the_area_under_precision_over_recall():
    generator = np.random.default_rng(8)
    truths = [
        [at(float(x), name=str(generator.choice(["car", "person"]))) for x in 80 * np.arange(generator.integers(1, 6))]
        for _ in range(12)
    ]
    found = [
        [
            Detection(each.class_name, float(generator.uniform()), tuple(each.box_xyxy + generator.normal(0, 5, 4)))
            for each in boxes
            if generator.uniform() < 0.8
        ]
        + [at(float(generator.uniform(0, 400)), confidence=float(generator.uniform(0, 0.7)))]
        for boxes in truths
    ]
    result = average_precision(truths, found)
    ious = np.arange(0.5, 0.96, 0.05)
    expected = np.array([[slow_precision(truths, found, name, iou) for iou in ious] for name in ("car", "person")])
    assert (expected.mean(axis=1) > 0.05).all() and (expected.mean(axis=1) < 0.9).all()
    assert result.map == pytest.approx(expected.mean(), abs=1e-9)
    assert result.map50 == pytest.approx(expected[:, 0].mean(), abs=1e-9)
    with pytest.raises(ValueError, match="12 pictures and detections of 1"):
        average_precision(truths, found[:1])


# Matches

CAR, NEXT_TO_IT = (0.0, 0.0, 100.0, 100.0), (20.0, 0.0, 120.0, 100.0)


def label(box, name="car"):
    return Detection(name, 1.0, box)


@pytest.mark.parametrize(
    ("labels", "found", "confidences", "ious"),
    [
        ([label(CAR)], [Detection("car", 0.9, (0, 0, 49.9, 100))], [0], [0]),
        ([label(CAR)], [Detection("car", 0.9, (0, 0, 50, 100))], [0.9], [0.5]),  # half of an object is enough
        ([], [Detection("car", 0.9, CAR)], [], []),
        ([label(CAR), label(NEXT_TO_IT)], [Detection("car", 0.9, (15, 0, 115, 100))], [0, 0.9], [0, 95 / 105]),
        ([label(CAR), label(NEXT_TO_IT)],
         [Detection("car", 0.9, (15, 0, 115, 100)), Detection("car", 0.4, (10, 0, 110, 100))],
         [0.4, 0.9], [90 / 110, 95 / 105]),
        # It overlaps the car more, and is a person.
        ([label(CAR), label((0.0, 0.0, 100.0, 60.0), "person")], [Detection("person", 0.9, (0, 0, 100, 85))],
         [0, 0.9], [0, 60 / 85]),
    ],
)  # fmt: skip
def test_one_detection_finds_one_object_of_its_class(labels, found, confidences, ious):
    matches = match_detections(labels, found)
    assert [match.confidence for match in matches] == confidences
    assert [match.iou for match in matches] == pytest.approx(ious)
    assert [match.class_seen is None for match in matches] == [not each for each in confidences]


def test_the_match_of_its_class_and_of_any_class():
    found = [
        Detection("car", 0.3, (0, 0, 100, 80)),
        Detection("truck", 0.7, CAR),
        Detection("car", 0.9, (0, 0, 49, 100)),
    ]
    (match,) = match_detections([label(CAR)], found)
    assert (match.confidence, match.iou) == (0.3, pytest.approx(0.8))
    assert (match.confidence_any_class, match.iou_any_class) == (0.7, 1)
    assert (match.class_seen, match.flipped_to) == ("truck", "truck")


SIDES = st.integers(0, 6)
BOX = st.tuples(SIDES, SIDES, st.integers(7, 12), st.integers(7, 12)).map(lambda box: tuple(map(float, box)))
NAME = st.sampled_from(["car", "truck"])
FOUND_BOX = st.builds(Detection, NAME, st.sampled_from([0.1, 0.4, 0.4, 0.8]), BOX)


@given(st.lists(st.builds(label, BOX, NAME), max_size=5), st.lists(FOUND_BOX, max_size=8))
def test_any_class_never_says_less_than_its_own(truths: list[Detection], detections: list[Detection]):
    matches = match_detections(truths, detections)
    for match, truth in zip(matches, truths, strict=True):
        assert match.confidence_any_class >= match.confidence
        assert (match.iou >= 0.5) == (match.confidence > 0)
        assert (match.flipped_to is None) == (match.class_seen in (None, truth.class_name))
    for values in ([m.confidence for m in matches], [m.confidence_any_class for m in matches]):
        used = [value for value in values if value]
        assert all(used.count(v) <= [d.confidence for d in detections].count(v) for v in used)


# Recall and robustness


def test_recall_is_counted_between_distances_with_wilsons_interval():
    distances = np.array([5, 10, 15, 19.9, 20, 45, 99])
    confidences = np.array([0.9, 0.25, 0.2, 0.8, 0.0, 0.7, 0.9])
    near, middle, far = recall_by_distance(distances, confidences, (0, 10, 20, 50))
    assert [(each.objects, each.found) for each in (near, middle, far)] == [(1, 1), (3, 2), (2, 1)]
    assert middle.recall == pytest.approx(2 / 3)
    assert recall_by_distance(distances, confidences, (20, 30), min_confidence=0)[0].found == 0  # a miss stays one
    with pytest.raises(ValueError, match="0, 20, 20 m"):
        recall_by_distance(distances, confidences, (0, 20, 20))
    distances, confidences = np.array([1.0] * 10 + [11.0] * 10), np.array([0.9] * 8 + [0.0] * 12)
    bins = recall_by_distance(distances, confidences, (0, 10, 20, 30))
    for each, interval in zip(bins, ((0.4902, 0.9433), (0, 0.2775), (0, 1)), strict=True):  # as tabulated
        assert each.interval == pytest.approx(interval, abs=1e-4)
    assert math.isnan(bins[2].recall)


def test_performance_under_rain_is_the_mean_and_its_share_of_the_clear():
    result = robustness(0.5, [0.4, 0.3, 0.2])
    assert (result.mpc, result.rpc) == (pytest.approx(0.3), pytest.approx(0.6))
    assert math.isnan(robustness(0.0, [0.1]).rpc)
    with pytest.raises(ValueError, match="at least one intensity"):
        robustness(0.5, [])
