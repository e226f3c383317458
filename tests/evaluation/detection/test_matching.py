import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.evaluation.detection.metrics import LabeledBox, match_detections

CAR = (0.0, 0.0, 100.0, 100.0)
"""Anything with a class and a box can be labelled; here a detection stands for it."""


def _label(box: tuple[float, ...], name: str = "car") -> Detection:
    return Detection(name, 1.0, box)


def test_the_match_of_its_class_and_of_any_class():
    assert isinstance(_label(CAR), LabeledBox)
    seen = [
        Detection("car", 0.3, (0, 0, 100, 80)),
        Detection("truck", 0.7, CAR),
        Detection("car", 0.9, (0, 0, 49, 100)),
    ]
    (match,) = match_detections([_label(CAR)], seen)
    assert (match.confidence, match.iou) == (0.3, pytest.approx(0.8))
    assert (match.confidence_any_class, match.iou_any_class) == (0.7, 1)
    assert (match.class_seen, match.flipped_to) == ("truck", "truck")


def test_a_missed_object_counts_as_nothing():
    (match,) = match_detections([_label(CAR)], [Detection("car", 0.9, (0, 0, 49.9, 100))])
    assert (match.confidence, match.iou, match.confidence_any_class, match.iou_any_class) == (0, 0, 0, 0)
    assert match.class_seen is None and match.flipped_to is None
    assert match_detections([], [Detection("car", 0.9, CAR)]) == []


def test_half_of_an_object_is_enough():
    (match,) = match_detections([_label(CAR)], [Detection("car", 0.9, (0, 0, 50, 100))])
    assert (match.confidence, match.iou) == (0.9, 0.5)


def test_one_detection_finds_one_object():
    beside = (20.0, 0.0, 120.0, 100.0)
    first, second = match_detections([_label(CAR), _label(beside)], [Detection("car", 0.9, (15, 0, 115, 100))])
    assert (first.confidence, second.confidence) == (0, 0.9)
    both = [Detection("car", 0.9, (15, 0, 115, 100)), Detection("car", 0.4, (10, 0, 110, 100))]
    assert [each.confidence for each in match_detections([_label(CAR), _label(beside)], both)] == [0.4, 0.9]


def test_a_detection_prefers_objects_of_its_class():
    person = (0.0, 0.0, 100.0, 60.0)
    seen = [Detection("person", 0.9, (0, 0, 100, 85))]  # overlaps the car more
    car, walker = match_detections([_label(CAR), _label(person, "person")], seen)
    assert car.class_seen is None
    assert (walker.confidence, walker.flipped_to) == (0.9, None)


SIDES = st.integers(0, 6)
BOX = st.tuples(SIDES, SIDES, st.integers(7, 12), st.integers(7, 12)).map(lambda box: tuple(map(float, box)))
NAME = st.sampled_from(["car", "truck"])
SEEN = st.builds(Detection, NAME, st.sampled_from([0.1, 0.4, 0.4, 0.8]), BOX)


@given(st.lists(st.builds(_label, BOX, NAME), max_size=5), st.lists(SEEN, max_size=8))
def test_any_class_never_says_less_than_its_own(truths: list[Detection], detections: list[Detection]):
    matches = match_detections(truths, detections)
    assert len(matches) == len(truths)
    for match, truth in zip(matches, truths, strict=True):
        assert match.confidence_any_class >= match.confidence
        assert (match.iou >= 0.5) == (match.confidence > 0)
        assert (match.flipped_to is None) == (match.class_seen in (None, truth.class_name))
    for values in ([m.confidence for m in matches], [m.confidence_any_class for m in matches]):
        given_out = [value for value in values if value]
        assert all(given_out.count(v) <= [d.confidence for d in detections].count(v) for v in given_out)
