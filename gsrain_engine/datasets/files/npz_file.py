"""Reads one array of a NumPy archive (.npz); what is wrong with it is said with its name."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from gsrain_engine.untrusted.array_archives import DAMAGES, read_member
from gsrain_engine.untrusted.limits import InputError, open_file

from ..capture import CaptureError
from .expansion import check_expansion

_MOST_BYTES = 1 << 29


def read_npz(file: Path, key: str) -> np.ndarray[Any, np.dtype[Any]]:
    """Read an array of real numbers by its name.

    Raises `CaptureError` where it is missing, damaged, larger than 0.5 GB, or out of all proportion to its file.
    """
    try:
        with open_file(file) as stream, zipfile.ZipFile(stream) as archive:
            members = {each.filename.removesuffix(".npy"): each for each in archive.infolist()}
            if key not in members:
                raise CaptureError(f"{file}: has no array {key!r}, only {', '.join(members) or 'nothing'}")
            return _array(file, archive, members[key])
    except FileNotFoundError:
        raise CaptureError(f"{file}: no such file") from None
    except CaptureError:
        raise
    except InputError as error:
        raise CaptureError(str(error)) from None
    except DAMAGES as error:
        raise CaptureError(f"{file}: not a readable .npz file ({error})") from None


def _array(file: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray[Any, np.dtype[Any]]:
    if member.file_size > _MOST_BYTES:
        raise CaptureError(f"{file}: the array {member.filename!r} is larger than {_MOST_BYTES >> 20} MB")
    check_expansion(file, member.file_size, file.stat().st_size)
    return read_member(archive, member)
