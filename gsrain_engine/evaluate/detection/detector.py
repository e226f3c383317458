"""A detector: an ONNX file with its description, which finds objects in a picture."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from .decoders import Candidates, Layout, decoded, decoder
from .description import DetectorDescription, load_description, named_classes
from .letterbox import network_input, placed
from .onnx_model import OnnxModel, open_onnx
from .recognition import recognized
from .suppression import kept_boxes


@dataclass(frozen=True, slots=True)
class Detection:
    """An object that a detector believes in."""

    class_name: str
    confidence: float
    """0..1."""
    box_xyxy: tuple[float, float, float, float]
    """Left, top, right, bottom in pixels of the picture, whose upper left corner is (0, 0)."""


@dataclass(frozen=True, slots=True, eq=False)
class Detector:
    """Finds objects in pictures. The same picture gives the same detections, to the bit."""

    name: str
    """Of its file, without the ending."""
    description: DetectorDescription
    classes: tuple[str, ...]
    input_size_px: tuple[int, int]
    """Width and height."""
    _model: OnnxModel = field(repr=False)

    def detect(self, image: UInt8[np.ndarray, "h w 3"]) -> list[Detection]:
        """Find objects in a picture (RGB), the most confident first.

        Raises ValueError, with the file's name, where what the network gives can't be detections.
        """
        height, width = image.shape[:2]
        placement = placed((width, height), self.input_size_px, self.description.fit)
        outputs = self._model.run(network_input(image, placement, self.input_size_px, self.description))
        try:
            found = decoded(outputs, Layout(self.description, len(self.classes), *self.input_size_px))
        except ValueError as error:
            raise ValueError(f"{self._model.path}: {error}") from None
        boxes = placement.in_picture(found.boxes)
        visible = (boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])
        return [
            Detection(self.classes[found.classes[i]], float(found.confidences[i]), _corners(boxes[i]))
            for i in self._chosen(found)
            if visible[i]
        ]

    def _chosen(self, found: Candidates) -> np.ndarray:
        """Rows to report, the most confident first."""
        if decoder(self.description.decode).is_final:
            rows = np.argsort(-found.confidences, kind="stable")
        else:
            rows = kept_boxes(found.boxes, found.confidences, found.classes, self.description.suppression_iou)
        return rows[: self.description.most_detections]


def open_detector(path: Path, description: str | Path | None = None) -> Detector:
    """Open a detector of an ONNX file.

    How it is used says `description` (a shipped name or a YAML file), else a YAML file of its name beside it, else what
    the ONNX file gives away. Raises ValueError, with the file's name, for files that are no detector or of unknown
    kind, and for a description that does not fit; ModuleNotFoundError where onnxruntime is missing.
    """
    model = open_onnx(path)
    beside = path.with_suffix(".yaml")
    if description is None and beside.is_file():
        description = beside
    described = recognized(model) if description is None else load_description(description)
    try:
        classes = named_classes(described, model.class_names)
        size = _input_size(model, described)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return Detector(path.stem, described, classes, size, model)


def _input_size(model: OnnxModel, description: DetectorDescription) -> tuple[int, int]:
    """Width and height in pixels that the file fixes, or that the description asks for."""
    asked = description.input_size_px or (None, None)
    for axis, fixed, wanted in zip(("wide", "high"), (model.width, model.height), asked, strict=True):
        if fixed and wanted and fixed != wanted:
            raise ValueError(f"its input is {fixed} px {axis}, the description says {wanted} (input_size_px)")
    width, height = model.width or asked[0], model.height or asked[1]
    if width is None or height is None:
        raise ValueError("it takes pictures of any size; its description must choose one (input_size_px: [640, 640])")
    return width, height


def _corners(box: np.ndarray) -> tuple[float, float, float, float]:
    left, top, right, bottom = map(float, box)
    return left, top, right, bottom
