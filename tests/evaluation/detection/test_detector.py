"""Detectors of all kinds of ONNX files: descriptions, recognition, letterboxing, and files that are none."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")

from onnx import TensorProto

from gsrain_engine.evaluation.detection.description import DetectorDescription, description_names, load_description
from gsrain_engine.evaluation.detection.detector import letterbox, network_input, open_detector

from .tiny_onnx import NAMES, rows, write_constant, write_red_finder

PICTURE = np.zeros((50, 100, 3), np.uint8)
CELLS = 8 * 8 + 4 * 4 + 2 * 2
"""Of strides 8, 16 and 32 in 64x64 px."""


def test_every_shipped_description_is_one():
    assert {"yolo_end_to_end", "yolo11", "yolox", "nanodet"} <= set(description_names())
    assert all(load_description(name).scale in (1, pytest.approx(1 / 255)) for name in description_names())
    with pytest.raises(ValueError, match="yolov99: .*nanodet, .*yolox"):
        load_description("yolov99")


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("decode: yolo\nsize: 3", "`size`"),
        ("decode: retina", r"'retina' is none of end_to_end, .*nanodet - at `\$.decode`"),
        ("classes: coco", "`decode`"),
        ("decode: yolo\npadding: 300", r"<= 255 - at `\$.padding`"),
        ("decode: yolo\ndeviation: [1, 0, 1]", r"> 0.0 - at `\$.deviation"),
        ("decode: yolo\ninput_size_px: [640]", r"\$.input_size_px"),
        ("decode: yolo\nclasses: voc", r"\$.classes"),
    ],
)
def test_a_wrong_description_names_its_field(text: str, names: str, tmp_path: Path):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"mine.yaml: .*{names}"):
        load_description(path)


# Letterbox

SIDES = st.integers(1, 3000)


@given(
    SIDES,
    SIDES,
    st.integers(32, 800),
    st.integers(32, 800),
    st.sampled_from(["letterbox", "letterbox_corner", "stretch"]),
)
def test_the_whole_picture_comes_back_whole(width: int, height: int, wide: int, high: int, fit: str):
    placement = letterbox((width, height), (wide, high), fit)
    left, top = placement.left, placement.top
    assert left >= 0 and left + placement.width <= wide and top >= 0 and top + placement.height <= high
    assert placement.width == wide or placement.height == high
    inside = np.array([[left, top, left + placement.width, top + placement.height]], np.float32)
    assert placement.in_image(inside)[0] == pytest.approx((0, 0, width, height))


@pytest.mark.parametrize(
    ("fit", "drawn"), [("letterbox", slice(16, 48)), ("letterbox_corner", slice(0, 32)), ("stretch", slice(0, 64))]
)
def test_bars_are_where_the_description_says(fit, drawn):
    picture = np.full((10, 20, 3), (250, 100, 50), np.uint8)
    description = DetectorDescription(decode="yolo", fit=fit, padding=7, scale=1)
    expected = np.full((3, 64, 64), 7, np.float32)
    expected[:, drawn] = np.array([250, 100, 50])[:, None, None]
    assert np.array_equal(
        network_input(picture, letterbox((20, 10), (64, 64), fit), (64, 64), description)[0], expected
    )


def test_values_are_ordered_scaled_and_normalized():
    picture = np.full((32, 32, 3), (255, 128, 0), np.uint8)
    description = DetectorDescription(
        decode="yolo", channels="bgr", scale=1 / 255, mean=(0.1, 0.2, 0.3), deviation=(0.5, 0.25, 2)
    )
    values = network_input(picture, letterbox((32, 32), (32, 32), "stretch"), (32, 32), description)
    assert values[0, :, 9, 9] == pytest.approx([(0 - 0.1) / 0.5, (128 / 255 - 0.2) / 0.25, (1 - 0.3) / 2], rel=1e-5)
    assert values.dtype == np.float32 and values.flags.c_contiguous


# Detection


def test_an_end_to_end_file_explains_itself(tmp_path: Path):
    found = rows(
        (0, 16, 32, 48, 0.9, 0), (32, 16, 64, 32, 0.4, 2), (8, 20, 12, 28, 0.95, 1), (0, 16, 9, 30, 0.005, 0),
        (-9, 0, 70, 64, 0.3, 0), (10, 2, 20, 9, 0.2, 0),
    )  # fmt: skip
    detector = open_detector(write_constant(tmp_path / "tiny.onnx", [found], metadata=NAMES))
    assert (detector.name, detector.classes) == ("tiny", ("car", "person", "truck"))
    assert detector.input_size_px == (64, 64)
    # The picture of 100x50 px becomes 64x32 px between bars of 16 px. Boxes end at it; the last lies in the upper bar.
    assert [(each.class_name, each.box_xyxy) for each in detector.detect(PICTURE)] == [
        ("person", pytest.approx((12.5, 6.25, 18.75, 18.75))),
        ("car", pytest.approx((0, 0, 50, 50))),
        ("truck", pytest.approx((50, 0, 100, 25))),
        ("car", (0, 0, 100, 50)),
    ]
    assert [each.confidence for each in detector.detect(PICTURE)] == pytest.approx([0.95, 0.9, 0.4, 0.3])


def test_the_network_gets_the_picture_as_described(tmp_path: Path):
    red = PICTURE.copy()
    red[..., 0] = 51
    path = write_red_finder(tmp_path / "red.onnx", NAMES)
    assert open_detector(path).detect(red)[0].confidence == pytest.approx(0.2)
    assert open_detector(path).detect(red[..., ::-1].copy()) == []
    path.with_suffix(".yaml").write_text("decode: end_to_end\nchannels: bgr\nmean: [0, 0, 0.1]\nclasses: [bike]\n")
    assert open_detector(path).detect(red) == []
    (found,) = open_detector(path).detect(red[..., ::-1].copy())
    assert (found.class_name, found.confidence) == ("bike", pytest.approx(0.2))
    assert open_detector(path, "yolo_end_to_end").detect(red)[0].class_name == "car"


def test_half_precision_takes_half_precision(tmp_path: Path):
    table = rows((0, 16, 32, 48, 0.5, 2))
    path = write_constant(tmp_path / "half.onnx", [table], metadata=NAMES, input_kind=TensorProto.FLOAT16)
    (found,) = open_detector(path).detect(PICTURE)
    assert (found.class_name, found.confidence, found.box_xyxy) == ("truck", 0.5, (0, 0, 50, 50))


def test_grids_are_suppressed_class_by_class(tmp_path: Path):
    table = np.zeros((1, 7, CELLS), np.float32)  # center, size and three scores a column
    table[0, :, :3] = np.array(
        [(16, 32, 32, 32, 0.9, 0, 0.1), (17, 32, 32, 32, 0.8, 0, 0), (16, 32, 32, 32, 0, 0.7, 0)], np.float32
    ).T
    detector = open_detector(write_constant(tmp_path / "grid.onnx", [table], metadata={"names": NAMES["names"]}))
    assert [(each.class_name, round(each.confidence, 3)) for each in detector.detect(PICTURE)] == [
        ("car", 0.9), ("person", 0.7),
    ]  # fmt: skip


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
def test_kinds_are_recognized_by_their_outputs(shapes, metadata, decode: str, classes: int, tmp_path: Path):
    path = write_constant(tmp_path / "some.onnx", [np.zeros(shape) for shape in shapes], metadata=metadata)
    detector = open_detector(path)
    assert (detector.description.decode, len(detector.classes)) == (decode, classes)
    if decode == "nanodet":
        assert len(detector.description.strides) == (4 if shapes[0][1] == CELLS + 1 else 3)
    assert detector.detect(np.zeros((40, 30, 3), np.uint8)) == []


def test_centers_in_pixels_are_not_taken_for_grids(tmp_path: Path):
    """YOLOv6 and YOLOX with its grids resolved look alike and want their pictures differently."""
    table = np.zeros((1, CELLS, 85), np.float32)
    table[0, :, :2] = np.linspace(4, 60, CELLS)[:, None]
    path = write_constant(tmp_path / "resolved.onnx", [table])
    with pytest.raises(ValueError, match="resolved.onnx: .*one of .*yolov6, yolox, yolox_decoded"):
        open_detector(path)
    assert open_detector(path, "yolov6").description.channels == "rgb"
    assert open_detector(path, "yolox_decoded").description.channels == "bgr"


def test_a_size_left_open_is_chosen_by_the_description(tmp_path: Path):
    path = write_constant(tmp_path / "open.onnx", [rows((0, 0, 96, 48, 0.9, 0))], ("height", "width"), NAMES)
    with pytest.raises(ValueError, match="input_size_px"):
        open_detector(path)
    path.with_suffix(".yaml").write_text("decode: end_to_end\ninput_size_px: [96, 48]\n")
    detector = open_detector(path)
    assert detector.input_size_px == (96, 48)
    assert detector.detect(PICTURE)[0].box_xyxy == pytest.approx((0, 0, 100, 50))
    with pytest.raises(ValueError, match="64 px wide, the description says 96"):
        open_detector(write_constant(tmp_path / "fixed.onnx", [rows()], metadata=NAMES), path.with_suffix(".yaml"))


# Files that are no detector


def constant(*shapes, **options):
    tables = [each if isinstance(each, np.ndarray) else np.zeros(each) for each in shapes]
    return lambda path: write_constant(path, tables, **options)


@pytest.mark.parametrize(
    ("write", "description", "names"),
    [
        *((constant(shape), None, "what kind of detector") for shape in ((1, CELLS, 84), (1, 1000), (1, 300, 6))),
        (constant((1, CELLS, 85), (1, 4)), None, "what kind of detector"),
        *((constant((1, 300, 6), metadata={"names": names}), None, "what kind")
          for names in ("{0: 'car'", "__import__('os').abort()", "{1: 'car'}", "7")),
        (constant(rows(), metadata=NAMES | {"task": "segment"}), None, "'segment'"),
        (constant(rows()), "yolo_end_to_end", "names no classes"),
        (constant(rows(), metadata=NAMES, input_shape=(1, 64, 64, 3)), None, r"64, 64, 3.*\(1, 3, height, width\)"),
        (constant(rows(), metadata=NAMES, input_shape=(4, 3, 64, 64)), None, "takes images .*one picture"),
        (constant(rows(), metadata=NAMES, input_shape=(1, 3, 9000, 64)), None, "8192"),
        (lambda path: path.write_bytes(b"not a network"), None, "not an ONNX file|takes nothing"),
        (lambda path: path.write_bytes(b""), None, "not an ONNX file|takes nothing"),
        (lambda path: path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\n"), None, "git lfs"),
        (lambda path: None, None, "no such file"),
    ],
)  # fmt: skip
def test_files_that_are_no_detector_are_one_sentence(write, description, names, tmp_path: Path):
    write(tmp_path / "odd.onnx")
    with pytest.raises(ValueError, match=f"odd.onnx: .*({names})") as error:
        open_detector(tmp_path / "odd.onnx", description)
    assert "\n" not in str(error.value)


def test_half_a_network_and_weights_of_torch_are_refused(tmp_path: Path):
    whole = write_constant(tmp_path / "whole.onnx", [rows()], metadata=NAMES).read_bytes()
    for name, content in (("half.onnx", whole[: len(whole) // 2]), ("yolo26n.pt", b"PK")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=f"{name}: (not an ONNX file|weights of PyTorch)"):
            open_detector(tmp_path / name)


@pytest.mark.parametrize(
    ("table", "names"),
    [
        (rows((0, 0, 9, 9, np.nan, 0)), "NaN"),
        (rows((0, 0, 9, 9, 7.5, 0)), r"0\.\.7\.5"),
        (rows((0, 0, 9, 9, 0.5, 3)), r"class 3, .*0\.\.2"),
        (np.zeros((1, 300, 7)), r"\(1, 300, 7\).*6 numbers"),
        (np.zeros((2, 300, 6)), r"\(2, 300, 6\)"),
    ],
)
def test_numbers_that_are_no_detections_are_refused(table: np.ndarray, names: str, tmp_path: Path):
    detector = open_detector(write_constant(tmp_path / "odd.onnx", [table], metadata=NAMES), "yolo_end_to_end")
    with pytest.raises(ValueError, match=f"odd.onnx: .*{names}"):
        detector.detect(PICTURE)
