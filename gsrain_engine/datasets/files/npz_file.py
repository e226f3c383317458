"""Reads one array of a NumPy archive (.npz); what is wrong with it is said with its name."""

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ..capture import CaptureError

_MOST_BYTES = 4 << 30


def read_npz(file: Path, key: str) -> np.ndarray[Any, np.dtype[Any]]:
    """Read an array of numbers by its name; `CaptureError` where it is missing, damaged, or larger than 4 GB."""
    try:
        with zipfile.ZipFile(file) as archive:
            sizes = {each.filename.removesuffix(".npy"): each.file_size for each in archive.infolist()}
        if key not in sizes:
            raise CaptureError(f"{file}: has no array {key!r}, only {', '.join(sizes) or 'nothing'}")
        if sizes[key] > _MOST_BYTES:
            raise CaptureError(f"{file}: the array {key!r} is larger than {_MOST_BYTES >> 30} GB")
        with np.load(file, allow_pickle=False) as arrays:
            return np.asarray(arrays[key])
    except FileNotFoundError:
        raise CaptureError(f"{file}: no such file") from None
    except (OSError, ValueError, EOFError, KeyError, SyntaxError, zipfile.BadZipFile, zlib.error) as error:
        if isinstance(error, CaptureError):
            raise
        raise CaptureError(f"{file}: not a readable .npz file ({error})") from None
