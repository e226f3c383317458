"""Object detector: an ONNX file with its description, letterboxing, and inference of its format."""

import os
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import platformdirs
from jaxtyping import Float32, Float64, UInt8

from ...scene.objects import COCO_CLASSES
from .decoders import DecoderInput, OnnxModel, cell_grid, decode_outputs, decoder, non_maximum_suppression, open_onnx
from .description import DetectorDescription, Fit, description_names, load_description


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

    def detect(self, image: UInt8[np.ndarray, "h w 3"]) -> list[Detection]:
        """Detect objects in an image (RGB), by descending confidence; raises ValueError for outputs of another form."""
        height, width = image.shape[:2]
        placement = letterbox((width, height), self.input_size_px, self.description.fit)
        outputs = self._model.run(network_input(image, placement, self.input_size_px, self.description))
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


def open_detector(path: Path, description: str | Path | None = None) -> Detector:
    """Open a detector from an ONNX file.

    Its description is `description` (a shipped name or a YAML file), else the YAML file next to it with the same name,
    else inferred from the ONNX file. Raises ValueError with the file's name for files that are no detector or of
    unknown kind, and for a description that does not fit; ModuleNotFoundError if onnxruntime is missing.
    """
    model = open_onnx(path)
    neighbor = path.with_suffix(".yaml")
    if description is None and neighbor.is_file():
        description = neighbor
    described = recognize_description(model) if description is None else load_description(description)
    try:
        classes = COCO_CLASSES if described.classes == "coco" else described.classes or model.class_names
        if not classes:
            raise ValueError("it names no classes; its description must (classes: coco, or a list)")
        size = _input_size(model, described)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return Detector(path.stem, described, classes, size, model)


def _input_size(model: OnnxModel, description: DetectorDescription) -> tuple[int, int]:
    """Width and height in pixels, fixed by the file or given by the description."""
    described = description.input_size_px or (None, None)
    for axis, fixed, other in zip(("wide", "high"), (model.width, model.height), described, strict=True):
        if fixed and other and fixed != other:
            raise ValueError(f"its input is {fixed} px {axis}, the description says {other} (input_size_px)")
    width, height = model.width or described[0], model.height or described[1]
    if width is None or height is None:
        raise ValueError("it takes pictures of any size; its description must choose one (input_size_px: [640, 640])")
    return width, height


def _corners(box: np.ndarray) -> tuple[float, float, float, float]:
    left, top, right, bottom = map(float, box)
    return left, top, right, bottom


# Inference of the description

_MAX_END_TO_END = 1000  # detectors with built-in suppression output some hundred rows; grids output thousands
_COCO = len(COCO_CLASSES)
_BINS = (8, 11)  # numbers of distance bins in NanoDet's published files

_GRIDS: tuple[tuple[str, tuple[int, ...]], ...] = (
    ("yolox", (5 + _COCO,)),
    *((name, (_COCO + 4 * bins,)) for name in ("nanodet", "nanodet_plus") for bins in _BINS),
    *((name, (_COCO, 4 * bins)) for name in ("nanodet", "nanodet_plus") for bins in _BINS),
)
"""Kinds by the columns of their tables; NanoDet's scores and distances are in one table or separate."""


def recognize_description(model: OnnxModel) -> DetectorDescription:
    """Infer a detector's description from its outputs and metadata; raises ValueError if several kinds are possible."""
    task = model.metadata.get("task", "detect")
    if task != "detect":
        raise ValueError(f"{model.path}: is made for {task!r}, not for finding boxes (task 'detect')")
    name = _by_metadata(model) or _by_grid(model)
    if name is None:
        shapes = ", ".join(str(shape) for shape in model.output_shapes)
        raise ValueError(
            f"{model.path}: outputs {shapes} do not tell what kind of detector it is; give a description, one of "
            f"{', '.join(description_names())} or a YAML file"
        )
    return load_description(name)


def _by_metadata(model: OnnxModel) -> str | None:
    """Match ultralytics exports: the number of classes gives the row length of each kind."""
    classes = model.class_names
    if classes is None or len(model.output_shapes) != 1 or len(model.output_shapes[0]) != 3:
        return None
    _, first, second = model.output_shapes[0]
    if second == 6 and (model.metadata.get("end2end") == "True" or (first is not None and first <= _MAX_END_TO_END)):
        return "yolo_end_to_end"
    if first == 4 + len(classes):
        return "yolo11"
    return "yolov5" if second == 5 + len(classes) else None


def _by_grid(model: OnnxModel) -> str | None:
    """Match files without metadata: one row per grid cell, with the columns for COCO's classes."""
    tables = [shape[-2:] for shape in model.output_shapes if len(shape) in (2, 3)]
    if model.width is None or model.height is None or len(tables) != len(model.output_shapes):
        return None
    for name, widths in _GRIDS:
        cells = len(cell_grid(DecoderInput(load_description(name), _COCO, model.width, model.height)))
        rows = [sum(row or 0 for row, columns in tables if columns == width) for width in widths]
        others = {columns for _, columns in tables} - set(widths)
        if rows == [cells] * len(widths) and not others and not (name == "yolox" and _gives_pixels(model)):
            return name
    return None


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
