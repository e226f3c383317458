"""NumPy arrays of numbers out of somebody's pickle, put together by ourselves from shape, type and bytes."""

import math
from operator import index
from typing import Any

import numpy as np

_DTYPES = {f"{kind}{size}" for kind in "iu" for size in (1, 2, 4, 8)} | {"f2", "f4", "f8"}
_MOST_ITEMS, _MOST_AXES = 1_000_000, 8


class PickledType:
    """Stands for `numpy.dtype`."""

    __slots__ = ("_order", "_spec")

    def __init__(self, spec: Any, *_: Any) -> None:
        self._spec, self._order = text(spec), ""

    def __setstate__(self, state: Any) -> None:
        self._order = text(state[1])

    def real(self) -> np.dtype[Any]:
        """Return the type; raises ValueError for one that is not of numbers."""
        spec = self._spec.lstrip("<>=|")
        if spec not in _DTYPES:
            raise ValueError(f"it holds an array of {self._spec[:20]}, not of numbers")
        order = self._order or self._spec[:1]
        return np.dtype(spec).newbyteorder(">" if order == ">" else "<")


class PickledArray:
    """Stands for `numpy.ndarray`: in the making while the stream is read, looked at only afterwards."""

    __slots__ = ("_dtype", "_fortran", "_raw", "_shape")

    def __init__(self, shape: Any = (), dtype: Any = None, raw: Any = b"", fortran: Any = False) -> None:
        self._shape, self._dtype, self._raw, self._fortran = shape, dtype, raw, fortran

    def __setstate__(self, state: Any) -> None:
        self._shape, self._dtype, self._fortran, self._raw = state[-4:]

    def real(self) -> np.ndarray:
        """Return the array; raises ValueError where shape, type and bytes don't fit together."""
        if not isinstance(self._raw, bytes | bytearray):
            raise ValueError("it holds an array without bytes")
        dtype = (self._dtype if isinstance(self._dtype, PickledType) else PickledType(self._dtype)).real()
        shape = checked_shape(self._shape)
        if math.prod(shape) * dtype.itemsize != len(self._raw):
            raise ValueError(f"it holds an array of shape {shape} in {len(self._raw)} bytes")
        flat = np.frombuffer(bytes(self._raw), dtype)
        return flat.reshape(shape, order="F" if self._fortran else "C").astype(dtype.newbyteorder("="))


def checked_shape(shape: Any) -> tuple[int, ...]:
    """Return a shape that memory has room for; raises ValueError for any other."""
    if len(shape) > _MOST_AXES:
        raise ValueError(f"it holds an array of {len(shape)} axes")
    sides = tuple(index(each) for each in shape)
    if min(sides, default=0) < 0 or math.prod(sides) > _MOST_ITEMS:
        raise ValueError(f"it holds an array of shape {sides}"[:100])
    return sides


def text(value: Any) -> str:
    """Return a word as it is; raises ValueError for anything else."""
    if not isinstance(value, str):
        raise ValueError("it has something else where a word belongs")
    return value


def _made(shape: Any = (), dtype: Any = "f8", raw: Any = b"") -> PickledArray:
    return PickledArray(shape, dtype, raw)


def _empty(*_: Any) -> PickledArray:
    return PickledArray()


def _scalar(dtype: Any, raw: Any = b"") -> PickledArray:
    return PickledArray((), dtype, raw)


def _from_buffer(raw: Any, dtype: Any, shape: Any, order: Any = "C") -> PickledArray:
    return PickledArray(shape, dtype, raw, order == "F")


NUMPY_NAMES = {
    ("numpy", "ndarray"): _made,
    ("numpy", "dtype"): PickledType,
    **{
        (f"numpy.{core}.{module}", name): make
        for core in ("core", "_core")
        for module, name, make in (
            ("multiarray", "_reconstruct", _empty),
            ("multiarray", "scalar", _scalar),
            ("numeric", "_frombuffer", _from_buffer),
        )
    },
}
"""What NumPy's pickles call, by module and name: those of NumPy 1 and 2, of all protocols."""
