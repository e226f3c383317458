"""Detectors of all kinds of ONNX files: descriptions, recognition, letterboxing, and files that are none."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")

from gsrain_engine.evaluation.detection.description import DetectorDescription
from gsrain_engine.evaluation.detection.detector import letterbox, network_input, open_detector

from .tiny_onnx import NAMES, rows, write_constant, write_red_finder

PICTURE = np.zeros((50, 100, 3), np.uint8)
CELLS = 8 * 8 + 4 * 4 + 2 * 2
"""Of strides 8, 16 and 32 in 64x64 px."""


@pytest.mark.parametrize(
    ("fit", "drawn"), [("letterbox", slice(16, 48)), ("letterbox_corner", slice(0, 32)), ("stretch", slice(0, 64))]
)
def test_network_input_has_bars_and_normalized_channels(fit, drawn):
    picture = np.full((10, 20, 3), (255, 128, 0), np.uint8)
    description = DetectorDescription(
        decode="yolo", fit=fit, padding=51, channels="bgr", mean=(0.1, 0.2, 0.3), deviation=(0.5, 0.25, 2)
    )
    expected = np.full((3, 64, 64), 0.2, np.float32)
    expected[:, drawn] = np.array([0, 128 / 255, 1])[:, None, None]
    expected = (expected - np.reshape([0.1, 0.2, 0.3], (3, 1, 1))) / np.reshape([0.5, 0.25, 2], (3, 1, 1))
    values = network_input(picture, letterbox((20, 10), (64, 64), fit), (64, 64), description)
    np.testing.assert_allclose(values[0], expected, atol=1e-6)
    assert values.dtype == np.float32 and values.flags.c_contiguous


# Detection


def test_end_to_end_files_need_no_description(tmp_path: Path):
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


def test_images_are_converted_as_described(tmp_path: Path):
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


# A car in the middle of the picture, half as wide and half as high, of confidence 0.9, as each kind writes it in an
# input of 64x64 px: from 16 to 48 across, and down (stretch), or from 24 to 40 (letterbox, a picture of 100x50 px).

CLASSES = {"names": NAMES["names"]}
CENTER, STRETCHED = (32, 32, 32, 16), (0.5, 0.5, 0.5, 0.5)
CAR, TRUCK = 2, 7
"""Classes of COCO's 80."""


def grid(columns: int, *values: float, rows: int = CELLS) -> np.ndarray:
    """A table of boxes over the whole input, one of which has `values`; (1, rows, columns)."""
    table = np.zeros((1, rows, columns), np.float32)
    table[0, :, :4] = np.linspace(1, 63, rows)[:, None]
    table[0, 5, : len(values)] = values
    return table


def queries(box: tuple[float, ...], logits: np.ndarray) -> dict[str, np.ndarray]:
    boxes = np.full((1, 4, 4), 0.1, np.float32)
    boxes[0, 2] = box
    return {"pred_boxes": boxes, "logits": np.stack([np.full_like(logits, -9)] * 2 + [logits, logits * 0 - 9])[None]}


def logits_of(number: int, count: int, nothing: bool) -> np.ndarray:
    """Logits of a confidence of 0.9 for one class: by softmax if the last means nothing, else by the logistic."""
    logits = np.full(count + nothing, -30, np.float32)
    logits[number] = np.log(9)
    if nothing:
        logits[-1] = 0
    return logits


def seg(count: int) -> dict[str, np.ndarray]:
    return {"output0": grid(4 + 3 + count, *CENTER, 0.9).transpose(0, 2, 1), "output1": np.zeros((1, count, 16, 16))}


def sized(tables: dict[str, np.ndarray]):
    inputs = {"orig_target_sizes": (7, ("N", 2))}
    return lambda path: write_constant(path, tables, inputs=inputs, shapes={"boxes": (1, "queries", 4)})


def hugging_face(tables: dict[str, np.ndarray], *, mask: bool = False, size=("height", "width")):
    inputs = {"pixel_mask": (7, ("batch", 64, 64))} if mask else {}
    tables = tables | {"last_hidden_state": np.full((1, 4, 4), np.nan)}  # not decoded, so not looked at
    shape = ("batch", "channels", *size)
    return lambda path: write_constant(path, tables, inputs=inputs, input_shape=shape, picture="pixel_values")


def written(tables, metadata=None, **options):
    return lambda path: write_constant(path, tables, metadata=metadata, **options)


OPEN = ("height", "width")
CORNERS = np.array([[[1, 1, 9, 9], [16, 24, 48, 40], [3, 3, 8, 8]]], np.float32)
SCORES = np.array([[0.001, 0.9, 0.002]], np.float32)
LAYOUTS = {
    "YOLO with open axes": written([grid(7, *CENTER, 0.9).transpose(0, 2, 1)], CLASSES | {"imgsz": "[64, 64]"},
                                   size=OPEN, shapes={"output0": ("batch", 7, "anchors")}),
    "YOLO with open axes and outputs": written([grid(7, *CENTER, 0.9).transpose(0, 2, 1)], CLASSES | {"imgsz": "64"},
                                               size=OPEN, shapes={"output0": ("batch", "columns", "anchors")}),
    "YOLO-seg": written(seg(32), CLASSES | {"task": "segment"}),
    "YOLO-pose": written([grid(4 + 3 + 6, *CENTER, 0.9).transpose(0, 2, 1)],
                         CLASSES | {"task": "pose", "kpt_shape": "[2, 3]"}),
    "YOLO26-seg": written({"output0": np.pad(rows((16, 24, 48, 40, 0.9, 0)), ((0, 0), (0, 0), (0, 32))),
                           "output1": np.zeros((1, 32, 16, 16))}, NAMES | {"task": "segment"}),
    "YOLOv5-seg": written({"output0": grid(5 + 3 + 32, *CENTER, 1, 0.9), "output1": np.zeros((1, 32, 16, 16))},
                          CLASSES),
    "YOLOv5 with four outputs": written(
        {"output": grid(85, *CENTER, 1, 0, 0, 0.9, rows=3 * CELLS), "340": np.zeros((1, 3, 8, 8, 85)),
         "392": np.zeros((1, 3, 4, 4, 85)), "444": np.zeros((1, 3, 2, 2, 85))}),
    "YOLOv7 end to end": written({"output": np.array([[0, 16, 24, 48, 40, CAR, 0.9], [1, 0, 0, 64, 64, CAR, 0.95]])},
                                 shapes={"output": ("boxes", 7)}),
    "EfficientNMS": written({"num_dets": np.array([[2]]), "det_boxes": CORNERS, "det_scores": SCORES,
                             "det_classes": np.array([[0, CAR, -1]])}),
    "RT-DETR": sized({"labels": np.array([[0, CAR, 1]]), "boxes": CORNERS[:, :, [0, 0, 2, 2]] / 64, "scores": SCORES}),
    "RT-DETR of ultralytics": written([grid(7, *STRETCHED, 0.9, rows=300).clip(0, 1)], CLASSES | {"imgsz": "[64, 64]"}),
    "RT-DETR of Hugging Face": hugging_face(queries(STRETCHED, logits_of(CAR, 80, False))),
    "DETR of Hugging Face": hugging_face(queries(STRETCHED, logits_of(3, 91, True)), mask=True),
    "Conditional DETR": hugging_face(queries(STRETCHED, logits_of(3, 91, False)), mask=True, size=(64, 64)),
    "RF-DETR": written({"dets": queries(STRETCHED, logits_of(3, 91, False))["pred_boxes"],
                        "labels": queries(STRETCHED, logits_of(3, 91, False))["logits"]}),
}  # fmt: skip


@pytest.mark.parametrize("kind", LAYOUTS)
def test_every_layout_finds_the_car(kind: str, tmp_path: Path):
    (found,) = (
        each for each in open_detector(LAYOUTS[kind](tmp_path / "a.onnx")).detect(PICTURE) if each.confidence > 0.5
    )
    assert found.class_name == "car" and found.confidence == pytest.approx(0.9, abs=1e-5)
    assert found.box_xyxy == pytest.approx((25, 12.5, 75, 37.5), abs=1e-3)


def test_inputs_and_outputs_of_other_names_are_described(tmp_path: Path):
    tables = {"kind": np.array([[0, CAR, 1]]), "boxes": CORNERS[:, :, [0, 0, 2, 2]] / 64, "sure": SCORES}
    path = write_constant(tmp_path / "own.onnx", tables, inputs={"sides": (1, (1, 2))}, picture="x")
    with pytest.raises(ValueError, match="own.onnx: takes x .*sides .*inputs"):
        open_detector(path)
    described = "decode: boxes_scores_classes\nclasses: coco\nfit: stretch\n"
    path.with_suffix(".yaml").write_text(described + "inputs: {sides: width_height}\n")
    with pytest.raises(ValueError, match="own.onnx: its outputs are kind, boxes, sure.*scores, classes"):
        open_detector(path)
    names = "inputs: {sides: width_height, x: picture}\noutputs: {sure: scores, kind: classes, boxes: boxes}\n"
    path.with_suffix(".yaml").write_text(described + names)
    (found, *_) = open_detector(path).detect(PICTURE)
    assert (found.class_name, found.box_xyxy) == ("car", pytest.approx((25, 12.5, 75, 37.5)))
    for field, wrong in (("inputs", "inputs: {y: ones}\n"), ("outputs", names.replace("kind", "y"))):
        path.with_suffix(".yaml").write_text(described + wrong)
        with pytest.raises(ValueError, match=rf"own.onnx: .*has no {field[:-1]} 'y' \({field}\)"):
            open_detector(path)


def test_confidences_may_be_a_column_of_the_boxes(tmp_path: Path):
    tables = {"dets": np.concatenate([CORNERS, SCORES[..., None]], axis=2), "labels": np.array([[0, CAR, 1]])}
    path = write_constant(tmp_path / "end2end.onnx", tables)  # as MMDeploy writes them
    path.with_suffix(".yaml").write_text("decode: boxes_scores_classes\nclasses: coco\n")
    (found,) = open_detector(path).detect(PICTURE)
    assert (found.class_name, found.box_xyxy) == ("car", pytest.approx((25, 12.5, 75, 37.5)))


def test_rows_of_any_order_are_described(tmp_path: Path):
    table = np.array([[-1, 0, 0, 0, 0, 0], [CAR, 0.9, 16, 24, 48, 40]])  # as PaddleDetection writes them
    path = write_constant(tmp_path / "paddle.onnx", [table], inputs={"scale_factor": (1, ("N", 2))})
    path.with_suffix(".yaml").write_text(
        "decode: end_to_end\nclasses: coco\ncolumns: [class, confidence, x1, y1, x2, y2]\n"
    )
    (found,) = open_detector(path).detect(PICTURE)
    assert (found.class_name, found.box_xyxy) == ("car", pytest.approx((25, 12.5, 75, 37.5)))
    path.with_suffix(".yaml").write_text("decode: end_to_end\nclasses: coco\ncolumns: [class, x1, y1, x2, y2]\n")
    with pytest.raises(ValueError, match=r"paddle.yaml.*confidence.*\$\.columns"):
        open_detector(path)


@pytest.mark.parametrize(("unit", "factor"), [("pixel", 1 / 64), ("fraction", 1)])
@pytest.mark.parametrize("decode", ["yolo", "end_to_end"])
def test_boxes_of_the_other_unit_are_refused(decode: str, unit: str, factor: float, tmp_path: Path):
    table = grid(7, *CENTER, 0.9) if decode == "yolo" else rows((16, 24, 48, 40, 0.9, 0))
    table[..., :4] *= factor
    path = write_constant(tmp_path / "unit.onnx", [table], metadata=CLASSES)
    path.with_suffix(".yaml").write_text(f"decode: {decode}\nbox_unit: {unit}\n")
    with pytest.raises(ValueError, match="unit.onnx: .*box_unit"):
        open_detector(path).detect(PICTURE)


def test_centers_in_pixels_need_a_description(tmp_path: Path):
    """YOLOv6 and YOLOX with its grids resolved look alike and expect other inputs."""
    table = np.zeros((1, CELLS, 85), np.float32)
    table[0, :, :2] = np.linspace(4, 60, CELLS)[:, None]
    path = write_constant(tmp_path / "resolved.onnx", [table])
    with pytest.raises(ValueError, match="resolved.onnx: .*one of .*yolov6, .*yolox, yolox_decoded"):
        open_detector(path)
    assert open_detector(path, "yolov6").description.channels == "rgb"
    assert open_detector(path, "yolox_decoded").description.channels == "bgr"


@pytest.mark.parametrize(
    ("kind", "size_px"), [("RT-DETR of Hugging Face", (640, 640)), ("DETR of Hugging Face", (1200, 800))]
)
def test_open_sizes_of_recognized_kinds_are_those_of_their_training(kind: str, size_px, tmp_path: Path):
    assert open_detector(LAYOUTS[kind](tmp_path / "open.onnx")).input_size_px == size_px


def test_open_sizes_are_set_by_the_description(tmp_path: Path):
    path = write_constant(tmp_path / "open.onnx", [rows((0, 0, 96, 48, 0.9, 0))], ("height", "width"), NAMES)
    path.with_suffix(".yaml").write_text("decode: end_to_end\ninput_size_px: [96, 48]\n")
    detector = open_detector(path)
    assert detector.input_size_px == (96, 48)
    assert detector.detect(PICTURE)[0].box_xyxy == pytest.approx((0, 0, 100, 50))
    with pytest.raises(ValueError, match="64 px wide, the description says 96"):
        open_detector(write_constant(tmp_path / "fixed.onnx", [rows()], metadata=NAMES), path.with_suffix(".yaml"))


# Files that are no detector


def constant(*shapes, **options):
    return lambda path: write_constant(path, [np.zeros(shape) for shape in shapes], **options)


def half(path):
    path.write_bytes(write_constant(path, [rows()], metadata=NAMES).read_bytes()[:200])


END_TO_END = (1, 300, 6)


@pytest.mark.parametrize(
    ("name", "write", "description", "names"),
    [
        *(("odd.onnx", constant(shape), None, "what kind") for shape in ((1, CELLS, 84), (1, 1000), END_TO_END)),
        ("odd.onnx", constant((1, CELLS, 85), (1, 4)), None, "what kind"),
        *(("odd.onnx", constant(END_TO_END, metadata={"names": names}), None, "what kind")
          for names in ("{0: 'car'", "__import__('os').abort()", "{1: 'car'}", "7")),
        ("odd.onnx", constant(END_TO_END, metadata=NAMES | {"task": "obb"}), None, "'obb'"),
        ("odd.onnx", constant(END_TO_END), "yolo_end_to_end", "names no classes"),
        ("odd.onnx", constant(END_TO_END, metadata=NAMES, size=("height", "width")), None, "input_size_px"),
        ("odd.onnx", constant(END_TO_END, metadata=NAMES, input_shape=(1, 64, 64, 3)), None, "64, 64, 3"),
        ("odd.onnx", constant(END_TO_END, metadata=NAMES, input_shape=(4, 3, 64, 64)), None, "one picture"),
        ("odd.onnx", constant(END_TO_END, metadata=NAMES, input_shape=(1, 3, 9000, 64)), None, "8192"),
        ("odd.onnx", lambda path: path.write_bytes(b"not a network"), None, "not an ONNX file|takes nothing"),
        ("odd.onnx", lambda path: path.write_bytes(b""), None, "not an ONNX file|takes nothing"),
        ("odd.onnx", half, None, "not an ONNX file"),
        ("odd.onnx", lambda path: path.write_text("version https://git-lfs.github.com/spec/v1"), None, "git lfs"),
        ("yolo26n.pt", lambda path: path.write_bytes(b"PK"), None, "PyTorch"),
        ("odd.onnx", lambda path: None, None, "no such file"),
        ("odd.onnx", constant(END_TO_END), "yolov99", "nanodet, .*yolox"),
    ],
)  # fmt: skip
def test_other_files_are_refused_in_one_sentence(name, write, description, names, tmp_path: Path):
    write(tmp_path / name)
    with pytest.raises(ValueError, match=f"({name}|yolov99): .*({names})") as error:
        open_detector(tmp_path / name, description)
    assert "\n" not in str(error.value)


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
def test_other_tables_are_refused(table: np.ndarray, names: str, tmp_path: Path):
    detector = open_detector(write_constant(tmp_path / "odd.onnx", [table], metadata=NAMES), "yolo_end_to_end")
    with pytest.raises(ValueError, match=f"odd.onnx: .*{names}"):
        detector.detect(PICTURE)
