"""Detector descriptions: preprocessing and output format of an ONNX file, also as YAML."""

from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from ...plugins import DECODERS, find_extensions
from ...presets import load_config, shipped_config_names

_FOLDER = "detectors"
Decode = Literal["end_to_end", "yolo", "yolo_objectness", "yolox", "nanodet"]
Fit = Literal["letterbox", "letterbox_corner", "stretch"]
Size = Annotated[int, Meta(ge=32, le=8192)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Deviation = Annotated[float, Meta(gt=0)]


class DetectorDescription(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Input preprocessing and output format of a detector."""

    decode: Annotated[
        str,
        Meta(
            title="Decoding",
            description="end_to_end: rows x1 y1 x2 y2 confidence class (YOLOv10, YOLO26). yolo: center, size and a "
            "score a class (YOLOv8, YOLO11). yolo_objectness: those with an objectness before the classes (YOLOv5, "
            "YOLOv6, YOLOX exported with --decode_in_inference). yolox: the same relative to grid cells. nanodet: "
            "class scores and distributions of distances to the four sides. Or a decoder of an installed package.",
        ),
    ]
    classes: Annotated[
        tuple[Annotated[str, Meta(min_length=1)], ...] | Literal["coco"] | None,
        Meta(title="Classes", description="Names in the detector's order; left out: those the ONNX file holds."),
    ] = None
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
        if self.decode not in decode_names():
            raise ValueError(f"{self.decode!r} is none of {', '.join(decode_names())} - at `$.decode`")


def decode_names() -> tuple[str, ...]:
    """Allowed values of `decode`: built-in decoders, then those of installed packages."""
    ours: tuple[str, ...] = get_args(Decode)
    return (*ours, *(each.name for each in find_extensions(DECODERS) if each.name not in ours))


def description_names() -> list[str]:
    return shipped_config_names(_FOLDER)


def load_description(name: str | Path) -> DetectorDescription:
    """Load a shipped description by name, or a file by path; raises ValueError with the file and the field."""
    return load_config(_FOLDER, name, DetectorDescription, "detector description")
