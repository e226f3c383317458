"""Untrusted NumPy files (.npz, .npy): sizes are checked before allocation, and pickles are refused."""

import math
import os
import tokenize
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from .limits import check_expansion, open_file

_MAX_BYTES = 8 << 30
_SUFFIX = ".npy"
_KINDS = "fiubU"  # kinds of numbers, and text for names

_HEADER_DAMAGES = (
    ArithmeticError, EOFError, LookupError, MemoryError, RecursionError, SyntaxError, TypeError, ValueError,
    tokenize.TokenError,
)  # fmt: skip
"""Exceptions of NumPy for damaged headers, which it parses as Python."""

DAMAGES = (*_HEADER_DAMAGES, NotImplementedError, OSError, RuntimeError, zipfile.BadZipFile, zlib.error)
"""Exceptions of zipfile and NumPy for damaged archives."""


def read_archive(path: Path, most_bytes: int = _MAX_BYTES) -> dict[str, np.ndarray]:
    """Read all arrays of an archive by name.

    Raises FileNotFoundError; ValueError with the reason if the archive is damaged, needs more memory than `most_bytes`,
    declares a wrong size, or holds objects.
    """
    with open_file(path) as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                members = archive.infolist()
                if (size := sum(each.file_size for each in members)) > most_bytes:
                    raise ValueError(f"it holds more than {most_bytes / 1e9:g} GB")
                check_expansion(path, size, stream.seek(0, os.SEEK_END), is_uniform=True)
                return {each.filename.removesuffix(_SUFFIX): read_member(archive, each, _KINDS) for each in members}
        except DAMAGES as error:
            raise ValueError(_reason(error, "it")) from None


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, kinds: str = "fiub") -> np.ndarray:
    """Read an array whose header agrees with its length: NumPy would allocate whatever a header declares.

    Raises ValueError if it does not agree or is not of `kinds`, and the other exceptions in `DAMAGES`.
    """
    name = member.filename
    with archive.open(member) as stream:
        shape, is_fortran, dtype = read_array_header(stream, kinds)
        wanted = array_bytes(shape, dtype)
        if wanted > member.file_size:
            raise ValueError(f"{name}: an array of {dtype} {shape} in {member.file_size} bytes")
        data = stream.read(wanted + 1)
    if len(data) != wanted:
        raise ValueError(f"{name}: an array of {dtype} {shape} in {len(data)} bytes")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if is_fortran else "C").copy()


# Array headers (.npy)

_VERSIONS = ((1, 0), (2, 0), (3, 0))


@runtime_checkable
class Readable(Protocol):
    """File interface that NumPy needs."""

    def read(self, size: int = ..., /) -> bytes:
        """Read up to `size` bytes; fewer at the end only."""
        ...


def read_array_header(stream: Readable, kinds: str = "fiub") -> tuple[tuple[int, ...], bool, "np.dtype[Any]"]:
    """Read shape, order (true if column-major, Fortran) and type of an array; the numbers follow in the stream.

    Raises ValueError, with the reason in a clause, for anything but an array of the `kinds` (NumPy's letters).
    """
    try:
        version = np.lib.format.read_magic(stream)
        if version not in _VERSIONS:
            raise ValueError(f"version {version[0]}.{version[1]} of NumPy's format is not known")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings about the header's format version
            shape, is_fortran, dtype = read(stream)
    except _HEADER_DAMAGES as error:
        raise ValueError(_reason(error, "its header")) from None
    if dtype.kind not in kinds:
        raise ValueError(f"holds {dtype}, not real numbers")
    if any(side < 0 for side in shape):
        raise ValueError(f"an array of the shape {shape} can't be")
    return shape, is_fortran, dtype


def array_bytes(shape: tuple[int, ...], dtype: "np.dtype[Any]") -> int:
    return math.prod(shape) * dtype.itemsize


def _reason(error: BaseException, damaged: str) -> str:
    words = str(error).strip().splitlines()
    return words[0] if words else f"{damaged} is damaged ({type(error).__name__})"
