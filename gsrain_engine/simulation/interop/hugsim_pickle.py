"""Safe pickles for HUGSIM clients: writing for any NumPy version, and reading without running code.

NumPy 2 pickles arrays by a name in `numpy._core`, which NumPy 1 lacks, for example UniAD's numpy 1.22; written
pickles therefore use only names in `numpy`.
"""

# pyright: reportUnknownLambdaType=false
# The stand-ins take whatever a stranger's pickle passes.

import io
import math
import pickle
import pickletools
import warnings
from collections.abc import Callable
from operator import index
from typing import Any

import numpy as np


class _OldPickler(pickle.Pickler):
    def reducer_override(self, obj: Any, /) -> Any:
        if isinstance(obj, np.ndarray):
            if obj.dtype.hasobject:
                raise TypeError(f"an array of {obj.dtype} has no bytes to send")
            # A bytearray, not bytes, so that the array is writable.
            array: np.ndarray = np.ascontiguousarray(obj)
            return np.ndarray, (obj.shape, array.dtype.str, bytearray(array.data.cast("B") if array.size else b""))
        if isinstance(obj, np.generic):
            scalar = obj.item()
            return type(scalar), (scalar,)
        return NotImplemented


def old_pickle(value: Any) -> bytes:
    """Pickle plain values, arrays and scalars, as Python numbers. Raises TypeError for an array of objects."""
    stream = io.BytesIO()
    _OldPickler(stream, 4).dump(value)  # protocol 4 is that of Python 3.4, which all clients support
    return stream.getvalue()  # of the same memory; a view would have to be released before the stream


# NumPy arrays

_DTYPES = {f"{kind}{size}" for kind in "iu" for size in (1, 2, 4, 8)} | {"f2", "f4", "f8"}
_MAX_ITEMS, _MAX_AXES = 1_000_000, 8


class PickledType:
    """Stand-in for `numpy.dtype`."""

    __slots__ = ("_order", "_spec")

    def __init__(self, spec: Any, *_: Any) -> None:
        self._spec, self._order = text(spec), ""

    def __setstate__(self, state: Any) -> None:
        self._order = text(state[1])

    def real(self) -> np.dtype[Any]:
        """Return the type; raises ValueError for non-numeric types."""
        spec = self._spec.lstrip("<>=|")
        if spec not in _DTYPES:
            raise ValueError(f"it holds an array of {self._spec[:20]}, not of numbers")
        order = self._order or self._spec[:1]
        return np.dtype(spec).newbyteorder(">" if order == ">" else "<")


class PickledArray:
    """Stand-in for `numpy.ndarray`, evaluated after the stream has been read."""

    __slots__ = ("_dtype", "_fortran", "_raw", "_shape")

    def __init__(self, shape: Any = (), dtype: Any = None, raw: Any = b"", fortran: Any = False) -> None:
        self._shape, self._dtype, self._raw, self._fortran = shape, dtype, raw, fortran

    def __setstate__(self, state: Any) -> None:
        self._shape, self._dtype, self._fortran, self._raw = state[-4:]

    def real(self) -> np.ndarray:
        """Return the array; raises ValueError if shape, type and bytes do not match."""
        if not isinstance(self._raw, bytes | bytearray):
            raise ValueError("it holds an array without bytes")
        dtype = (self._dtype if isinstance(self._dtype, PickledType) else PickledType(self._dtype)).real()
        shape = checked_shape(self._shape)
        if math.prod(shape) * dtype.itemsize != len(self._raw):
            raise ValueError(f"it holds an array of shape {shape} in {len(self._raw)} bytes")
        flat = np.frombuffer(bytes(self._raw), dtype)
        return flat.reshape(shape, order="F" if self._fortran else "C").astype(dtype.newbyteorder("="))


def checked_shape(shape: Any) -> tuple[int, ...]:
    """Return a shape that fits into memory; raises ValueError for any other."""
    if len(shape) > _MAX_AXES:
        raise ValueError(f"it holds an array of {len(shape)} axes")
    lengths = tuple(index(each) for each in shape)
    if min(lengths, default=0) < 0 or math.prod(lengths) > _MAX_ITEMS:
        raise ValueError(f"it holds an array of shape {lengths}"[:100])
    return lengths


def text(value: Any) -> str:
    """Return a string unchanged; raises ValueError for anything else."""
    if not isinstance(value, str):
        raise ValueError("it has something else where a word belongs")
    return value


# PyTorch tensors
# Read without PyTorch, for VAD's client. A pickle holds the storage in the legacy `torch.save` format: five pickles,
# the number of values (64 bits), then the values.

_STORAGES = {
    "torch FloatStorage": "<f4", "torch DoubleStorage": "<f8", "torch HalfStorage": "<f2", "torch LongStorage": "<i8",
    "torch IntStorage": "<i4",
}  # fmt: skip

_PICKLES = 5  # pickles before the values: magic number, protocol, machine, storage description, storage keys


class PickledTensor:
    """Stand-in for `torch.Tensor`: a storage with strides, evaluated after the stream has been read."""

    __slots__ = ("_first", "_raw", "_shape", "_steps")

    def __init__(self, raw: Any, first: Any = 0, shape: Any = (), steps: Any = (), *_: Any) -> None:
        self._raw, self._first, self._shape, self._steps = raw, first, shape, steps

    def real(self) -> np.ndarray:
        """Return the tensor as an array; raises ValueError if it does not fit into its storage."""
        values = _storage_values(self._raw)
        shape, steps = checked_shape(self._shape), checked_shape(self._steps)
        if len(shape) != len(steps):
            raise ValueError("it holds a tensor with more axes than steps")
        places = np.full(shape, int(self._first), np.int64)
        for axis, (side, step) in enumerate(zip(shape, steps, strict=True)):
            along = [1] * len(shape)
            along[axis] = side
            places += (step * np.arange(side)).reshape(along)
        if places.size and not 0 <= places.min() <= places.max() < len(values):
            raise ValueError(f"it holds a tensor of shape {shape} in a storage of {len(values)}")
        return values[places]


def _storage_values(raw: Any) -> np.ndarray:
    """Return all values of a storage file without running anything in it."""
    if not isinstance(raw, bytes | bytearray):
        raise ValueError("it holds a tensor without a storage")
    stream, kinds = io.BytesIO(raw), set[str]()
    for _ in range(_PICKLES):
        for opcode, argument, _place in pickletools.genops(stream):
            if opcode.name == "GLOBAL":
                kinds.add(str(argument))
    if len(kinds) != 1 or not kinds <= set(_STORAGES):
        raise ValueError(f"it holds a tensor of {', '.join(sorted(kinds)) or 'nothing'}, not of numbers"[:120])
    dtype = np.dtype(_STORAGES[kinds.pop()])
    count = int.from_bytes(stream.read(8), "little")
    values = stream.read()
    if count * dtype.itemsize != len(values):
        raise ValueError(f"it holds a storage of {count} numbers in {len(values)} bytes")
    return np.frombuffer(values, dtype)


# Unpickler for untrusted data
# A pickle is a program; names that it calls resolve only to a short list of stand-ins, never to NumPy, PyTorch or
# Python functions.

_MAX_MEMOS = 100_000

_STEPS = """
PROTO FRAME STOP MARK POP POP_MARK DUP PUT BINPUT LONG_BINPUT MEMOIZE GET BINGET LONG_BINGET
NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 LONG4 FLOAT BINFLOAT
STRING BINSTRING SHORT_BINSTRING UNICODE SHORT_BINUNICODE BINUNICODE BINUNICODE8
BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8
EMPTY_LIST LIST APPEND APPENDS EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 GLOBAL STACK_GLOBAL REDUCE BUILD
"""

_OPCODES = frozenset(_STEPS.split())
"""Opcodes for arrays and lists of numbers. Dictionaries and sets are excluded, because hashing a deeply nested key
overflows the stack."""


def read_plain_pickle(data: bytes) -> Any:
    """Unpickle plain values, arrays, and tensors (as arrays) of numbers.

    Raises ValueError with the reason for anything else; functions named in the pickle are never called.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # invalid escapes in protocol 0 strings
            _check_steps(data)
            return _plain(_PlainUnpickler(io.BytesIO(data)).load())
    except (pickle.UnpicklingError, ValueError) as problem:
        raise ValueError(str(problem) or "it is no pickle") from None
    except (ArithmeticError, AttributeError, EOFError, LookupError, MemoryError, RecursionError, TypeError) as problem:
        raise ValueError(f"it is damaged ({type(problem).__name__})") from None


class _PlainUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str, /) -> Any:
        called = f"{module}.{name}"
        known = called.replace("numpy._core.", "numpy.core.")
        if known not in _STAND_INS:
            raise pickle.UnpicklingError(f"it names {called[:80]}, which is not let in")
        return _STAND_INS[known]


def _check_steps(data: bytes) -> None:
    """Scan a stream without executing it; rejects false lengths and huge memos before they use memory."""
    last = 0
    for opcode, argument, place in pickletools.genops(data):
        if opcode.name not in _OPCODES:
            raise ValueError(f"it does {opcode.name}, which no plan needs")
        if opcode.name in ("PUT", "BINPUT", "LONG_BINPUT") and int(argument or 0) > _MAX_MEMOS:
            raise ValueError("it remembers too much")
        last = place or 0
    if last + 1 != len(data):
        raise ValueError("something follows after its end")


class _Named:
    """Immutable, callable stand-in for a name in a pickle."""

    __slots__ = ("_make",)

    def __init__(self, make: Callable[..., Any]) -> None:
        self._make = make

    def __call__(self, *arguments: Any) -> Any:
        return self._make(*arguments)

    def __setstate__(self, state: Any) -> None:
        raise ValueError("it writes into a name")


def _same_bytes(data: Any = b"", *_: Any) -> bytes:
    if not isinstance(data, bytes | bytearray):
        raise ValueError("it makes bytes of something else")
    return bytes(data)


def _read_buffer(raw: Any, dtype: Any, shape: Any, order: Any = "C") -> PickledArray:
    return PickledArray(shape, dtype, raw, order == "F")


_NAMES: dict[str, Callable[..., Any]] = {
    "_codecs.encode": lambda word, *_: text(word).encode("latin1"),  # bytes of Python 2's protocols
    "builtins.bytearray": _same_bytes,
    "builtins.bytes": _same_bytes,
    "numpy.ndarray": lambda shape=(), dtype="f8", raw=b"": PickledArray(shape, dtype, raw),
    "numpy.dtype": PickledType,
    "numpy.core.multiarray._reconstruct": lambda *_: PickledArray(),
    "numpy.core.multiarray.scalar": lambda dtype, raw=b"": PickledArray((), dtype, raw),
    "numpy.core.numeric._frombuffer": _read_buffer,
    "torch._utils._rebuild_tensor_v2": PickledTensor,
    "torch.storage._load_from_bytes": lambda raw: raw,
    "collections.OrderedDict": lambda *_: None,  # backward hooks of tensors
}
"""Names that pickles of NumPy 1 and PyTorch call, in all protocols; NumPy 2 has `_core` for `core`."""

_STAND_INS = {name: _Named(make) for name, make in _NAMES.items()}


def _plain(value: Any, depth: int = 0) -> Any:
    """Replace stand-ins by their values, at the top level and in sequences; plans are not nested deeper."""
    if isinstance(value, PickledArray | PickledTensor):
        array = value.real()
        return array.item() if array.ndim == 0 else array
    if depth == 2 or not isinstance(value, list | tuple):
        return value
    values: list[Any] | tuple[Any, ...] = value
    if len(values) > 10_000:
        raise ValueError(f"it holds a list of {len(values)}")
    return [_plain(each, depth + 1) for each in values]
