import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.evaluation.detection.decoders import intersection_over_union, non_maximum_suppression

COORDINATES = st.integers(0, 12)
BOXES = st.lists(st.tuples(COORDINATES, COORDINATES, COORDINATES, COORDINATES), min_size=1, max_size=12)


def _pixels(box: tuple[int, int, int, int]) -> set[tuple[int, int]]:
    return {(x, y) for x in range(box[0], box[2]) for y in range(box[1], box[3])}


@given(BOXES, BOXES)
def test_overlap_is_shared_over_covered_area(first: list, second: list):
    overlaps = intersection_over_union(np.array(first, float), np.array(second, float))
    for row, a in enumerate(map(_pixels, first)):
        for column, b in enumerate(map(_pixels, second)):
            assert overlaps[row, column] == pytest.approx(len(a & b) / len(a | b) if a | b else 0)


@given(BOXES, st.randoms(use_true_random=False), st.sampled_from([0.0, 0.3, 0.5]))
def test_kept_boxes_are_those_that_nothing_better_covers(boxes: list, random, most_iou: float):
    confidences = np.array([random.choice([0.2, 0.5, 0.9]) for _ in boxes])
    classes = np.array([random.randrange(2) for _ in boxes])
    overlaps = intersection_over_union(np.array(boxes, float), np.array(boxes, float))
    expected: list[int] = []
    for row in sorted(range(len(boxes)), key=lambda row: -confidences[row]):
        if all(overlaps[row, better] <= most_iou or classes[row] != classes[better] for better in expected):
            expected.append(row)
    assert non_maximum_suppression(np.array(boxes, float), confidences, classes, most_iou).tolist() == expected
