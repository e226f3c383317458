"""Telling from an ONNX file alone what kind of detector it is, where only one kind is possible."""

import numpy as np

from gsrain_engine.scene.coco_classes import COCO_CLASSES

from .decoders import Layout, grid
from .description import DetectorDescription, description_names, load_description
from .onnx_model import OnnxModel

_MOST_END_TO_END = 1000
"""Detectors that suppress by themselves give some hundred rows; grids give thousands."""

_COCO = len(COCO_CLASSES)

_BINS = (8, 11)
"""Distances that NanoDet's published files tell apart."""

_GRIDS: tuple[tuple[str, tuple[int, ...]], ...] = (
    ("yolox", (5 + _COCO,)),
    *((name, (_COCO + 4 * bins,)) for name in ("nanodet", "nanodet_plus") for bins in _BINS),
    *((name, (_COCO, 4 * bins)) for name in ("nanodet", "nanodet_plus") for bins in _BINS),
)
"""Kinds by the columns of their tables; NanoDet's scores and distances are in one table or apart."""


def recognized(model: OnnxModel) -> DetectorDescription:
    """How to use a detector, from its outputs and what exports of ultralytics say of themselves.

    Raises ValueError, with the descriptions to choose from, where several kinds look the same.
    """
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
    """Exports of ultralytics: class names tell how many columns a row of each kind has."""
    classes = model.class_names
    if classes is None or len(model.output_shapes) != 1 or len(model.output_shapes[0]) != 3:
        return None
    _, first, second = model.output_shapes[0]
    if second == 6 and (model.metadata.get("end2end") == "True" or (first is not None and first <= _MOST_END_TO_END)):
        return "yolo_end_to_end"
    if first == 4 + len(classes):
        return "yolo11"
    return "yolov5" if second == 5 + len(classes) else None


def _by_grid(model: OnnxModel) -> str | None:
    """Files that say nothing: one row a grid cell, as many columns as COCO's classes ask for."""
    tables = [shape[-2:] for shape in model.output_shapes if len(shape) in (2, 3)]
    if model.width is None or model.height is None or len(tables) != len(model.output_shapes):
        return None
    for name, widths in _GRIDS:
        cells = len(grid(Layout(load_description(name), _COCO, model.width, model.height)))
        rows = [sum(row or 0 for row, columns in tables if columns == width) for width in widths]
        others = {columns for _, columns in tables} - set(widths)
        if rows == [cells] * len(widths) and not others and not (name == "yolox" and _gives_pixels(model)):
            return name
    return None


def _gives_pixels(model: OnnxModel) -> bool:
    """Whether centres are pixels already (YOLOv6, YOLOX with --decode_in_inference): then they reach over the input."""
    grey = np.full((1, 3, model.height or 0, model.width or 0), 114, np.float32)
    centers = model.run(grey)[0][0, :, :2]
    return bool(np.abs(centers).max() > min(model.width or 0, model.height or 0) / 2)
