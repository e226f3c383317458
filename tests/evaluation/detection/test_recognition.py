from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")

from gsrain_engine.evaluation.detection.detector import open_detector

from .tiny_onnx import NAMES, rows, write_constant

CELLS = 8 * 8 + 4 * 4 + 2 * 2
"""Of strides 8, 16 and 32 in 64x64 px."""


@pytest.mark.parametrize(
    ("shapes", "metadata", "decode", "classes"),
    [
        ([(1, 300, 6)], NAMES, "end_to_end", 3),
        ([(1, 300, 6)], {"names": "['car', 'person']"}, "end_to_end", 2),  # YOLOv10 as older programs export it
        ([(1, 7, CELLS)], {"names": NAMES["names"], "task": "detect"}, "yolo", 3),
        ([(1, 3 * CELLS, 8)], {"names": NAMES["names"]}, "yolo_objectness", 3),
        ([(1, CELLS, 85)], {}, "yolox", 80),
        ([(1, CELLS, 80 + 32)], {}, "nanodet", 80),
        ([(1, CELLS, 80 + 44)], {}, "nanodet", 80),
        ([(1, CELLS + 1, 80 + 32)], {}, "nanodet", 80),
        ([(64, 80), (16, 80), (4, 80), (64, 32), (16, 32), (4, 32)], {}, "nanodet", 80),
    ],
)
def test_kinds_are_recognized_by_their_outputs(
    shapes: list[tuple[int, ...]], metadata: dict[str, str], decode: str, classes: int, tmp_path: Path
):
    path = write_constant(tmp_path / "some.onnx", [np.zeros(shape) for shape in shapes], metadata=metadata)
    detector = open_detector(path)
    assert (detector.description.decode, len(detector.classes)) == (decode, classes)
    if decode == "nanodet":
        assert len(detector.description.strides) == (4 if shapes[0][1] == CELLS + 1 else 3)
    assert detector.detect(np.zeros((40, 30, 3), np.uint8)) == []


def test_centres_in_pixels_are_not_taken_for_grids(tmp_path: Path):
    """YOLOv6 and YOLOX with its grids resolved look alike and want their pictures differently."""
    table = np.zeros((1, CELLS, 85), np.float32)
    table[0, :, :2] = np.linspace(4, 60, CELLS)[:, None]
    path = write_constant(tmp_path / "resolved.onnx", [table])
    with pytest.raises(ValueError, match="resolved.onnx: .*one of .*yolov6, yolox, yolox_decoded"):
        open_detector(path)
    assert open_detector(path, "yolov6").description.channels == "rgb"
    assert open_detector(path, "yolox_decoded").description.channels == "bgr"


@pytest.mark.parametrize("shapes", [[(1, CELLS, 84)], [(1, 1000)], [(1, CELLS, 85), (1, 4)], [(1, 300, 6)]])
def test_other_networks_are_asked_about(shapes: list[tuple[int, ...]], tmp_path: Path):
    path = write_constant(tmp_path / "other.onnx", [np.zeros(shape) for shape in shapes])
    with pytest.raises(ValueError, match="other.onnx: .*do not tell what kind of detector") as error:
        open_detector(path)
    assert "\n" not in str(error.value)


def test_networks_for_other_tasks_are_refused(tmp_path: Path):
    path = write_constant(tmp_path / "masks.onnx", [rows()], metadata=NAMES | {"task": "segment"})
    with pytest.raises(ValueError, match="made for 'segment'"):
        open_detector(path)


@pytest.mark.parametrize("names", ["{0: 'car'", "__import__('os').abort()", "{1: 'car'}", "7"])
def test_names_that_are_none_are_passed_by(names: str, tmp_path: Path):
    path = write_constant(tmp_path / "odd.onnx", [rows()], metadata={"names": names})
    with pytest.raises(ValueError, match="do not tell what kind"):
        open_detector(path)
