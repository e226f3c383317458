"""Judgements of an earlier run."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.evaluation.detection.ground_truth import LabeledObject
from gsrain_engine.evaluation.detection.run import (
    Condition,
    EvaluatedFrame,
    ResultCache,
    evaluate_detections,
)
from gsrain_engine.render.draw import RenderView
from gsrain_engine.scene.camera import Camera

CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
TRUTHS = (LabeledObject("a", "car", (4.0, 5.0, 40.0, 45.0), 0.9, np.float64(1 / 3)),)
FRAME = EvaluatedFrame("first", RenderView(CAMERA, 1.5, np.array([10.0, 0.0, 0.0])), TRUTHS)
RAINY = Condition("rainy", 8.5, (3,))
FOUND = evaluate_detections("net", FRAME, RAINY, [Detection("car", np.float64(1 / 7), (4.1, 5.0, 40.0, 44.9))])


@pytest.fixture
def file(tmp_path):
    """With one judgement in it."""
    place = tmp_path / "finished.jsonl"
    with opened(place) as memory:
        memory.keep(FOUND, FRAME)
    return place


def opened(place, inputs=None, detectors=None):
    return ResultCache(place, inputs or {"scene": "1234"}, detectors or {"net": "abcd"})


def test_a_judgement_comes_back_as_it_was(file):
    memory = opened(file)
    assert memory.known("net", FRAME, RAINY) is None  # not read yet
    assert memory.read([FRAME]) == 1
    assert asdict(memory.known("net", FRAME, RAINY)) == asdict(FOUND)
    assert memory.known("net", FRAME, Condition("rainy", 8.5, (4,))) is None
    assert memory.known("net", FRAME, Condition("rainy", 8.6, (3,))) is None


def test_a_clear_picture_stands_for_however_many_seeds(tmp_path):
    place = tmp_path / "finished.jsonl"
    with opened(place) as memory:
        memory.keep(replace(FOUND, trial=Condition("clear", 0.0, (0, 1))), FRAME)
    memory = opened(place)
    memory.read([FRAME])
    more = Condition("clear", 0.0, (0, 1, 2, 3))
    assert asdict(memory.known("net", FRAME, more)) == asdict(replace(FOUND, trial=more))


@pytest.mark.parametrize(
    "other",
    [
        {"inputs": {"scene": "1235"}},
        {"detectors": {"net": "abce"}},
        {"frame": replace(FRAME, name="second")},
        {"frame": replace(FRAME, shot=RenderView(CAMERA, 1.6, np.array([10.0, 0.0, 0.0])))},
        {"frame": replace(FRAME, shot=RenderView(CAMERA, 1.5, np.array([10.1, 0.0, 0.0])))},
        {"frame": replace(FRAME, shot=RenderView(replace(CAMERA, fx=50.1), 1.5, np.array([10.0, 0.0, 0.0])))},
        {"frame": replace(FRAME, truths=(replace(TRUTHS[0], box_xyxy=(4.0, 5.0, 40.0, 45.1)),))},
    ],
)
def test_nothing_holds_for_other_inputs_and_the_file_forgets_it(file, other):
    frame = other.pop("frame", FRAME)
    assert opened(file, **other).read([frame]) == 0
    assert file.read_bytes() == b""


def test_a_torn_line_is_dropped_and_the_next_one_starts_afresh(file):
    whole = file.read_bytes()
    for cut in (1, len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole + whole[:cut])
        memory = opened(file)
        assert memory.read([FRAME]) == 1
        assert file.read_bytes() == whole
    with memory:
        memory.keep(replace(FOUND, trial=Condition("rainy", 12.0, (0,))), FRAME)
    assert opened(file).read([FRAME]) == 2
