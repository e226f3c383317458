"""Detector outputs: ONNX inference, decoders of boxes and classes, overlap, and non-maximum suppression."""

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Float64, Int, Int64, Shaped

from ...optional_packages import import_package
from ...plugins import DECODERS, Extension, find_extension
from ...safe_io.limits import check_file, open_file
from ...safe_io.text_files import printable_line
from .description import DetectorDescription, InputRole

_TOLERANCE = 1e-3  # tolerance for confidences outside 0..1 due to rounding
Output = Float32[np.ndarray, "..."]


@dataclass(frozen=True, slots=True, eq=False)
class BoxCandidates:
    """Candidate boxes of a detector, in pixels of its input."""

    boxes: Float32[np.ndarray, "n 4"]
    """Rows x1 y1 x2 y2."""
    confidences: Float32[np.ndarray, " n"]
    classes: Int64[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class DecoderInput:
    """Input of a decoder: the description, the number of classes, and the input size in pixels."""

    description: DetectorDescription
    classes: int
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class Decoder:
    """Reader of one kind of detector output."""

    decode: Callable[[Sequence[Output], DecoderInput], BoxCandidates]
    """Decodes the network's output for one image; raises ValueError for another layout."""
    is_final: bool = False
    """True if the network outputs one box per object, so that no suppression is needed."""


def decoder(name: str) -> Decoder:
    """Find a built-in or installed decoder; raises ValueError if it is missing or unusable."""
    if name in _DECODERS:
        return _DECODERS[name]
    installed = find_extension(DECODERS, name)
    if installed is None:
        raise ValueError(f"no decoder {name!r}")
    return _installed(installed)


def decode_outputs(outputs: Sequence[Output], layout: DecoderInput) -> BoxCandidates:
    """Decode a detector's output for one image; raises ValueError for another layout."""
    with np.errstate(over="ignore", invalid="ignore"):
        found = decoder(layout.description.decode).decode(outputs, layout)
    if not np.isfinite(found.boxes).all():
        raise ValueError(f"boxes decoded as {layout.description.decode} are not finite")
    return found


def cell_grid(layout: DecoderInput) -> Float32[np.ndarray, "a 3"]:
    """Column, row (in cells) and stride (in pixels) of every cell: finest stride first, row by row."""
    parts: list[Float32[np.ndarray, "_ 3"]] = []
    for stride in layout.description.strides:
        rows, columns = -(-layout.height // stride), -(-layout.width // stride)
        y, x = np.mgrid[:rows, :columns].astype(np.float32)
        parts.append(np.stack([x.ravel(), y.ravel(), np.full(x.size, stride, np.float32)], axis=1))
    return np.concatenate(parts)


def _end_to_end(outputs: Sequence[Output], layout: DecoderInput) -> BoxCandidates:
    """Rows of corners, confidence and class, without suppression (YOLOv10, Wang et al. 2024)."""
    columns = layout.description.columns
    rows = _rows(outputs, layout, len(columns))
    if "batch" in columns:
        rows = rows[rows[:, columns.index("batch")] == 0]
    boxes = rows[:, [columns.index(side) for side in ("x1", "y1", "x2", "y2")]]
    return _named_boxes(boxes, rows[:, columns.index("confidence")], rows[:, columns.index("class")], layout)


def _boxes_scores_classes(outputs: Sequence[Output], layout: DecoderInput) -> BoxCandidates:
    """Corners, confidences and classes in a table each, and optionally the number of boxes; without suppression.

    Confidences may be the fifth column of the boxes, as MMDeploy writes them.
    """
    boxes, *others = outputs
    boxes = boxes.reshape(-1, boxes.shape[-1]) if boxes.ndim else boxes
    if boxes.ndim == 2 and boxes.shape[1] == 5:
        boxes, others = boxes[:, :4], [boxes[:, 4], *others]
    if boxes.ndim != 2 or boxes.shape[1] != 4 or len(others) not in (2, 3):
        raise ValueError(f"its outputs {_shapes(outputs)} are not boxes of 4 numbers, their confidences and classes")
    confidences, classes = others[0].ravel(), others[1].ravel()
    if not len(boxes) == len(confidences) == len(classes):
        raise ValueError(f"its outputs {_shapes(outputs)} are not one confidence and one class a box")
    found = int(others[2].ravel()[0]) if len(others) == 3 and others[2].size else len(boxes)
    return _named_boxes(boxes[:found], confidences[:found], classes[:found], layout)


def _logits(outputs: Sequence[Output], layout: DecoderInput) -> BoxCandidates:
    """Center and size of each query's box, and logits of its classes (DETR, Carion et al. 2020).

    With one column more than classes, the last means "nothing", and a softmax gives the confidences; otherwise the
    logistic function does (RT-DETR).
    """
    if len(outputs) != 2:
        raise ValueError(f"its outputs {_shapes(outputs)} are not a table of boxes and one of logits")
    boxes, logits = (_table(output, layout) for output in outputs)
    more = logits.shape[1] - layout.classes
    if boxes.shape[1] != 4 or len(boxes) != len(logits) or more not in (0, 1):
        raise ValueError(
            f"its outputs {_shapes(outputs)} are not boxes of 4 numbers and as many rows of logits: "
            f"{layout.classes}, one a class, or {layout.classes + 1}"
        )
    if more:
        shares = np.exp(logits - logits.max(axis=1, keepdims=True, initial=-np.inf))
        scores = (shares / shares.sum(axis=1, keepdims=True))[:, :-1]
    else:
        scores = 1 / (1 + np.exp(-logits))
    return _best_classes(_corners(boxes), scores, layout)


def _named_boxes(boxes: Output, confidences: Output, classes: Output, layout: DecoderInput) -> BoxCandidates:
    """Boxes (corners) that the network has chosen, each with its class."""
    _check_confidences(confidences, layout)
    boxes = _in_pixels(boxes, layout)
    chosen = confidences >= layout.description.least_confidence
    named = np.rint(classes[chosen]).astype(np.int64)
    if len(named) and (named.min() < 0 or named.max() >= layout.classes):
        wrong = named.min() if named.min() < 0 else named.max()
        raise ValueError(f"it names class {wrong}, its classes are 0..{layout.classes - 1}")
    return BoxCandidates(boxes[chosen], confidences[chosen], named)


_MAX_FRACTION = (
    2.0  # boxes of fractions may reach over the edge of the picture; boxes in pixels all in its corner do not
)


def _in_pixels(boxes: Float32[np.ndarray, "n 4"], layout: DecoderInput) -> Float32[np.ndarray, "n 4"]:
    """Corners in pixels; ValueError if all boxes together contradict the described unit."""
    largest = float(np.abs(boxes).max(initial=0))
    if layout.description.box_unit == "pixel":
        if 0 < largest <= _MAX_FRACTION:
            raise ValueError(
                f"its boxes reach {largest:.3g}: fractions of the picture (box_unit: fraction), not pixels"
            )
        return boxes
    if largest > _MAX_FRACTION:
        raise ValueError(f"its boxes reach {largest:.4g}: pixels (box_unit: pixel), not fractions of the picture")
    return boxes * np.array([layout.width, layout.height] * 2, np.float32)


def _corners(boxes: Float32[np.ndarray, "n 4"]) -> Float32[np.ndarray, "n 4"]:
    """Corners of boxes given by center and size."""
    centers, halves = boxes[:, :2], boxes[:, 2:4] / 2
    return np.concatenate([centers - halves, centers + halves], axis=1)


def _shapes(outputs: Sequence[Output]) -> str:
    return ", ".join(str(output.shape) for output in outputs)


def _yolo(
    outputs: Sequence[Output], layout: DecoderInput, *, has_objectness: bool = False, in_cells: bool = False
) -> BoxCandidates:
    """Center, size, and one score per class (YOLOv8 and YOLO11 of ultralytics).

    YOLOv5 and YOLOv6 have an objectness before the scores: confidence is objectness times score. YOLOX (Ge et al. 2021)
    has it too, with centers relative to their cell and log sizes, both in cells.
    """
    rows = _rows(outputs, layout, 4 + has_objectness + layout.classes)
    boxes = rows[:, :4]
    if in_cells:
        cells = _cells(len(rows), layout)
        boxes = np.concatenate([(boxes[:, :2] + cells[:, :2]) * cells[:, 2:], np.exp(boxes[:, 2:]) * cells[:, 2:]], 1)
    scores = rows[:, 4:5] * rows[:, 5:] if has_objectness else rows[:, 4:]
    return _best_classes(_corners(boxes), scores, layout)


def _nanodet(outputs: Sequence[Output], layout: DecoderInput) -> BoxCandidates:
    """Scores, then for each side of the box a distribution over integer distances in cells (Li et al. 2020, GFL).

    The distance is the distribution's mean. One table holds both, or each stride has a table of scores and one of
    distributions.
    """
    scores, bins = _scores_and_bins(outputs, layout)
    cells = _cells(len(scores), layout)
    shares = np.exp(bins - bins.max(axis=-1, keepdims=True))
    shares /= shares.sum(axis=-1, keepdims=True)
    distances = (shares @ np.arange(bins.shape[-1], dtype=np.float32)) * cells[:, 2:]
    points = (cells[:, :2] + np.float32(layout.description.cell_center)) * cells[:, 2:]
    boxes = np.concatenate([points - distances[:, :2], points + distances[:, 2:]], axis=1)
    return _best_classes(boxes, scores, layout)


def _scores_and_bins(
    outputs: Sequence[Output], layout: DecoderInput
) -> tuple[Float32[np.ndarray, "a c"], Float32[np.ndarray, "a 4 b"]]:
    tables = [_table(output, layout) for output in outputs]
    if len(tables) == 1:
        width = tables[0].shape[1] - layout.classes
        scores, bins = tables[0][:, : layout.classes], tables[0][:, layout.classes :]
    else:
        scores = _by_stride([table for table in tables if table.shape[1] == layout.classes])
        bins = _by_stride([table for table in tables if table.shape[1] != layout.classes])
        width = bins.shape[1]
    if width < 8 or width % 4 or len(scores) != len(bins):
        raise ValueError(
            f"its output {_shapes(outputs)} is not nanodet's (cells, {layout.classes} classes + 4 sides of at least "
            "2 distances)"
        )
    return scores, bins.reshape(len(bins), 4, width // 4)


def _by_stride(tables: list[Float32[np.ndarray, "_ k"]]) -> Float32[np.ndarray, "a k"]:
    """Concatenate tables, the one with the most cells (the finest stride) first."""
    if not tables or len({table.shape[1] for table in tables}) > 1:
        return np.zeros((0, 0), np.float32)
    return np.concatenate(sorted(tables, key=len, reverse=True))


def _best_classes(
    boxes: Float32[np.ndarray, "a 4"], scores: Float32[np.ndarray, "a c"], layout: DecoderInput
) -> BoxCandidates:
    """Each box (corners) with its most probable class."""
    boxes = _in_pixels(boxes, layout)
    classes = scores.argmax(axis=1).astype(np.int64)
    confidences = np.take_along_axis(scores, classes[:, None], axis=1)[:, 0]
    _check_confidences(confidences, layout)
    chosen = confidences >= layout.description.least_confidence
    return BoxCandidates(boxes[chosen], confidences[chosen], classes[chosen])


def _rows(outputs: Sequence[Output], layout: DecoderInput, columns: int) -> Float32[np.ndarray, "a k"]:
    """The output with rows of `columns` numbers, transposed if necessary, without the extra columns.

    Other outputs may hold masks, or the same boxes by stride in more axes.
    """
    whole = columns + layout.description.extra_columns
    fitting = [output for output in outputs if output.ndim <= 3 and whole in output.shape]
    if len(fitting) > 1:
        raise ValueError(
            f"its outputs {_shapes(outputs)} are several tables of {whole} columns; decoded as "
            f"{layout.description.decode} it must give one (outputs: {{NAME: rows}})"
        )
    table = _table((fitting or outputs)[0], layout)
    if table.shape[1] != whole and table.shape[0] == whole:
        table = table.T
    if table.shape[1] != whole:
        further = f" and {whole - columns} extra_columns" if whole > columns else ""
        raise ValueError(
            f"its output is {outputs[0].shape}; decoded as {layout.description.decode} with {layout.classes} classes "
            f"it must have rows of {columns} numbers{further}"
        )
    return table[:, :columns]


def _table(output: Output, layout: DecoderInput) -> Float32[np.ndarray, "a k"]:
    """The output for one image as a table; the batch axis is optional."""
    if output.ndim == 2:
        return output
    if output.ndim == 4 and 1 in output.shape[1:]:
        output = output.reshape(1, *[each for each in output.shape[1:] if each != 1])
    if output.ndim != 3 or output.shape[0] != 1:
        raise ValueError(
            f"its output is {output.shape}; decoded as {layout.description.decode} it must be (1, rows, columns)"
        )
    return output[0]


def _cells(rows: int, layout: DecoderInput) -> Float32[np.ndarray, "a 3"]:
    """The grid of `cell_grid`; raises ValueError if an output has another number of rows."""
    cells = cell_grid(layout)
    if rows != len(cells):
        strides = ", ".join(map(str, layout.description.strides))
        raise ValueError(
            f"it gives {rows} rows; an input of {layout.width}x{layout.height} px has {len(cells)} cells of "
            f"strides {strides}"
        )
    return cells


def _check_confidences(confidences: Float32[np.ndarray, " a"], layout: DecoderInput) -> None:
    if len(confidences) and (confidences.min() < -_TOLERANCE or confidences.max() > 1 + _TOLERANCE):
        raise ValueError(
            f"decoded as {layout.description.decode} its confidences are {confidences.min():.3g}.."
            f"{confidences.max():.3g}, not 0..1: it is to be decoded otherwise"
        )


def _installed(extension: Extension) -> Decoder:
    """Decoder of another package, with its errors reduced to one sentence."""
    row = extension.load(Decoder)

    def decode(outputs: Sequence[Output], layout: DecoderInput) -> BoxCandidates:
        try:
            found = extension.expect(row.decode(outputs, layout), BoxCandidates, "gives")
        except ValueError:
            raise
        except Exception as error:  # packages may raise anything
            raise extension.unfit(error) from error
        n = len(found.boxes)
        if found.boxes.shape != (n, 4) or found.confidences.shape != (n,) or found.classes.shape != (n,):
            raise extension.unfit(f"gives {n} boxes with confidences or classes that are not one each")
        if n and not 0 <= found.classes.min() <= found.classes.max() < layout.classes:
            raise extension.unfit(f"names a class that is not within 0..{layout.classes - 1}")
        _check_confidences(found.confidences, layout)
        boxes, confidences = found.boxes.astype(np.float32), found.confidences.astype(np.float32)
        return BoxCandidates(boxes, confidences, found.classes.astype(np.int64))

    return Decoder(decode, row.is_final)


_DECODERS: dict[str, Decoder] = {
    "end_to_end": Decoder(_end_to_end, is_final=True),
    "yolo": Decoder(_yolo),
    "yolo_objectness": Decoder(partial(_yolo, has_objectness=True)),
    "yolox": Decoder(partial(_yolo, has_objectness=True, in_cells=True)),
    "nanodet": Decoder(_nanodet),
    "boxes_scores_classes": Decoder(_boxes_scores_classes, is_final=True),
    "logits": Decoder(_logits, is_final=True),
}

# Box overlap and suppression


def intersection_over_union(
    first: Float[np.ndarray, "n 4"], second: Float[np.ndarray, "m 4"]
) -> Float64[np.ndarray, "n m"]:
    """Intersection over union of boxes: 0..1, 1 for equal boxes (Jaccard index), 0 if both are empty."""
    a, b = first.astype(np.float64)[:, None], second.astype(np.float64)[None]
    shared_size = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    shared = np.prod(np.maximum(shared_size, 0.0), axis=-1)
    union = _area(a) + _area(b) - shared
    return np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)


def non_maximum_suppression(
    boxes: Float[np.ndarray, "n 4"],
    confidences: Float[np.ndarray, " n"],
    classes: Int[np.ndarray, " n"],
    max_iou: float,
) -> Int[np.ndarray, " k"]:
    """Rows of the remaining boxes by descending confidence: greedy non-maximum suppression per class.

    Removes a box if a more confident one of its class overlaps it by more than `max_iou`. Among equal confidences the
    earlier box stays.
    """
    order = np.argsort(-confidences, kind="stable")
    remaining: list[int] = []
    while len(order):
        best, order = order[0], order[1:]
        remaining.append(int(best))
        overlap = intersection_over_union(boxes[best][None], boxes[order])[0]
        order = order[(overlap <= max_iou) | (classes[order] != classes[best])]
    return np.array(remaining, np.int64)


def _area(boxes: Float64[np.ndarray, "*n 4"]) -> Float64[np.ndarray, "*n"]:
    return np.prod(np.maximum(boxes[..., 2:] - boxes[..., :2], 0.0), axis=-1)


# ONNX models

THREADS = 2  # fixed, for a deterministic order of sums; further threads process images in parallel
MAX_SIDE_PX = 8192  # largest side of a network's input
_POINTER = b"version https://git-lfs"  # first bytes of a Git LFS pointer file


class Tensor(NamedTuple):
    """Input or output of a network."""

    name: str
    kind: str
    """Type by onnxruntime: tensor(float)."""
    shape: tuple[int | None, ...]
    """None for dynamic axes."""


@dataclass(frozen=True, slots=True, eq=False)
class OnnxModel:
    """A network with an input (1, 3, height, width) of floats, and possibly others that follow from its size."""

    path: Path
    picture: Tensor
    further: tuple[tuple[Tensor, InputRole], ...]
    """Other inputs and what each gets."""
    outputs: tuple[Tensor, ...]
    metadata: Mapping[str, str]
    _session: Any = field(repr=False)

    @property
    def width(self) -> int | None:
        """In pixels; None for a dynamic size."""
        return self.picture.shape[3]

    @property
    def height(self) -> int | None:
        return self.picture.shape[2]

    @property
    def class_names(self) -> tuple[str, ...] | None:
        """Class names from the metadata of ultralytics exports; None if missing."""
        names = self._value("names")
        if isinstance(names, dict) and set(names) == set(range(len(names))):
            names = [names[number] for number in range(len(names))]
        return tuple(map(str, names)) if isinstance(names, list) and names else None

    @property
    def trained_size(self) -> tuple[int, int] | None:
        """Width and height in pixels from the metadata of ultralytics exports; None if missing."""
        sides = self._value("imgsz")
        sides = [sides, sides] if isinstance(sides, int) else sides
        if isinstance(sides, list | tuple) and len(sides) == 2 and all(type(side) is int for side in sides):
            height, width = sides
            return (width, height) if min(sides) > 0 and max(sides) <= MAX_SIDE_PX else None
        return None

    @property
    def keypoint_numbers(self) -> int | None:
        """Numbers of an object's keypoints from the metadata of ultralytics exports; None if missing."""
        shape = self._value("kpt_shape")
        is_shape = isinstance(shape, list | tuple) and len(shape) == 2 and all(type(side) is int for side in shape)
        return shape[0] * shape[1] if is_shape and min(shape) > 0 else None

    def _value(self, key: str) -> Any:
        try:
            return ast.literal_eval(self.metadata.get(key, ""))
        except (ValueError, SyntaxError, RecursionError, MemoryError):
            return None

    def run(
        self, picture: Float32[np.ndarray, "1 3 h w"], names: Sequence[str] | None = None
    ) -> tuple[Float32[np.ndarray, "..."], ...]:
        """Return the named outputs, or all; raises ValueError if it fails or returns non-finite numbers."""
        height, width = picture.shape[2:]
        feeds = {self.picture.name: picture.astype(_KINDS[self.picture.kind], copy=False)}
        for tensor, role in self.further:
            feeds[tensor.name] = _further_input(tensor, role, width, height)
        try:
            outputs = self._session.run(names, feeds)
        except Exception as error:  # onnxruntime's errors have no other common base class
            raise ValueError(f"{self.path}: fails on a picture: {_first_line(error)}") from None
        for output in outputs:
            if not isinstance(output, np.ndarray) or output.dtype.kind not in "fiu":
                raise ValueError(f"{self.path}: gives something other than tables of numbers")
            if not np.isfinite(output).all():
                raise ValueError(
                    f"{self.path}: gives NaN or infinity; the file is damaged, or its input is described wrong"
                )
        return tuple(output.astype(np.float32, copy=False) for output in outputs)


_KINDS = {
    "tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(double)": np.float64,
    "tensor(int64)": np.int64, "tensor(int32)": np.int32, "tensor(bool)": np.bool_,
}  # fmt: skip
_FLOATS = ("tensor(float)", "tensor(float16)")

_INPUT_ROLES: dict[str, InputRole] = {
    "orig_target_sizes": "width_height",
    "im_shape": "height_width",
    "scale_factor": "ones",
    "pixel_mask": "ones",
}
"""Inputs by the names that RT-DETR and its kin, PaddleDetection and Hugging Face's transformers give them."""


def _further_input(tensor: Tensor, role: InputRole, width: int, height: int) -> Shaped[np.ndarray, "..."]:
    """Value of an input that is no picture; open axes are the batch, then those of the picture."""
    if role in ("width_height", "height_width"):
        sides = [width, height] if role == "width_height" else [height, width]
        return np.array(sides, _KINDS[tensor.kind]).reshape(1, 2)
    sides = (1, height, width) if len(tensor.shape) == 3 else (1,) * len(tensor.shape)
    return np.ones([axis or side for axis, side in zip(tensor.shape, sides, strict=True)], _KINDS[tensor.kind])


def open_onnx(path: Path, inputs: Mapping[str, InputRole] | None = None) -> OnnxModel:
    """Open a file for the CPU, with what its inputs get by name.

    Raises ValueError with one sentence if it is no network for one image, `MissingPackageError` without onnxruntime.
    """
    onnxruntime = import_package("onnxruntime", "a detector")
    if not path.exists():
        raise ValueError(f"{path}: no such file")
    check_file(path)
    if path.suffix in (".pt", ".pth"):
        raise ValueError(f"{path}: weights of PyTorch; export them first (yolo export model={path.name} format=onnx)")
    try:
        session = onnxruntime.InferenceSession(
            str(path), _options(onnxruntime), providers=["CPUExecutionProvider"], enable_fallback=0
        )  # with a fallback it would print the error and retry
        # Strings are decoded on access: read them all here, where a decoding error means a damaged file.
        given = [(_tensor(each), each.shape) for each in session.get_inputs()]
        outputs = tuple(_tensor(each) for each in session.get_outputs())
        metadata = dict(session.get_modelmeta().custom_metadata_map)
    except Exception as error:  # onnxruntime's errors have no other common base class
        with open_file(path) as file:
            is_pointer = file.read(len(_POINTER)) == _POINTER
        cause = "it only points to one (git lfs pull fetches it)" if is_pointer else _first_line(error)
        if "TRT" in cause:
            cause += "; TensorRT's own nodes run only there: export it without them (YOLOv7: --end2end --max-wh 640)"
        raise ValueError(f"{path}: not an ONNX file that onnxruntime opens: {cause}") from None
    roles: dict[str, InputRole | None] = {tensor.name: _input_role(tensor, inputs or {}) for tensor, _ in given}
    unknown = [name for name in inputs or () if name not in roles]
    if unknown:
        raise ValueError(f"{path}: has no input {unknown[0]!r} (inputs), but {', '.join(roles) or 'none'}")
    pictures = [tensor for tensor, _ in given if roles[tensor.name] == "picture"]
    if len(pictures) != 1 or None in roles.values() or not _takes_picture(pictures[0]):
        takes = ", ".join(f"{tensor.name} {tensor.kind} {axes}" for tensor, axes in given)
        raise ValueError(
            f"{path}: takes {printable_line(takes) or 'nothing'}; a detector takes one picture of floats "
            "(1, 3, height, width), and what its description says (inputs)"
        )
    picture = pictures[0]
    if max(picture.shape[2] or 0, picture.shape[3] or 0) > MAX_SIDE_PX:
        raise ValueError(
            f"{path}: takes a picture of {picture.shape[3]} x {picture.shape[2]} px; at most {MAX_SIDE_PX} px a side"
        )
    further: list[tuple[Tensor, InputRole]] = [
        (tensor, role) for tensor, _ in given if tensor != picture and (role := roles[tensor.name])
    ]
    return OnnxModel(path, picture, tuple(further), outputs, metadata, session)


def _tensor(node: Any) -> Tensor:
    return Tensor(str(node.name), str(node.type), _shape(node.shape))


def _input_role(tensor: Tensor, inputs: Mapping[str, InputRole]) -> InputRole | None:
    """Role of an input: as described, by a common name, or the picture for floats of four axes; None if unknown."""
    role = inputs.get(tensor.name) or _INPUT_ROLES.get(tensor.name)
    if role is None and tensor.kind in _FLOATS and len(tensor.shape) == 4:
        return "picture"
    if role in ("width_height", "height_width") and (len(tensor.shape) != 2 or tensor.shape[1] not in (2, None)):
        return None
    return role if role == "picture" or tensor.kind in _KINDS else None


def _takes_picture(tensor: Tensor) -> bool:
    shape = tensor.shape
    return tensor.kind in _FLOATS and len(shape) == 4 and shape[0] in (1, None) and shape[1] in (3, None)


def _options(onnxruntime: Any) -> Any:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = THREADS
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    options.log_severity_level = 4  # errors are raised, so they are not also logged to the terminal
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return options


def _shape(axes: Any) -> tuple[int | None, ...]:
    return tuple(axis if isinstance(axis, int) and axis > 0 else None for axis in axes or ())


def _first_line(error: Exception) -> str:
    return printable_line((str(error).strip().splitlines() or [type(error).__name__])[0][:300])
