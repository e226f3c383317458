"""ONNX files of a few nodes with the inputs and outputs of real detectors."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

NUMPY_KINDS = {np.float32: TensorProto.FLOAT, np.int64: TensorProto.INT64}
NAMES = {"names": "{0: 'car', 1: 'person', 2: 'truck'}", "end2end": "True", "task": "detect"}


def write_constant(
    path: Path,
    outputs: Sequence[np.ndarray] | Mapping[str, np.ndarray],
    size: tuple[int | str, int | str] = (64, 64),
    metadata: Mapping[str, str] | None = None,
    *,
    input_shape: Sequence[int | str] | None = None,
    input_kind: int = TensorProto.FLOAT,
    shapes: Mapping[str, Sequence[int | str]] | None = None,
    inputs: Mapping[str, tuple[int, Sequence[int | str]]] | None = None,
    picture: str = "images",
) -> Path:
    """A network that gives `outputs` whatever it is shown; `size` is (height, width), a word leaves it open.

    `shapes` are those that the file states, `inputs` further ones with kind and shape. What a scaled output gives is
    multiplied by the first further input: "boxes" of fractions become those of the sizes that the network is given.
    """
    named = outputs if isinstance(outputs, Mapping) else {f"output{i}": table for i, table in enumerate(outputs)}
    nodes, tables, given = [], [], []
    for name, table in named.items():
        kind = np.int64 if table.dtype.kind == "i" else np.float32
        tables.append(numpy_helper.from_array(table.astype(kind), f"table_{name}"))
        nodes.append(helper.make_node("Identity", [f"table_{name}"], [name]))
        given.append(helper.make_tensor_value_info(name, NUMPY_KINDS[kind], (shapes or {}).get(name, table.shape)))
    sizes = next(iter(inputs or {}), None)
    if sizes is not None and "boxes" in named:
        nodes = [node for node in nodes if list(node.output) != ["boxes"]]
        tables.append(numpy_helper.from_array(np.array([1, 1, 4], np.int64), "one_by_four"))
        nodes += [
            helper.make_node("Cast", [sizes], ["float_sides"], to=TensorProto.FLOAT),
            helper.make_node("Concat", ["float_sides", "float_sides"], ["corners"], axis=1),
            helper.make_node("Reshape", ["corners", "one_by_four"], ["factors"]),
            helper.make_node("Mul", ["table_boxes", "factors"], ["boxes"]),
        ]
    return _write(path, nodes, tables, given, input_shape or (1, 3, *size), metadata, input_kind, inputs, picture)


def write_red_finder(path: Path, metadata: Mapping[str, str]) -> Path:
    """A network of 64x64 px that finds the whole picture as a car, as confidently as its middle is red."""
    tables = [
        numpy_helper.from_array(np.array([0, 0, 24, 24], np.int64), "starts"),
        numpy_helper.from_array(np.array([1, 1, 40, 40], np.int64), "ends"),
        numpy_helper.from_array(np.array([[[0, 16, 64, 48]]], np.float32), "box"),
        numpy_helper.from_array(np.zeros((1, 1, 1), np.float32), "class"),
        numpy_helper.from_array(np.array([1, 1, 1], np.int64), "shape"),
    ]
    nodes = [
        helper.make_node("Slice", ["images", "starts", "ends"], ["middle"]),
        helper.make_node("ReduceMean", ["middle"], ["mean"], keepdims=0),
        helper.make_node("Reshape", ["mean", "shape"], ["confidence"]),
        helper.make_node("Concat", ["box", "confidence", "class"], ["output0"], axis=2),
    ]
    given = [helper.make_tensor_value_info("output0", TensorProto.FLOAT, (1, 1, 6))]
    return _write(path, nodes, tables, given, (1, 3, 64, 64), metadata)


def rows(*detections: Sequence[float], count: int = 300) -> np.ndarray:
    """Rows x1 y1 x2 y2 confidence class of an end-to-end detector, filled up with zeros: (1, count, 6)."""
    table = np.zeros((1, count, 6), np.float32)
    if detections:
        table[0, : len(detections)] = detections
    return table


def _write(
    path: Path,
    nodes: Sequence[onnx.NodeProto],
    tables: Sequence[onnx.TensorProto],
    outputs: Sequence[onnx.ValueInfoProto],
    input_shape: Sequence[int | str],
    metadata: Mapping[str, str] | None,
    input_kind: int = TensorProto.FLOAT,
    inputs: Mapping[str, tuple[int, Sequence[int | str]]] | None = None,
    picture: str = "images",
) -> Path:
    image = helper.make_tensor_value_info(picture, input_kind, input_shape)
    further = [helper.make_tensor_value_info(name, *each) for name, each in (inputs or {}).items()]
    graph = helper.make_graph(list(nodes), "tiny", [image, *further], list(outputs), list(tables))
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    helper.set_model_props(model, dict(metadata or {}))
    onnx.save(model, path)
    return path
