"""Detector descriptions: preprocessing and output format of an ONNX file, also as YAML."""

from collections import Counter
from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from ...plugins import DECODERS, find_extensions
from ...presets import load_config, shipped_config_names
from ...settings import Settings

_FOLDER = "detectors"
Decode = Literal[
    "end_to_end", "yolo", "yolo_objectness", "yolox", "nanodet", "boxes_scores_classes", "logits"
]  # fmt: skip
Fit = Literal["letterbox", "letterbox_corner", "stretch"]
Column = Literal["x1", "y1", "x2", "y2", "confidence", "class", "batch"]
Classes = Literal["coco", "coco91"]
InputRole = Literal["picture", "width_height", "height_width", "ones"]
OutputRole = Literal["boxes", "scores", "classes", "count", "rows"]
_BOX_COLUMNS: tuple[Column, ...] = ("x1", "y1", "x2", "y2", "confidence", "class")
TensorName = Annotated[str, Meta(min_length=1)]
Size = Annotated[int, Meta(ge=32, le=8192)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Deviation = Annotated[float, Meta(gt=0)]


class DetectorDescription(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Input preprocessing and output format of a detector."""

    decode: Annotated[
        str,
        Meta(
            title="Decoding",
            description="end_to_end: rows of `columns` (YOLOv10, YOLO26, YOLOv7 --end2end). yolo: center, size and a "
            "score a class (YOLOv8, YOLO11). yolo_objectness: those with an objectness before the classes (YOLOv5, "
            "YOLOv6, YOLOX exported with --decode_in_inference). yolox: the same relative to grid cells. nanodet: "
            "class scores and distributions of distances to the four sides. boxes_scores_classes: a table of corners, "
            "one of confidences and one of classes (RT-DETR, D-FINE, EfficientNMS). logits: a table of centers and "
            "sizes, and one of logits of the classes (DETR). Or a decoder of an installed package.",
        ),
    ]
    classes: Annotated[
        tuple[Annotated[str, Meta(min_length=1)], ...] | Classes | None,
        Meta(
            title="Classes",
            description="Names in the detector's order; coco: COCO's 80; coco91: by COCO's category numbers 0 to 90; "
            "left out: those the ONNX file holds.",
        ),
    ] = None
    columns: Annotated[
        tuple[Column, ...],
        Meta(title="Columns", description="Columns of rows, in their order (end_to_end)."),
    ] = _BOX_COLUMNS
    extra_columns: Annotated[
        int,
        Meta(
            ge=0,
            le=4096,
            title="Further columns",
            description="Number of columns after these that are not of boxes: masks, keypoints (end_to_end, yolo).",
        ),
    ] = 0
    box_unit: Annotated[
        Literal["pixel", "fraction"],
        Meta(title="Unit of the boxes", description="pixel: of the network's input. fraction: of its sides, 0..1."),
    ] = "pixel"
    inputs: Annotated[
        dict[TensorName, InputRole],
        Meta(
            title="Inputs",
            description="What each input gets, by its name: picture; width_height or height_width of the network's "
            "input in pixels; ones. Left out: by common names.",
        ),
    ] = msgspec.field(default_factory=dict)
    outputs: Annotated[
        dict[TensorName, OutputRole],
        Meta(
            title="Outputs",
            description="What each used output holds, by its name: rows of everything; or boxes, scores, classes and "
            "their count. Left out: by common names, or the first one.",
        ),
    ] = msgspec.field(default_factory=dict)
    input_size_px: Annotated[
        tuple[Size, Size] | None,
        Meta(title="Input", description="Width and height; left out: those the ONNX file fixes.", extra={"unit": "px"}),
    ] = None
    channels: Annotated[Literal["rgb", "bgr"], Meta(title="Order of the channels")] = "rgb"
    scale: Annotated[
        float, Meta(gt=0, le=1, title="Scale", description="Factor for pixel values of 0..255, applied first.")
    ] = 1 / 255
    mean: Annotated[
        tuple[float, float, float],
        Meta(title="Mean", description="Subtracted from scaled values, in the order of `channels`."),
    ] = (0.0, 0.0, 0.0)
    deviation: Annotated[
        tuple[Deviation, Deviation, Deviation],
        Meta(
            title="Standard deviation", description="Divisor after the mean is subtracted, in the order of `channels`."
        ),
    ] = (1.0, 1.0, 1.0)
    fit: Annotated[
        Fit,
        Meta(
            title="Fit",
            description="letterbox: shape kept, bars around. letterbox_corner: shape kept, bars right and below. "
            "stretch: shape not kept.",
        ),
    ] = "letterbox"
    padding: Annotated[int, Meta(ge=0, le=255, title="Grey of the bars")] = 114
    strides: Annotated[
        tuple[Annotated[int, Meta(ge=1, le=512)], ...],
        Meta(
            min_length=1,
            title="Strides",
            description="Input pixels a grid cell (yolox, nanodet).",
            extra={"unit": "px"},
        ),
    ] = (8, 16, 32)
    cell_center: Annotated[
        Fraction,
        Meta(title="Point of a cell", description="Point in each cell that distances start from (nanodet), in cells."),
    ] = 0.5
    least_confidence: Annotated[
        Fraction, Meta(title="Least confidence", description="Detections of lower confidence are not reported.")
    ] = 0.01
    suppression_iou: Annotated[
        Fraction,
        Meta(
            title="Suppression",
            description="Of two boxes of a class that overlap more, the less confident goes. Not for end_to_end.",
        ),
    ] = 0.65
    most_detections: Annotated[int, Meta(ge=1, le=10_000, title="Most detections a picture")] = 300

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.decode not in decode_names():
            raise ValueError(f"{self.decode!r} is none of {', '.join(decode_names())} - at `$.decode`")
        if not set(_BOX_COLUMNS) <= set(self.columns) or len(set(self.columns)) < len(self.columns):
            raise ValueError("needs x1, y1, x2, y2, confidence and class, each once - at `$.columns`")
        for field, roles in (("inputs", self.inputs), ("outputs", self.outputs)):
            doubled = next((role for role, count in Counter(roles.values()).items() if count > 1), None)
            if doubled is not None:
                raise ValueError(f"names two tensors for {doubled} - at `$.{field}`")


def decode_names() -> tuple[str, ...]:
    """Allowed values of `decode`: built-in decoders, then those of installed packages."""
    ours: tuple[str, ...] = get_args(Decode)
    return (*ours, *(each.name for each in find_extensions(DECODERS) if each.name not in ours))


def description_names() -> list[str]:
    return shipped_config_names(_FOLDER)


def load_description(name: str | Path) -> DetectorDescription:
    """Load a shipped description by name, or a file by path; raises ValueError with the file and the field."""
    return load_config(_FOLDER, name, DetectorDescription, "detector description")
