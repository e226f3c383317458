"""Reads one array of a NumPy archive (.npz); what is wrong with it is said with its name."""

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from gsrain_engine.array_header import array_bytes, read_array_header

from ..capture import CaptureError
from .expansion import check_expansion
from .regular_file import check_regular

_MOST_BYTES = 1 << 29


def read_npz(file: Path, key: str) -> np.ndarray[Any, np.dtype[Any]]:
    """Read an array of real numbers by its name.

    Raises `CaptureError` where it is missing, damaged, larger than 0.5 GB, or out of all proportion to its file.
    """
    check_regular(file)
    try:
        with zipfile.ZipFile(file) as archive:
            members = {each.filename.removesuffix(".npy"): each for each in archive.infolist()}
            if key not in members:
                raise CaptureError(f"{file}: has no array {key!r}, only {', '.join(members) or 'nothing'}")
            return _array(file, archive, members[key])
    except FileNotFoundError:
        raise CaptureError(f"{file}: no such file") from None
    except CaptureError:
        raise
    except (OSError, ValueError, EOFError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise CaptureError(f"{file}: not a readable .npz file ({error})") from None


def _array(file: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray[Any, np.dtype[Any]]:
    """Read an array once its header agrees with how long it is: NumPy would make room for whatever a header says."""
    if member.file_size > _MOST_BYTES:
        raise CaptureError(f"{file}: the array {member.filename!r} is larger than {_MOST_BYTES >> 20} MB")
    check_expansion(file, member.file_size, file.stat().st_size)
    with archive.open(member) as stream:
        shape, is_fortran, dtype = read_array_header(stream)
        wanted = array_bytes(shape, dtype)
        if wanted > member.file_size:
            raise ValueError(f"{member.filename}: an array of {dtype} {shape} in {member.file_size} bytes")
        data = stream.read(wanted)
    if len(data) != wanted:
        raise ValueError(f"{member.filename}: an array of {dtype} {shape} in {member.file_size} bytes")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if is_fortran else "C")
