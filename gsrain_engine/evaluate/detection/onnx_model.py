"""An ONNX file that takes one picture: opened, described, run; the same numbers for the same picture."""

import ast
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from gsrain_engine.untrusted.limits import check_file, open_file
from gsrain_engine.untrusted.printable import printable

THREADS = 2
"""Fixed, so that sums are taken in the same order on every run; what is more goes to pictures side by side."""

MOST_SIDE_PX = 8192
"""Of the picture that a network takes."""

_POINTER = b"version https://git-lfs"
"""How a file begins that Git has not fetched."""


@dataclass(frozen=True, slots=True, eq=False)
class OnnxModel:
    """A network with one input (1, 3, height, width) of floats."""

    path: Path
    input_name: str
    width: int | None
    """In pixels; None where the file leaves it open."""
    height: int | None
    output_shapes: tuple[tuple[int | None, ...], ...]
    """None where the file leaves an axis open."""
    metadata: Mapping[str, str]
    _session: Any = field(repr=False)
    _kind: type[np.floating[Any]] = np.float32

    @property
    def class_names(self) -> tuple[str, ...] | None:
        """Classes as exports of ultralytics name them in the metadata; None where there are none."""
        try:
            names = ast.literal_eval(self.metadata.get("names", ""))
        except (ValueError, SyntaxError, RecursionError, MemoryError):
            return None
        if isinstance(names, dict) and set(names) == set(range(len(names))):
            names = [names[number] for number in range(len(names))]
        return tuple(map(str, names)) if isinstance(names, list) and names else None

    def run(self, picture: Float32[np.ndarray, "1 3 h w"]) -> tuple[Float32[np.ndarray, "..."], ...]:
        """What the network gives. Raises ValueError where it fails, or gives what is no finite number."""
        try:
            outputs = self._session.run(None, {self.input_name: picture.astype(self._kind, copy=False)})
        except Exception as error:  # onnxruntime's errors share no base but this
            raise ValueError(f"{self.path}: fails on a picture: {_first_line(error)}") from None
        for output in outputs:
            if not isinstance(output, np.ndarray) or output.dtype.kind not in "fiu":
                raise ValueError(f"{self.path}: gives something other than tables of numbers")
            if not np.isfinite(output).all():
                raise ValueError(
                    f"{self.path}: gives NaN or infinity; the file is damaged, or its input is described wrong"
                )
        return tuple(output.astype(np.float32, copy=False) for output in outputs)


def open_onnx(path: Path) -> OnnxModel:
    """Open a file for the processor. Raises ValueError with one sentence where it is no network of one picture.

    Raises ModuleNotFoundError with what to install where onnxruntime is missing.
    """
    try:
        import onnxruntime
    except ModuleNotFoundError:
        raise ModuleNotFoundError("detectors need onnxruntime: pip install 'gsrain[evaluate]'") from None
    if not path.exists():
        raise ValueError(f"{path}: no such file")
    check_file(path)
    if path.suffix in (".pt", ".pth"):
        raise ValueError(f"{path}: weights of PyTorch; export them first (yolo export model={path.name} format=onnx)")
    try:
        session = onnxruntime.InferenceSession(
            str(path), _options(onnxruntime), providers=["CPUExecutionProvider"], enable_fallback=0
        )  # with a fallback it prints what goes wrong, and tries the same again
        # Words are only read when they are asked for: all of them here, where those that are no words are damage.
        inputs = [(str(each.name), str(each.type), each.shape) for each in session.get_inputs()]
        outputs = [_shape(each.shape) for each in session.get_outputs()]
        metadata = dict(session.get_modelmeta().custom_metadata_map)
    except Exception as error:  # onnxruntime's errors share no base but this
        raise ValueError(f"{path}: not an ONNX file that onnxruntime opens: {_cause(path, error)}") from None
    kinds = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
    name, kind, axes = inputs[0] if len(inputs) == 1 else ("", "", ())
    shape = _shape(axes)
    if kind not in kinds or len(shape) != 4 or shape[0] not in (1, None) or shape[1] != 3:
        given = printable(", ".join(" ".join(map(str, each)) for each in inputs)) or "nothing"
        raise ValueError(f"{path}: takes {given}; a detector takes one picture of floats (1, 3, height, width)")
    if max(shape[2] or 0, shape[3] or 0) > MOST_SIDE_PX:
        raise ValueError(f"{path}: takes a picture of {shape[3]} x {shape[2]} px; at most {MOST_SIDE_PX} px a side")
    return OnnxModel(
        path=path,
        input_name=name,
        width=shape[3],
        height=shape[2],
        output_shapes=tuple(outputs),
        metadata=metadata,
        _session=session,
        _kind=kinds[kind],
    )


def _options(onnxruntime: Any) -> Any:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = THREADS
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    options.log_severity_level = 4  # what goes wrong is raised and said once, not written to the terminal as well
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return options


def _shape(axes: Any) -> tuple[int | None, ...]:
    return tuple(axis if isinstance(axis, int) and axis > 0 else None for axis in axes or ())


def _cause(path: Path, error: Exception) -> str:
    with open_file(path) as file:
        pointer = file.read(len(_POINTER)) == _POINTER
    return "it only points to one (git lfs pull fetches it)" if pointer else _first_line(error)


def _first_line(error: Exception) -> str:
    return printable((str(error).strip().splitlines() or [type(error).__name__])[0][:300])
