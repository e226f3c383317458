"""Headers of NumPy's array files (.npy) of strangers: which array they speak of, before memory is taken for it."""

import math
import tokenize
import warnings
from typing import Any, Protocol, runtime_checkable

import numpy as np

_VERSIONS = ((1, 0), (2, 0), (3, 0))
_DAMAGES = (
    ArithmeticError, EOFError, LookupError, MemoryError, RecursionError, SyntaxError, TypeError, ValueError,
    tokenize.TokenError,
)  # fmt: skip
"""What NumPy raises over damaged headers: it takes them for Python."""


@runtime_checkable
class Readable(Protocol):
    """What NumPy needs of a file."""

    def read(self, size: int = ..., /) -> bytes:
        """Read so many bytes, or fewer at the end."""
        ...


def read_array_header(stream: Readable, kinds: str = "fiub") -> tuple[tuple[int, ...], bool, "np.dtype[Any]"]:
    """Read shape, whether columns come first (Fortran's order), and type; the numbers are what comes next.

    Raises ValueError, with what is wrong in a clause, for anything but an array of plain numbers, or of what other
    `kinds` NumPy's letters stand for.
    """
    try:
        version = np.lib.format.read_magic(stream)
        if version not in _VERSIONS:
            raise ValueError(f"version {version[0]}.{version[1]} of NumPy's format is not known")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's words about how the header was written
            shape, is_fortran, dtype = read(stream)
    except _DAMAGES as error:
        words = str(error).strip().splitlines()
        raise ValueError(words[0] if words else f"its header is damaged ({type(error).__name__})") from None
    if dtype.kind not in kinds:
        raise ValueError(f"holds {dtype}, not real numbers")
    if any(side < 0 for side in shape):
        raise ValueError(f"an array of the shape {shape} can't be")
    return shape, is_fortran, dtype


def array_bytes(shape: tuple[int, ...], dtype: "np.dtype[Any]") -> int:
    return math.prod(shape) * dtype.itemsize
