"""NumPy and JSON files of datasets, checked before memory is allocated, so truncated or forged files cause no harm."""

import json
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from ...safe_io.limits import MAX_FILE_BYTES, InputError, check_expansion, open_file, read_file
from ...safe_io.numpy_files import DAMAGES, array_bytes, read_array_header, read_member
from ..capture import CaptureError


def read_floats(file: Path) -> Float32[np.ndarray, "..."]:
    """Read a .npy file of real numbers; raises `CaptureError` that names the file."""
    try:
        with open_file(file) as stream:
            shape, is_fortran, dtype = read_array_header(stream)
            wanted, left = array_bytes(shape, dtype), os.fstat(stream.fileno()).st_size - stream.tell()
            if wanted != left:
                raise ValueError(f"an array of {dtype} {shape} takes {wanted} bytes, {left} are there")
            numbers = np.frombuffer(stream.read(wanted), dtype)
    except InputError as error:
        raise CaptureError(str(error)) from None
    except (OSError, ValueError) as error:
        raise CaptureError(f"{file}: not a readable .npy file ({error})") from None
    with np.errstate(over="ignore", invalid="ignore"):  # values too large for 32 bits become infinite
        return np.array(numbers.reshape(shape, order="F" if is_fortran else "C"), np.float32, order="C")


def read_bytes(file: Path, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """Read a whole file; raises `CaptureError` that names it."""
    try:
        return read_file(file, max_bytes)
    except FileNotFoundError:
        raise CaptureError(f"{file}: no such file") from None
    except OSError as error:
        raise CaptureError(f"{file}: can't be read ({error.strerror})") from None


def read_text(file: Path, max_bytes: int = MAX_FILE_BYTES) -> str:
    """Read a whole file as UTF-8; raises `CaptureError` that names it."""
    try:
        return read_bytes(file, max_bytes).decode("utf-8-sig")  # without the byte-order mark of Windows
    except UnicodeDecodeError as error:
        raise CaptureError(f"{file}: no text ({error})") from None


# NumPy archives

_MAX_ARCHIVE_BYTES = 1 << 29


def read_npz(file: Path, key: str) -> np.ndarray[Any, np.dtype[Any]]:
    """Read an array of real numbers by its name.

    Raises `CaptureError` if it is missing, damaged, larger than 0.5 GB, or implausibly large for its file.
    """
    try:
        with open_file(file) as stream, zipfile.ZipFile(stream) as archive:
            members = {each.filename.removesuffix(".npy"): each for each in archive.infolist()}
            if key not in members:
                raise CaptureError(f"{file}: has no array {key!r}, only {', '.join(members) or 'nothing'}")
            member = members[key]
            if member.file_size > _MAX_ARCHIVE_BYTES:
                raise CaptureError(
                    f"{file}: the array {member.filename!r} is larger than {_MAX_ARCHIVE_BYTES >> 20} MB"
                )
            check_expansion(file, member.file_size, file.stat().st_size, is_uniform=True)
            return read_member(archive, member)
    except FileNotFoundError:
        raise CaptureError(f"{file}: no such file") from None
    except CaptureError:
        raise
    except InputError as error:
        raise CaptureError(str(error)) from None
    except DAMAGES as error:
        raise CaptureError(f"{file}: not a readable .npz file ({error})") from None


# JSON

_MAX_BYTES = 1 << 30


def read_json(file: Path) -> Any:
    """Read a JSON file; raises `CaptureError` if it is missing, broken or larger than 1 GB."""
    content = read_bytes(file, _MAX_BYTES)
    try:
        return json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{file}: not a JSON file that can be read ({error})") from None


def read_json_object(file: Path) -> dict[str, Any]:
    values = read_json(file)
    if not isinstance(values, dict):
        raise CaptureError(f"{file}: holds {type(values).__name__}, expected a JSON object")
    return values


def read_json_rows(file: Path) -> list[dict[str, Any]]:
    rows = read_json(file)
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise CaptureError(f"{file}: expected a JSON list of objects")
    return rows


# Wrong values

WRONG_VALUES = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError)
"""Exceptions that values of unexpected kinds raise, `CaptureError` among them."""


def what_is_wrong(error: Exception) -> str:
    """Description of a wrong field or value."""
    if isinstance(error, KeyError):
        return f"has no field {error.args[0]!r}"
    return str(error) or type(error).__name__
