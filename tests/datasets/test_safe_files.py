"""Pickles that only hold values, and TFRecords with their checksums: what runs, lies or is damaged is refused."""

import builtins
import pickle
import struct
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fuzz.reader import limited_memory
from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.io.records import masked_crc32c, records_in
from gsrain_engine.datasets.io.safe_pickle import read_pickle
from tfrecord_framing import framed


def read_bytes(folder: Path, content: bytes) -> Any:
    (folder / "table.pkl").write_bytes(content)
    return read_pickle(folder / "table.pkl")


class Reduced:
    """Unpickles to a call of a function, with a state of its own."""

    def __init__(self, *parts: Any) -> None:
        self.parts = parts

    def __reduce__(self) -> Any:
        return self.parts


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_values_and_arrays_are_read(tmp_path: Path, protocol: int) -> None:
    values = {
        "numbers": [1, 2.5, None, True, 10**400, *range(3000)],
        "array": np.arange(6, dtype=np.float32).reshape(2, 3),
        "turned": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "names": np.array(["car", "bus"]),
        "objects": np.array([{"a": 1}, "b"], dtype=object),
        "scalar": np.float64(3.25),
        "count": np.int64(7),
        "set": {1, 2},
        "ordered": OrderedDict(a=1),
        "bytes": b"\x00\xff" * 150,
        "text": "x" * 70_000,
        "empty": np.zeros((0, 7)),
    }
    found = read_bytes(tmp_path, pickle.dumps(values, protocol))
    assert found.keys() == values.keys()
    for name, value in values.items():
        np.testing.assert_array_equal(found[name], value)
    assert found["array"].dtype == np.float32


@pytest.mark.parametrize(
    ("content", "function"),
    [
        (Reduced(builtins.eval, ("1 + 1",)), "builtins.eval"),
        (Reduced(builtins.open, ("never",)), "_?io.open"),
        (Reduced(getattr, ("x", "upper")), "builtins.getattr"),
        (Reduced(np.load, ("x.npy",)), "numpy.load"),
        (Path("x"), "pathlib"),
    ],
)
def test_whatever_runs_is_refused_and_does_not_run(tmp_path: Path, content: Any, function: str) -> None:
    with pytest.raises(CaptureError, match=rf"table\.pkl: refused, for it asks for {function}"):
        read_bytes(tmp_path, pickle.dumps([1, content]))
    made = tmp_path / "made"
    with pytest.raises(CaptureError, match="refused"):
        read_bytes(tmp_path, b"cos\nmkdir\n(V" + str(made).encode() + b"\ntR.")
    assert not made.exists()


RECONSTRUCT = np.zeros(1).__reduce__()[0]


def test_an_array_that_lies_about_its_size_takes_no_memory(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="not built as NumPy does"):
        read_bytes(tmp_path, pickle.dumps(Reduced(RECONSTRUCT, (np.ndarray, (1 << 40,), b"b"))))


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
    kind = Reduced(np.dtype, (code, False, True), state)
    for forged in (
        Reduced(RECONSTRUCT, (np.ndarray, (0,), b"b"), (1, (1,), kind, False, b"A" * 8)),
        Reduced(np.float64(1).__reduce__()[0], (kind, b"A" * 8)),
        Reduced(np.ndarray, ((1,), kind)),
    ):
        with pytest.raises(CaptureError, match=r"table\.pkl: refused, for an array in it"):
            read_bytes(tmp_path, pickle.dumps(forged))


@pytest.mark.parametrize(
    "content",
    [
        b"\x80\x02K\x01r\xff\xff\xff\xff.",  # a place in the memo far beyond those before: 64 GB in Python's own reader
        b"I1\np4000000000\n.",
        b"\x80\x05\x96" + struct.pack("<Q", 1 << 40) + b"a.",
        b"\x80\x04\x8e" + struct.pack("<Q", 1 << 63) + b"a.",
        b"\x80\x02T\xff\xff\xff\xffa.",
        b"\x80\x02]q\x00",
        *(pickle.dumps({"array": np.arange(50), "name": "x" * 40})[:length] for length in range(0, 400, 37)),
    ],
)
def test_pickles_that_are_cut_or_ask_for_more_than_there_is(content: bytes, tmp_path: Path) -> None:
    with limited_memory(), pytest.raises(CaptureError, match=r"table\.pkl: not a readable pickle"):
        read_bytes(tmp_path, content)


# TFRecord


def test_the_checksum_is_that_of_the_standard() -> None:
    # RFC 3720, B.4: CRC-32C of 32 zeros and of 32 ones; and the common check value of "123456789".
    for content, crc in ((bytes(32), 0x8A9136AA), (b"\xff" * 32, 0x62A8AB43), (b"123456789", 0xE3069283)):
        masked = (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF
        assert masked_crc32c(content) == masked


def test_records_come_back_and_every_damage_is_named(tmp_path: Path) -> None:
    file = tmp_path / "some.tfrecord"
    contents = [b"one", b"", bytes(range(256)) * 40]
    file.write_bytes(b"".join(framed(each) for each in contents))
    found = list(records_in(file))
    assert [content for _, content in found] == [record.read() for record, _ in found] == contents
    whole = framed(b"first record") + framed(b"second")
    damaged = [whole[:k] + bytes([whole[k] ^ 16]) + whole[k + 1 :] for k in range(len(whole))]
    damaged += [whole[:length] for length in range(1, len(whole)) if length != len(framed(b"first record"))]
    for content in damaged:
        file.write_bytes(content)
        with pytest.raises(CaptureError, match=r"some\.tfrecord"):
            list(records_in(file))
