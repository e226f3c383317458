"""Safe reader for pickles of plain values and NumPy arrays.

A check of all instructions precedes unpickling, because Python allocates memory for any claimed length.
"""

import io
import pickle
import pickletools
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Int64

from ...kernels import kernel
from ...safe_io.text_files import printable_line
from ..capture import CaptureError
from .arrays import read_bytes

_MAX_BYTES = 8 << 30


def read_pickle(file: Path) -> Any:
    """Read a pickle of builtin containers, numbers, strings and NumPy arrays; `CaptureError` for any other."""
    content = read_bytes(file, _MAX_BYTES)
    fault = int(_walk(np.frombuffer(content, np.uint8), _LENGTHS))
    if fault >= 0:
        raise CaptureError(f"{file}: not a readable pickle (damaged or cut off at byte {fault} of {len(content)})")
    try:
        return _PlainValues(io.BytesIO(content)).load()
    except pickle.UnpicklingError as error:
        raise CaptureError(f"{file}: {error}") from None
    except RecursionError:
        raise CaptureError(f"{file}: not a readable pickle (too deep)") from None
    except Exception as error:  # damaged pickles raise different exceptions for each instruction
        raise CaptureError(f"{file}: not a readable pickle ({type(error).__name__}: {error})") from None


# Instructions

_LINE, _TWO_LINES, _LENGTH_1, _LENGTH_4, _LENGTH_8, _UNKNOWN = -1, -2, -3, -4, -5, -6
"""Special lengths of an instruction's argument: one or two lines, or given by a length of 1, 4 or 8 bytes."""

_LINES = {b"c", b"i"}  # instructions with two lines
_STOP, _PUT, _BINPUT, _LONG_BINPUT = (code[0] for code in (pickle.STOP, pickle.PUT, pickle.BINPUT, pickle.LONG_BINPUT))


def _lengths() -> Int64[np.ndarray, "256"]:
    lengths = np.full(256, _UNKNOWN, np.int64)
    named = {pickletools.UP_TO_NEWLINE: _LINE, pickletools.TAKEN_FROM_ARGUMENT1: _LENGTH_1}
    named |= {pickletools.TAKEN_FROM_ARGUMENT4: _LENGTH_4, pickletools.TAKEN_FROM_ARGUMENT4U: _LENGTH_4}
    named |= {pickletools.TAKEN_FROM_ARGUMENT8U: _LENGTH_8}
    for each in pickletools.opcodes:
        code = each.code.encode("latin-1")
        argument: Any = each.arg
        size = 0 if argument is None else int(argument.n)
        lengths[code[0]] = _TWO_LINES if code in _LINES else named.get(size, size)
    return lengths


_LENGTHS = _lengths()


@kernel()
@no_type_check
def _walk(content, lengths):
    """Position of the first instruction that is invalid or claims too much memory; -1 if there is none up to STOP.

    Compares lengths with the rest of the file, and memo indices, up to which Python allocates, with the instruction
    count.
    """
    at, count, size = 0, 0, content.size
    while at < size:
        start, code = at, content[at]
        at, count = at + 1, count + 1
        if code == _STOP:
            return -1
        length = lengths[code]
        if length == _UNKNOWN:
            return start
        if length >= 0:
            if code in (_BINPUT, _LONG_BINPUT) and at + length <= size and _number(content, at, length) > count:
                return start
            at += length
        elif length in (_LINE, _TWO_LINES):
            number = 0
            for _ in range(-length):
                while at < size and content[at] != 10:
                    if 48 <= content[at] <= 57 and number < 1 << 50:
                        number = 10 * number + (content[at] - 48)
                    at += 1
                at += 1
            if code == _PUT and number > count:
                return start
        else:
            width = 1 if length == _LENGTH_1 else 4 if length == _LENGTH_4 else 8
            if at + width > size:
                return start
            wanted = _number(content, at, width)
            at += width
            if wanted < 0 or wanted > size - at:
                return start
            at += wanted
        if at > size:
            return start
    return size


@kernel()
@no_type_check
def _number(content, at, width):
    """Little-endian number; negative if it exceeds any possible file size."""
    number = 0
    for k in range(width):
        if k == 7 and content[at + k] > 127:
            return -1
        number |= np.int64(content[at + k]) << (8 * k)
    return number


# Values


class _PlainValues(pickle.Unpickler):
    """Unpickler limited to the names that arrays and containers need, with checks of their arguments."""

    def find_class(self, module: str, name: str, /) -> Any:
        found = _ALLOWED.get((_OLD_MODULES.get(module, module).replace("numpy._core", "numpy.core"), name))
        if found is None:
            asked = f"it asks for {printable_line(f'{module}.{name}')}"
            raise pickle.UnpicklingError(f"refused, for {asked}; a file of data holds plain values and NumPy arrays")
        return found

    def persistent_load(self, pid: Any, /) -> Any:
        raise pickle.UnpicklingError("refused, for it points to things outside itself")


class _PlainArray(np.ndarray):
    """Array that accepts numbers only of NumPy's own types, because pickles can build types field by field."""

    def __new__(cls, *_: Any) -> "_PlainArray":
        """Refuse: NumPy's pickles begin with an empty array and fill it."""
        raise pickle.UnpicklingError("refused, for an array in it is not built as NumPy does")

    def __setstate__(self, state: Any, /) -> None:
        _, _, kind, _, _ = state
        _check_plain(kind)
        super().__setstate__(state)


def _check_plain(kind: Any) -> None:
    """Refuse types with fields, whose offsets may be forged, and types with a forged object flag."""
    if not isinstance(kind, np.dtype) or kind.kind == "V" or kind.hasobject != (kind.kind == "O"):
        raise pickle.UnpicklingError("refused, for an array in it is of another kind than plain numbers, text, objects")


def _dtype(*arguments: Any) -> np.dtype[Any]:
    """Create a type; a function instead of NumPy's class, from which pickles could create others."""
    return np.dtype(*arguments)


def _empty_array(kind: Any, shape: Any, _code: Any) -> np.ndarray:
    """Replace NumPy's own function, which would allocate an array of any shape."""
    if kind is not _PlainArray or tuple(shape) != (0,):
        raise pickle.UnpicklingError("refused, for an array in it is not built as NumPy does")
    return np.ndarray.__new__(_PlainArray, (0,), np.int8)


def _array_of_bytes(content: Any, kind: Any, shape: Any, order: Any, *_: Any) -> np.ndarray:
    _check_plain(kind)
    return np.frombuffer(content, kind).reshape(shape, order=order)


def _scalar(kind: Any, content: Any = b"") -> Any:
    _check_plain(kind)
    if not isinstance(content, bytes) or len(content) != kind.itemsize:
        raise pickle.UnpicklingError("refused, for a number in it is not stored as NumPy does")
    return np.frombuffer(content, kind)[0]


def _latin1(text: Any, encoding: Any = "latin1") -> bytes:
    """Bytes as encoded by Python 2's protocols."""
    if encoding not in ("latin1", "latin-1"):
        raise pickle.UnpicklingError(f"refused, for it asks for the encoding {encoding!r}")
    return str(text).encode("latin1")


def _bytes(*content: Any) -> bytes:
    """Bytes from bytes; a number would allocate that many zeros."""
    if content and not isinstance(content[0], bytes):
        raise pickle.UnpicklingError("refused, for bytes in it are not stored as Python does")
    return bytes(content[0]) if content else b""


_ALLOWED: dict[tuple[str, str], type | Callable[..., Any]] = {
    ("numpy", "ndarray"): _PlainArray,
    ("numpy", "dtype"): _dtype,
    ("numpy.core.multiarray", "_reconstruct"): _empty_array,
    ("numpy.core.multiarray", "scalar"): _scalar,
    ("numpy.core.numeric", "_frombuffer"): _array_of_bytes,
    ("_codecs", "encode"): _latin1,
    ("collections", "OrderedDict"): OrderedDict,
    **{("builtins", kind.__name__): kind for kind in (complex, dict, frozenset, list, set, slice, tuple)},
    ("builtins", "bytes"): _bytes,
    ("builtins", "bytearray"): _bytes,
}

_OLD_MODULES = {"__builtin__": "builtins"}
