"""Reads pickles from strangers: numbers, lists, NumPy arrays and PyTorch tensors of numbers come out, and nothing runs.

A pickle is a program; what it calls is looked up here in a short list of stand-ins, none of which is NumPy's, PyTorch's
or Python's own.
"""

import io
import pickle
import pickletools
import warnings
from collections.abc import Callable
from typing import Any

from .pickled_arrays import NUMPY_NAMES, PickledArray, text
from .pickled_tensors import TORCH_NAMES, PickledTensor

_MOST_MEMOS = 100_000
_STEPS = """
PROTO FRAME STOP MARK POP POP_MARK DUP PUT BINPUT LONG_BINPUT MEMOIZE GET BINGET LONG_BINGET
NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 LONG4 FLOAT BINFLOAT
STRING BINSTRING SHORT_BINSTRING UNICODE SHORT_BINUNICODE BINUNICODE BINUNICODE8
BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8
EMPTY_LIST LIST APPEND APPENDS EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 GLOBAL STACK_GLOBAL REDUCE BUILD
"""
_OPCODES = frozenset(_STEPS.split())
"""What arrays and lists of numbers are made of. Dictionaries and sets are not: a key that is nested deeply enough
overflows the stack when it is hashed."""


def read_plain_pickle(data: bytes) -> Any:
    """Unpickle plain values, and arrays and tensors of numbers, the latter as arrays.

    Raises ValueError, with what is wrong in a clause, for anything else; nothing that a pickle names is ever called.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of escapes that are none, in texts of protocol 0
            _check_steps(data)
            return _plain(_PlainUnpickler(io.BytesIO(data)).load())
    except (pickle.UnpicklingError, ValueError) as problem:
        raise ValueError(str(problem) or "it is no pickle") from None
    except (ArithmeticError, AttributeError, EOFError, LookupError, MemoryError, RecursionError, TypeError) as problem:
        raise ValueError(f"it is damaged ({type(problem).__name__})") from None


class _PlainUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str, /) -> Any:
        if (module, name) not in _STAND_INS:
            raise pickle.UnpicklingError(f"it names {f'{module}.{name}'[:80]}, which is not let in")
        return _STAND_INS[module, name]


def _check_steps(data: bytes) -> None:
    """Walk through a stream without doing what it says: lengths that lie and huge memos end here, not in memory."""
    last = 0
    for opcode, argument, place in pickletools.genops(data):
        if opcode.name not in _OPCODES:
            raise ValueError(f"it does {opcode.name}, which no plan needs")
        if opcode.name in ("PUT", "BINPUT", "LONG_BINPUT") and int(argument or 0) > _MOST_MEMOS:
            raise ValueError("it remembers too much")
        last = place or 0
    if last + 1 != len(data):
        raise ValueError("something follows after its end")


class _Named:
    """What a name in a pickle stands for: it can be called, and can't be changed."""

    __slots__ = ("_make",)

    def __init__(self, make: Callable[..., Any]) -> None:
        self._make = make

    def __call__(self, *arguments: Any) -> Any:
        return self._make(*arguments)

    def __setstate__(self, state: Any) -> None:
        raise ValueError("it writes into a name")


def _bytes_of(word: Any, *_: Any) -> bytes:
    """Bytes as Python 2's protocols write them: `_codecs.encode(text, "latin1")`."""
    return text(word).encode("latin1")


def _same_bytes(data: Any = b"", *_: Any) -> bytes:
    if not isinstance(data, bytes | bytearray):
        raise ValueError("it makes bytes of something else")
    return bytes(data)


_NAMES = {
    ("_codecs", "encode"): _bytes_of,
    ("builtins", "bytearray"): _same_bytes,
    ("builtins", "bytes"): _same_bytes,
    **NUMPY_NAMES,
    **TORCH_NAMES,
}
_STAND_INS = {name: _Named(make) for name, make in _NAMES.items()}


def _plain(value: Any) -> Any:
    """Turn stand-ins into what they stand for, at the top and in sequences: a message of ours goes no deeper."""
    if isinstance(value, PickledArray | PickledTensor):
        return _checked(value)
    if isinstance(value, list | tuple):
        return [_row(row) for row in _short(value)]  # pyright: ignore[reportUnknownArgumentType]
    return value


def _row(row: Any) -> Any:
    if isinstance(row, list | tuple):
        return [_checked(each) for each in _short(row)]  # pyright: ignore[reportUnknownArgumentType]
    return _checked(row)


def _checked(value: Any) -> Any:
    if not isinstance(value, PickledArray | PickledTensor):
        return value
    array = value.real()
    return array.item() if array.ndim == 0 else array


def _short(values: list[Any] | tuple[Any, ...]) -> list[Any] | tuple[Any, ...]:
    if len(values) > 10_000:
        raise ValueError(f"it holds a list of {len(values)}")
    return values
