from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")

from onnx import TensorProto

from gsrain_engine.evaluation.detection.detector import open_detector

from .tiny_onnx import NAMES, rows, write_constant, write_red_finder

PICTURE = np.zeros((50, 100, 3), np.uint8)


def test_an_end_to_end_file_explains_itself(tmp_path: Path):
    found = rows((0, 16, 32, 48, 0.9, 0), (32, 16, 64, 32, 0.4, 2), (8, 20, 12, 28, 0.95, 1), (0, 16, 9, 30, 0.005, 0))
    detector = open_detector(write_constant(tmp_path / "tiny.onnx", [found], metadata=NAMES))
    assert (detector.name, detector.classes) == ("tiny", ("car", "person", "truck"))
    assert detector.input_size_px == (64, 64)
    # The picture of 100x50 px becomes 64x32 px between bars of 16 px.
    assert [(each.class_name, each.box_xyxy) for each in detector.detect(PICTURE)] == [
        ("person", pytest.approx((12.5, 6.25, 18.75, 18.75))),
        ("car", pytest.approx((0, 0, 50, 50))),
        ("truck", pytest.approx((50, 0, 100, 25))),
    ]
    assert [each.confidence for each in detector.detect(PICTURE)] == pytest.approx([0.95, 0.9, 0.4])


def test_boxes_end_at_the_picture(tmp_path: Path):
    found = rows((-9, 0, 70, 64, 0.9, 0), (10, 2, 20, 9, 0.8, 0))
    detections = open_detector(write_constant(tmp_path / "tiny.onnx", [found], metadata=NAMES)).detect(PICTURE)
    assert [each.box_xyxy for each in detections] == [(0, 0, 100, 50)]  # the second lies in the upper bar


def test_the_network_sees_the_picture_as_described(tmp_path: Path):
    red = PICTURE.copy()
    red[..., 0] = 51
    path = write_red_finder(tmp_path / "red.onnx", NAMES)
    assert open_detector(path).detect(red)[0].confidence == pytest.approx(0.2)
    assert open_detector(path).detect(red[..., ::-1].copy()) == []
    path.with_suffix(".yaml").write_text("decode: end_to_end\nchannels: bgr\nmean: [0, 0, 0.1]\nclasses: [bike]\n")
    assert open_detector(path).detect(red) == []
    (seen,) = open_detector(path).detect(red[..., ::-1].copy())
    assert (seen.class_name, seen.confidence) == ("bike", pytest.approx(0.2))
    assert open_detector(path, "yolo_end_to_end").detect(red)[0].class_name == "car"


def test_half_precision_takes_half_precision(tmp_path: Path):
    found = rows((0, 16, 32, 48, 0.5, 2))
    path = write_constant(tmp_path / "half.onnx", [found], metadata=NAMES, input_kind=TensorProto.FLOAT16)
    (seen,) = open_detector(path).detect(PICTURE)
    assert (seen.class_name, seen.confidence, seen.box_xyxy) == ("truck", 0.5, (0, 0, 50, 50))


def test_grids_are_suppressed_class_by_class(tmp_path: Path):
    table = np.zeros((1, 7, 84), np.float32)  # center, size and three scores a column
    table[0, :, 0] = 16, 32, 32, 32, 0.9, 0, 0.1
    table[0, :, 1] = 17, 32, 32, 32, 0.8, 0, 0
    table[0, :, 2] = 16, 32, 32, 32, 0, 0.7, 0
    detector = open_detector(write_constant(tmp_path / "grid.onnx", [table], metadata={"names": NAMES["names"]}))
    assert detector.description.decode == "yolo"
    seen = [(each.class_name, round(each.confidence, 3)) for each in detector.detect(PICTURE)]
    assert seen == [("car", 0.9), ("person", 0.7)]


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        (rows((0, 0, 9, 9, np.nan, 0)), "NaN or infinity"),
        (rows((0, 0, 9, 9, 7.5, 0)), r"confidences are 0\.\.7\.5, not 0\.\.1"),
        (rows((0, 0, 9, 9, 0.5, 3)), r"names class 3, its classes are 0\.\.2"),
        (np.zeros((1, 300, 7)), r"\(1, 300, 7\).*rows of 6 numbers"),
        (np.zeros((2, 300, 6)), r"\(2, 300, 6\).*\(1, rows, columns\)"),
    ],
)
def test_numbers_that_are_no_detections_are_one_sentence(table: np.ndarray, problem: str, tmp_path: Path):
    path = write_constant(tmp_path / "odd.onnx", [table], metadata=NAMES)
    detector = open_detector(path, "yolo_end_to_end")
    with pytest.raises(ValueError, match=f"odd.onnx: .*{problem}") as error:
        detector.detect(PICTURE)
    assert "\n" not in str(error.value)


def test_files_that_are_no_network_are_one_sentence(tmp_path: Path):
    whole = write_constant(tmp_path / "whole.onnx", [rows()], metadata=NAMES).read_bytes()
    for name, content in (("half", whole[: len(whole) // 2]), ("text", b"not a network"), ("empty", b"")):
        path = tmp_path / f"{name}.onnx"
        path.write_bytes(content)
        with pytest.raises(ValueError, match=f"{name}.onnx: (not an ONNX file|takes nothing)") as error:
            open_detector(path)
        assert "\n" not in str(error.value)
    pointer = tmp_path / "pointer.onnx"
    pointer.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    with pytest.raises(ValueError, match="pointer.onnx: .*git lfs pull"):
        open_detector(pointer)
    with pytest.raises(ValueError, match="missing.onnx: no such file"):
        open_detector(tmp_path / "missing.onnx")
    (tmp_path / "yolo26n.pt").write_bytes(b"PK")
    with pytest.raises(ValueError, match="export them first"):
        open_detector(tmp_path / "yolo26n.pt")


def test_inputs_that_are_no_picture_are_refused(tmp_path: Path):
    path = write_constant(tmp_path / "nhwc.onnx", [rows()], metadata=NAMES, input_shape=(1, 64, 64, 3))
    with pytest.raises(ValueError, match=r"takes images .*64, 64, 3.*\(1, 3, height, width\)"):
        open_detector(path)
    path = write_constant(tmp_path / "four.onnx", [rows()], metadata=NAMES, input_shape=(4, 3, 64, 64))
    with pytest.raises(ValueError, match="takes images .*one picture"):
        open_detector(path)


def test_a_size_left_open_is_chosen_by_the_description(tmp_path: Path):
    path = write_constant(tmp_path / "open.onnx", [rows((0, 0, 96, 48, 0.9, 0))], ("height", "width"), NAMES)
    with pytest.raises(ValueError, match="input_size_px"):
        open_detector(path)
    path.with_suffix(".yaml").write_text("decode: end_to_end\ninput_size_px: [96, 48]\n")
    detector = open_detector(path)
    assert detector.input_size_px == (96, 48)
    assert detector.detect(PICTURE)[0].box_xyxy == pytest.approx((0, 0, 100, 50))
    fixed = write_constant(tmp_path / "fixed.onnx", [rows()], metadata=NAMES)
    with pytest.raises(ValueError, match="64 px wide, the description says 96"):
        open_detector(fixed, path.with_suffix(".yaml"))


def test_classes_that_nobody_names_are_asked_for(tmp_path: Path):
    path = write_constant(tmp_path / "bare.onnx", [rows()])
    with pytest.raises(ValueError, match=r"bare.onnx: .*give a description, one of .*yolo_end_to_end"):
        open_detector(path)
    with pytest.raises(ValueError, match="names no classes"):
        open_detector(path, "yolo_end_to_end")
