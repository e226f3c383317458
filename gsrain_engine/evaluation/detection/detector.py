"""Object detector: an ONNX file with its description, letterboxing, and inference of its format."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import platformdirs
from jaxtyping import Float32, Float64, UInt8
from msgspec import structs

from ...scene.objects import COCO_CATEGORIES, COCO_CLASSES
from .decoders import DecoderInput, OnnxModel, cell_grid, decode_outputs, decoder, non_maximum_suppression, open_onnx
from .description import DetectorDescription, Fit, OutputRole, description_names, load_description


@dataclass(frozen=True, slots=True)
class Detection:
    """A detected object."""

    class_name: str
    confidence: float
    """0..1."""
    box_xyxy: tuple[float, float, float, float]
    """Left, top, right, bottom in pixels of the image, whose upper left corner is (0, 0)."""


@dataclass(frozen=True, slots=True, eq=False)
class Detector:
    """Detects objects in images, deterministically to the bit."""

    name: str
    """Of its file, without suffix."""
    description: DetectorDescription
    classes: tuple[str, ...]
    input_size_px: tuple[int, int]
    """Width and height."""
    _model: OnnxModel = field(repr=False)
    _outputs: tuple[str, ...] | None = field(repr=False)
    """Names of the outputs that are decoded, in this order; None for all."""

    @property
    def file(self) -> Path:
        return self._model.path

    def detect(self, image: UInt8[np.ndarray, "h w 3"]) -> list[Detection]:
        """Detect objects in an image (RGB), by descending confidence; raises ValueError for outputs of another form."""
        height, width = image.shape[:2]
        placement = letterbox((width, height), self.input_size_px, self.description.fit)
        picture = network_input(image, placement, self.input_size_px, self.description)
        outputs = self._model.run(picture, self._outputs)
        try:
            found = decode_outputs(outputs, DecoderInput(self.description, len(self.classes), *self.input_size_px))
        except ValueError as error:
            raise ValueError(f"{self._model.path}: {error}") from None
        if decoder(self.description.decode).is_final:
            chosen = np.argsort(-found.confidences, kind="stable")
        else:
            overlap = self.description.suppression_iou
            chosen = non_maximum_suppression(found.boxes, found.confidences, found.classes, overlap)
        boxes = placement.in_image(found.boxes)
        visible = (boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])
        return [
            Detection(self.classes[found.classes[i]], float(found.confidences[i]), _corners(boxes[i]))
            for i in chosen[: self.description.most_detections]
            if visible[i]
        ]


Found = tuple[Any, Sequence[str | int], Any]
"""Boxes (n, 4), classes and confidences of a function that detects."""


@dataclass(frozen=True, slots=True, eq=False)
class FunctionDetector:
    """A function of an image as a detector."""

    name: str
    function: Callable[[UInt8[np.ndarray, "h w 3"]], Found]
    """Takes an image (RGB) and returns boxes (left, top, right, bottom in pixels), classes and confidences (0..1)."""
    classes: tuple[str, ...] = ()
    """Classes that it can name; empty if it can name all. A class that is a number is one of these."""

    def detect(self, image: UInt8[np.ndarray, "h w 3"]) -> list[Detection]:
        """Detect objects in an image (RGB), by descending confidence; raises ValueError for results of another form."""
        try:
            boxes, classes, scores = self.function(image)
            corners = np.asarray(boxes, np.float64).reshape(-1, 4)
            confidences = np.asarray(scores, np.float64).reshape(-1)
            names = [each if isinstance(each, str) else self.classes[int(each)] for each in classes]
        except (TypeError, ValueError, IndexError) as error:
            raise ValueError(f"{self.name}: expected boxes (n, 4), classes (n) and scores (n), but: {error}") from error
        if not len(corners) == len(names) == len(confidences):
            counts = f"{len(corners)} boxes, {len(names)} classes and {len(confidences)} scores"
            raise ValueError(f"{self.name}: {counts}, expected as many of each")
        if not (np.isfinite(corners).all() and ((confidences >= 0) & (confidences <= 1)).all()):
            raise ValueError(f"{self.name}: expected finite boxes, and scores within 0..1")
        order = np.argsort(-confidences, kind="stable")
        return [Detection(names[i], float(confidences[i]), _corners(corners[i])) for i in order]


def open_detector(path: Path, description: str | Path | None = None) -> Detector:
    """Open a detector from an ONNX file.

    Its description is `description` (a shipped name or a YAML file), else the YAML file next to it with the same name,
    else inferred from the ONNX file. Raises ValueError with the file's name for files that are no detector or of
    unknown kind, and for a description that does not fit; ModuleNotFoundError if onnxruntime is missing.
    """
    neighbor = path.with_suffix(".yaml")
    if description is None and neighbor.is_file():
        description = neighbor
    described = None if description is None else load_description(description)
    model = open_onnx(path, described and described.inputs)
    described = described or recognize_description(model)
    try:
        classes = _SETS.get(described.classes) if isinstance(described.classes, str) else described.classes
        classes = classes or model.class_names
        if not classes:
            raise ValueError("it names no classes; its description must (classes: coco, or a list)")
        size = _input_size(model, described)
        outputs = _decoded_outputs(model, described)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return Detector(path.stem, described, classes, size, model, outputs)


_COCO91 = {number: name for name, number in COCO_CATEGORIES.items()}
_SETS: dict[str, tuple[str, ...]] = {
    "coco": COCO_CLASSES,
    "coco91": tuple(_COCO91.get(number, f"unused {number}") for number in range(max(_COCO91) + 1)),
}
"""Classes by the names of their sets."""


def _input_size(model: OnnxModel, description: DetectorDescription) -> tuple[int, int]:
    """Width and height in pixels: fixed by the file, given by the description, or in the file's metadata."""
    described = description.input_size_px or (None, None)
    for axis, fixed, other in zip(("wide", "high"), (model.width, model.height), described, strict=True):
        if fixed and other and fixed != other:
            raise ValueError(f"its input is {fixed} px {axis}, the description says {other} (input_size_px)")
    trained = model.trained_size or (None, None)
    width, height = model.width or described[0] or trained[0], model.height or described[1] or trained[1]
    if width is None or height is None:
        raise ValueError("it takes pictures of any size; its description must choose one (input_size_px: [640, 640])")
    return width, height


_ROLES_BY_DECODER: dict[str, tuple[OutputRole, ...]] = {
    "boxes_scores_classes": ("boxes", "scores", "classes", "count"),
    "logits": ("boxes", "scores"),
}
_OUTPUT_ROLES: dict[str, OutputRole] = {
    **dict.fromkeys(("boxes", "bboxes", "dets", "pred_boxes", "det_boxes", "detection_boxes"), "boxes"),
    **dict.fromkeys(("scores", "logits", "pred_scores", "pred_logits", "det_scores", "detection_scores"), "scores"),
    **dict.fromkeys(("labels", "classes", "pred_classes", "det_classes", "detection_classes"), "classes"),
    **dict.fromkeys(("num_dets", "num_detections", "num_predictions"), "count"),
}
"""Roles of outputs by their common names."""


def _decoded_outputs(model: OnnxModel, description: DetectorDescription) -> tuple[str, ...] | None:
    """Names of the outputs in the order of the decoder; None for all. Raises ValueError if one is missing."""
    names = [output.name for output in model.outputs]
    missing = next((name for name in description.outputs if name not in names), None)
    if missing is not None:
        raise ValueError(f"it has no output {missing!r} (outputs), but {', '.join(names)}")
    order = _ROLES_BY_DECODER.get(description.decode)
    if order is None:
        return tuple(description.outputs) or None
    roles = description.outputs or {name: role for name in names if (role := _OUTPUT_ROLES.get(name)) is not None}
    named = {role: name for name, role in roles.items()}
    if "boxes" not in named or len(named) < 2:
        raise ValueError(
            f"its outputs are {', '.join(names)}; decoded as {description.decode} its description must say which are "
            f"{', '.join(order[:-1] if len(order) > 2 else order)} (outputs: {{NAME: boxes, ...}})"
        )
    return tuple(named[role] for role in order if role in named)


def _corners(box: np.ndarray) -> tuple[float, float, float, float]:
    left, top, right, bottom = map(float, box)
    return left, top, right, bottom


# Inference of the description

_MAX_END_TO_END = 1000  # detectors with built-in suppression output some hundred rows; grids output thousands
_COCO = len(COCO_CLASSES)
_BINS = (8, 11)  # numbers of distance bins in NanoDet's published files
_WITH_BOXES = ("detect", "segment", "pose")
"""Tasks of ultralytics exports whose rows begin with boxes."""

_ANCHORS = 3  # boxes a cell of YOLOv5 and YOLOv7
_YOLOV7_COLUMNS = 7

_GRIDS: tuple[tuple[str, tuple[int, ...]], ...] = (
    ("yolox", (5 + _COCO,)),
    *((name, (_COCO + 4 * bins,)) for name in ("nanodet", "nanodet_plus") for bins in _BINS),
    *((name, (_COCO, 4 * bins)) for name in ("nanodet", "nanodet_plus") for bins in _BINS),
)
"""Kinds by the columns of their tables; NanoDet's scores and distances are in one table or separate."""

_OPEN_SIZES = {"detr": (1200, 800), "rtdetr_hugging_face": (640, 640)}
"""Input sizes, width and height, of recognized kinds whose files take any."""


def recognize_description(model: OnnxModel) -> DetectorDescription:
    """Infer a detector's description from its outputs and metadata; raises ValueError if several kinds are possible."""
    task = model.metadata.get("task", "detect")
    if task not in _WITH_BOXES:
        raise ValueError(f"{model.path}: is made for {task!r}, not for finding boxes ({', '.join(_WITH_BOXES)})")
    shapes = _output_shapes(model)
    found = _by_names(model) or _by_metadata(model, shapes) or _by_grid(model, shapes)
    if found is None:
        named = ", ".join(f"{output.name} {shape}" for output, shape in zip(model.outputs, shapes, strict=True))
        raise ValueError(
            f"{model.path}: outputs {named} do not tell what kind of detector it is; give a description, one of "
            f"{', '.join(description_names())} or a YAML file"
        )
    return found


_Shape = tuple[int | None, ...]


def _output_shapes(model: OnnxModel) -> list[_Shape]:
    """Shapes of the outputs; those of a picture if the file leaves axes open, and its size is known."""
    trained = model.trained_size or (None, None)
    width, height = model.width or trained[0], model.height or trained[1]
    if width and height and any(None in output.shape[1:] for output in model.outputs):
        gray = np.full((1, 3, height, width), 0.5, np.float32)
        return [output.shape for output in model.run(gray)]
    return [output.shape for output in model.outputs]


def _by_names(model: OnnxModel) -> DetectorDescription | None:
    """Match transformers for detection, and files with their own suppression, by the names of inputs and outputs."""
    shapes = {output.name: output.shape for output in model.outputs}
    further = {tensor.name for tensor, _ in model.further}
    name = None
    if {"labels", "boxes", "scores"} <= set(shapes) and further == {"orig_target_sizes"}:
        name = "rtdetr"
    elif {"logits", "pred_boxes"} <= set(shapes):
        name = {_COCO: "rtdetr_hugging_face"}.get(shapes["logits"][-1] or 0)
        name = "detr" if shapes["logits"][-1] in (len(_SETS["coco91"]), len(_SETS["coco91"]) + 1) else name
    elif set(shapes) == {"dets", "labels"} and shapes["labels"][-1] == len(_SETS["coco91"]):
        name = "rf_detr"
    elif {"num_dets", "det_boxes", "det_scores", "det_classes"} <= set(shapes):
        name = "efficient_nms"
    elif [*shapes] == ["output"] and len(shapes["output"]) == 2 and shapes["output"][-1] == _YOLOV7_COLUMNS:
        name = "yolov7_end_to_end"
    if name is None:
        return None
    size = None if model.width and model.height else _OPEN_SIZES.get(name)
    return structs.replace(load_description(name), input_size_px=size)


def _by_metadata(model: OnnxModel, shapes: Sequence[_Shape]) -> DetectorDescription | None:
    """Match ultralytics exports: the number of classes gives the row length of each kind."""
    classes = model.class_names
    if classes is None or not shapes or len(shapes[0]) != 3:
        return None
    _, first, second = shapes[0]
    extra = _extra_columns(model, shapes)
    is_short = first is not None and first <= _MAX_END_TO_END
    is_final = model.metadata.get("end2end") == "True"
    if second == 6 + extra and (is_final or (is_short and not (len(classes) == 2 and _gives_fractions(model)))):
        name = "yolo_end_to_end"
    elif first == 4 + len(classes) + extra:
        name = "yolo11"
    elif second == 4 + len(classes) + extra and is_short:
        name = "rtdetr_ultralytics"
    elif second == 5 + len(classes) + extra:
        name = "yolov5"
    else:
        return None
    return structs.replace(load_description(name), extra_columns=extra)


def _extra_columns(model: OnnxModel, shapes: Sequence[_Shape]) -> int:
    """Number of columns after those of a box: mask coefficients, one a prototype, or coordinates of keypoints."""
    if model.keypoint_numbers is not None:
        return model.keypoint_numbers
    prototypes = [shape[1] for shape in shapes[1:] if len(shape) == 4 and shape[1] is not None]
    return prototypes[0] if len(shapes) == 2 and prototypes else 0


def _by_grid(model: OnnxModel, shapes: Sequence[_Shape]) -> DetectorDescription | None:
    """Match files without metadata: one row per grid cell, with the columns for COCO's classes."""
    if model.width is None or model.height is None:
        return None
    layout = DecoderInput(load_description("yolox"), _COCO, model.width, model.height)
    anchored = (_ANCHORS * len(cell_grid(layout)), 5 + _COCO)
    if shapes and shapes[0][-2:] == anchored and all(len(shape) == 5 for shape in shapes[1:]):
        return structs.replace(load_description("yolov5"), classes="coco")
    tables = [shape[-2:] for shape in shapes if len(shape) in (2, 3)]
    if len(tables) != len(shapes):
        return None
    for name, widths in _GRIDS:
        cells = len(cell_grid(DecoderInput(load_description(name), _COCO, model.width, model.height)))
        rows = [sum(row or 0 for row, columns in tables if columns == width) for width in widths]
        others = {columns for _, columns in tables} - set(widths)
        if rows == [cells] * len(widths) and not others and not (name == "yolox" and _gives_pixels(model)):
            return load_description(name)
    return None


def _gives_fractions(model: OnnxModel) -> bool:
    """True if a table of boxes begins with numbers of 0..1: RT-DETR of two classes has as many columns as YOLO26."""
    width, height = model.trained_size or (640, 640)
    table = model.run(np.full((1, 3, model.height or height, model.width or width), 0.5, np.float32))[0]
    return bool(0 < np.abs(table[..., :4]).max(initial=0) <= 1)


def _gives_pixels(model: OnnxModel) -> bool:
    """True if centers are in pixels (YOLOv6, YOLOX with --decode_in_inference), so that they span the input."""
    gray = np.full((1, 3, model.height or 0, model.width or 0), 114, np.float32)
    centers = model.run(gray)[0][0, :, :2]
    return bool(np.abs(centers).max() > min(model.width or 0, model.height or 0) / 2)


# Letterbox


@dataclass(frozen=True, slots=True)
class Letterbox:
    """Placement of an image in the input: original size, resized size, and top left corner; all in pixels."""

    picture_width: int
    picture_height: int
    width: int
    height: int
    left: int
    top: int

    def in_image(self, boxes: Float32[np.ndarray, "n 4"]) -> Float64[np.ndarray, "n 4"]:
        """Convert boxes x1 y1 x2 y2 from the input to pixels of the image, clipped at its edges."""
        scale = np.array([self.picture_width / self.width, self.picture_height / self.height] * 2)
        corner = np.array([self.left, self.top] * 2)
        limits = np.array([self.picture_width, self.picture_height] * 2)
        return np.clip((boxes - corner) * scale, 0.0, limits)


def letterbox(picture: tuple[int, int], size: tuple[int, int], fit: Fit) -> Letterbox:
    """Place an image of (width, height) in an input; margins differ by at most a pixel, the larger right and below."""
    (picture_width, picture_height), (width, height) = picture, size
    if fit == "stretch":
        return Letterbox(picture_width, picture_height, width, height, 0, 0)
    scale = min(width / picture_width, height / picture_height)
    inner_width = min(width, max(1, round(picture_width * scale)))
    inner_height = min(height, max(1, round(picture_height * scale)))
    left, top = (width - inner_width) // 2, (height - inner_height) // 2
    if fit == "letterbox_corner":
        left = top = 0
    return Letterbox(picture_width, picture_height, inner_width, inner_height, left, top)


def network_input(
    image: UInt8[np.ndarray, "h w 3"], placement: Letterbox, size: tuple[int, int], description: DetectorDescription
) -> Float32[np.ndarray, "1 3 hi wi"]:
    """The image (RGB) as network input, resized bilinearly without antialiasing as in the detectors' original code."""
    canvas = np.full((size[1], size[0], 3), description.padding, np.uint8)
    inner = cv2.resize(image, (placement.width, placement.height), interpolation=cv2.INTER_LINEAR)
    rows = slice(placement.top, placement.top + placement.height)
    canvas[rows, placement.left : placement.left + placement.width] = inner
    ordered = canvas if description.channels == "rgb" else canvas[..., ::-1]
    values = ordered.astype(np.float32) * np.float32(description.scale)
    values = (values - np.array(description.mean, np.float32)) / np.array(description.deviation, np.float32)
    return np.ascontiguousarray(values.transpose(2, 0, 1)[None])


# Detector files

PLACE = "GSRAIN_DETECTOR"  # environment variable with the ONNX file of a detector, or a folder with one
_URL = "https://github.com/Megvii-BaseDetection/YOLOX/releases/download/0.1.1rc0/yolox_nano.onnx"


def find_detector() -> Path:
    """Return the ONNX file of GSRAIN_DETECTOR, else of the detectors folder in the user's data folder.

    It is the first by name if there are several. Raises FileNotFoundError with the search path and download
    instructions.
    """
    own = os.environ.get(PLACE)
    place = Path(own) if own else platformdirs.user_data_path("gsrain", appauthor=False) / "detectors"
    files = [place] if place.is_file() else sorted(place.glob("*.onnx"))
    if files:
        return files[0]
    raise FileNotFoundError(
        f"no detector (.onnx) at {place}: put one there, for example {_URL} (3.7 MB, Apache-2.0), "
        f"or name its file by --detector or {PLACE}"
    )
