"""Decoders against loops over cells, and overlap and suppression against pixels and a plain search."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.evaluation.detection.decoders import (
    DecoderInput,
    decode_outputs,
    intersection_over_union,
    non_maximum_suppression,
)
from gsrain_engine.evaluation.detection.description import DetectorDescription

WIDTH, HEIGHT = 96, 64


def _layout(decode: str, classes: int = 3, **fields: object) -> DecoderInput:
    return DecoderInput(DetectorDescription(decode=decode, **fields), classes, WIDTH, HEIGHT)


def _cells() -> list[tuple[int, int, int]]:
    """Column, row and stride, cell by cell as the heads write them."""
    return [
        (column, row, stride)
        for stride in (8, 16, 32)
        for row in range(HEIGHT // stride)
        for column in range(WIDTH // stride)
    ]


def test_yolox_boxes_start_from_their_cells():
    generator = np.random.default_rng(3)
    table = generator.uniform(0, 1, (1, len(_cells()), 8)).astype(np.float32)
    found = decode_outputs([table], _layout("yolox", least_confidence=0.0))
    for number, ((column, row, stride), values) in enumerate(zip(_cells(), table[0], strict=True)):
        x, y = (values[0] + column) * stride, (values[1] + row) * stride
        width, height = math.exp(values[2]) * stride, math.exp(values[3]) * stride
        expected = (x - width / 2, y - height / 2, x + width / 2, y + height / 2)
        assert found.boxes[number] == pytest.approx(expected, rel=1e-5)
        assert found.confidences[number] == pytest.approx(values[4] * max(values[5:]), rel=1e-6)
        assert found.classes[number] == int(np.argmax(values[5:]))


def _nanodet_tables(bins: int) -> tuple[np.ndarray, np.ndarray]:
    scores = np.zeros((len(_cells()), 3), np.float32)
    sides = np.zeros((len(_cells()), 4, bins), np.float32)
    chosen = _cells().index((2, 1, 16))
    scores[chosen] = 0.1, 0.8, 0.2
    for side, (near, far) in enumerate([(0, 1), (1, 1), (2, 3), (4, 4)]):
        sides[chosen, side, [near, far]] = 30  # all but everything there, half each
    return scores, sides.reshape(len(_cells()), 4 * bins)


@pytest.mark.parametrize("bins", [8, 11])
def test_nanodet_boxes_are_means_of_distances(bins: int):
    scores, sides = _nanodet_tables(bins)
    table = np.concatenate([scores, sides], axis=1)[None]
    found = decode_outputs([table], _layout("nanodet"))
    x, y = 2.5 * 16, 1.5 * 16
    assert found.boxes == pytest.approx(np.array([[x - 8, y - 16, x + 40, y + 64]]), abs=1e-3)
    assert (found.classes.tolist(), found.confidences.tolist()) == ([1], [pytest.approx(0.8)])
    assert decode_outputs([table], _layout("nanodet", cell_center=0)).boxes == pytest.approx(found.boxes - 8, abs=1e-3)
    pieces = [slice(96, 120), slice(0, 96), slice(120, 126)]  # a table for each stride
    apart = decode_outputs([table[piece] for table in (sides, scores) for piece in pieces], _layout("nanodet"))
    assert np.array_equal(apart.boxes, found.boxes) and np.array_equal(apart.classes, found.classes)


@pytest.mark.parametrize(
    ("decode", "values"),
    [("yolo_objectness", [10, 20, 4, 6, 0.5, 0.2, 0.9, 0.4]), ("yolo", [10, 20, 4, 6, 0.1, 0.45, 0.2])],
)
def test_tables_may_be_transposed(decode: str, values: list[float]):
    table = np.zeros((1, 20, len(values)), np.float32)
    table[0, 7] = values
    for each in (table, table.transpose(0, 2, 1), table[:, None]):
        found = decode_outputs([np.ascontiguousarray(each)], _layout(decode))
        assert found.boxes.tolist() == [[8, 17, 12, 23]]
        assert (found.classes.tolist(), found.confidences.tolist()) == ([1], [pytest.approx(0.45)])


INFINITE, LOGITS = np.zeros((1, 126, 8), np.float32), np.full((1, 126, 7), -4.0, np.float32)
INFINITE[0, 5] = 0, 0, 500, 0, 1, 1, 0, 0
SCORES, SIDES = _nanodet_tables(8)


@pytest.mark.parametrize(
    ("decode", "outputs", "names"),
    [
        ("yolox", [np.zeros((1, 100, 8), np.float32)], "100 rows; .*96x64 px has 126 cells of strides 8, 16, 32"),
        ("yolox", [INFINITE], "not finite"),
        ("yolox", [INFINITE, INFINITE], "several tables"),
        ("yolo", [LOGITS], r"-4\.\.-4, not 0\.\.1"),
        ("nanodet", [SCORES[:96], SIDES], "nanodet"),
        ("nanodet", [SCORES], "nanodet"),
    ],
)
def test_other_outputs_are_refused(decode, outputs, names):
    with pytest.raises(ValueError, match=names):
        decode_outputs(outputs, _layout(decode))


COORDINATES = st.integers(0, 12)
BOXES = st.lists(st.tuples(COORDINATES, COORDINATES, COORDINATES, COORDINATES), min_size=1, max_size=12)


def _pixels(box: tuple[int, int, int, int]) -> set[tuple[int, int]]:
    return {(x, y) for x in range(box[0], box[2]) for y in range(box[1], box[3])}


@given(BOXES, BOXES)
def test_overlap_equals_that_of_pixels(first: list, second: list):
    overlaps = intersection_over_union(np.array(first, float), np.array(second, float))
    for row, a in enumerate(map(_pixels, first)):
        for column, b in enumerate(map(_pixels, second)):
            assert overlaps[row, column] == pytest.approx(len(a & b) / len(a | b) if a | b else 0)


@given(BOXES, st.randoms(use_true_random=False), st.sampled_from([0.0, 0.3, 0.5]))
def test_suppression_equals_a_plain_search(boxes: list, random, max_iou: float):
    confidences = np.array([random.choice([0.2, 0.5, 0.9]) for _ in boxes])
    classes = np.array([random.randrange(2) for _ in boxes])
    overlaps = intersection_over_union(np.array(boxes, float), np.array(boxes, float))
    expected: list[int] = []
    for row in sorted(range(len(boxes)), key=lambda row: -confidences[row]):
        if all(overlaps[row, better] <= max_iou or classes[row] != classes[better] for better in expected):
            expected.append(row)
    assert non_maximum_suppression(np.array(boxes, float), confidences, classes, max_iou).tolist() == expected
