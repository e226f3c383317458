"""Average precision, matches, recall by distance and robustness, against their definitions."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pycocotools")

from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.evaluation.detection.metrics import (
    LabeledBox,
    average_precision,
    match_detections,
    recall_by_distance,
    robustness,
)
from gsrain_engine.report.interval import Interval


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
    with pytest.raises(ValueError, match="pictures and detections of 9"):
        average_precision(truths, [[]] * 9)


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
def test_each_detection_matches_one_object_of_its_class(labels, found, confidences, ious):
    matches = match_detections(labels, found)
    assert [match.confidence for match in matches] == confidences
    assert [match.iou for match in matches] == pytest.approx(ious)
    assert [match.class_seen is None for match in matches] == [not each for each in confidences]


def test_match_of_the_class_and_of_any_class():
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
def test_matches_of_any_class_are_no_less_confident(truths: list[Detection], detections: list[Detection]):
    matches = match_detections(truths, detections)
    for match, truth in zip(matches, truths, strict=True):
        assert match.confidence_any_class >= match.confidence
        assert (match.iou >= 0.5) == (match.confidence > 0)
        assert (match.flipped_to is None) == (match.class_seen in (None, truth.class_name))
    for values in ([m.confidence for m in matches], [m.confidence_any_class for m in matches]):
        used = [value for value in values if value]
        assert all(used.count(v) <= [d.confidence for d in detections].count(v) for v in used)


# Recall and robustness


def test_recall_between_distances_has_wilsons_interval():
    distances = np.array([5, 10, 15, 19.9, 20, 45, 99])
    confidences = np.array([0.9, 0.25, 0.2, 0.8, 0.0, 0.7, 0.9])
    near, middle, far, none = recall_by_distance(distances, confidences, (0, 10, 20, 50, 60))
    assert [(each.objects, each.found) for each in (near, middle, far, none)] == [(1, 1), (3, 2), (2, 1), (0, 0)]
    assert middle.recall == pytest.approx(2 / 3) and middle.interval == Interval.wilson(2, 3, "sightings")
    assert math.isnan(none.recall)
    assert recall_by_distance(distances, confidences, (20, 30), min_confidence=0)[0].found == 0  # a miss stays one
    with pytest.raises(ValueError, match="0, 20, 20 m"):
        recall_by_distance(distances, confidences, (0, 20, 20))


def test_robustness_is_the_mean_and_its_share_of_the_clear_value():
    result = robustness(0.5, [0.4, 0.3, 0.2])
    assert (result.mpc, result.rpc) == (pytest.approx(0.3), pytest.approx(0.6))
    assert math.isnan(robustness(0.0, [0.1]).rpc)
    with pytest.raises(ValueError, match="at least one intensity"):
        robustness(0.5, [])
