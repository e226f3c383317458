import builtins
import pickle
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.io.safe_pickle import read_pickle


class _Asks:
    """Unpickles to a call of a function."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> Any:
        return self.call


def _written(folder: Path, content: bytes) -> Path:
    file = folder / "table.pkl"
    file.write_bytes(content)
    return file


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_reads_plain_values_and_arrays(tmp_path: Path, protocol: int) -> None:
    values = {
        "numbers": [1, 2.5, None, True, 10**30],
        "array": np.arange(6, dtype=np.float32).reshape(2, 3),
        "turned": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "names": np.array(["car", "bus"]),
        "objects": np.array([{"a": 1}, "b"], dtype=object),
        "scalar": np.float64(3.25),
        "count": np.int64(7),
        "set": {1, 2},
        "ordered": OrderedDict(a=1),
        "bytes": b"\x00\xff",
        "empty": np.zeros((0, 7)),
    }
    found = read_pickle(_written(tmp_path, pickle.dumps(values, protocol)))
    assert found.keys() == values.keys()
    for name, value in values.items():
        np.testing.assert_array_equal(found[name], value)
    assert found["array"].dtype == np.float32


@pytest.mark.parametrize(
    ("what", "named"),
    [
        (_Asks(builtins.eval, "1 + 1"), "builtins.eval"),
        (_Asks(builtins.open, "never"), "io.open"),
        (_Asks(getattr, "x", "upper"), "builtins.getattr"),
        (_Asks(np.load, "x.npy"), "numpy.load"),
        (Path("x"), "pathlib"),
    ],
)
def test_refuses_anything_that_runs(tmp_path: Path, what: Any, named: str) -> None:
    with pytest.raises(CaptureError, match=rf"table\.pkl: refused, for it asks for {named}"):
        read_pickle(_written(tmp_path, pickle.dumps([1, what])))


def test_what_is_refused_does_not_run(tmp_path: Path) -> None:
    made = tmp_path / "made"
    with pytest.raises(CaptureError, match="refused"):
        read_pickle(_written(tmp_path, b"cos\nmkdir\n(V" + str(made).encode() + b"\ntR."))
    assert not made.exists()


def test_an_array_that_lies_about_its_size_takes_no_memory(tmp_path: Path) -> None:
    reconstruct = np.zeros(1).__reduce__()[0]
    for shape in ((1 << 40,), (2, 1 << 40)):
        with pytest.raises(CaptureError, match="not built as NumPy does"):
            read_pickle(_written(tmp_path, pickle.dumps(_Asks(reconstruct, np.ndarray, shape, b"b"))))


class _Forged:
    """Unpickles to what a function makes, with a state of its own."""

    def __init__(self, function: Any, arguments: tuple[Any, ...], state: tuple[Any, ...]) -> None:
        self.reduced = (function, arguments, state)

    def __reduce__(self) -> Any:
        return self.reduced


def _array_of(kind: Any, content: Any) -> _Forged:
    return _Forged(np.zeros(1).__reduce__()[0], (np.ndarray, (0,), b"b"), (1, (1,), kind, False, content))


@pytest.mark.parametrize(
    ("code", "state"),
    [
        ("V8", (3, "|", None, ("a",), {"a": (np.dtype("f8"), 10**6)}, 8, 1, 0)),  # a field outside of the array
        ("V8", (3, "|", None, ("a",), {"a": (np.dtype("O"), 0)}, 8, 1, 0)),  # numbers taken for objects
        ("V8", (3, "|", (np.dtype("f8"), (1000,)), None, None, 8, 1, 0)),
        ("O", (3, "|", None, None, None, -1, -1, 0)),
        ("f8", (3, "<", None, None, None, -1, -1, 63)),
    ],
)
def test_a_type_that_lies_about_memory_is_refused(tmp_path: Path, code: str, state: tuple[Any, ...]) -> None:
    kind = _Forged(np.dtype, (code, False, True), state)
    for forged in (
        _array_of(kind, b"A" * 8),
        _Asks(np.float64(1).__reduce__()[0], kind, b"A" * 8),
        _Asks(np.ndarray, (1,), kind),
    ):
        with pytest.raises(CaptureError, match=r"table\.pkl: refused, for an array in it"):
            read_pickle(_written(tmp_path, pickle.dumps(forged)))


def test_a_cut_pickle_is_named(tmp_path: Path) -> None:
    content = pickle.dumps({"array": np.arange(50), "name": "x" * 40})
    for length in range(0, len(content) - 1, 7):
        with pytest.raises(CaptureError, match=r"table\.pkl"):
            read_pickle(_written(tmp_path, content[:length]))
