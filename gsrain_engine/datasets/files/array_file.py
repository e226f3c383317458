"""Reads NumPy files of pixels; a file that is cut, or lies about its size, allocates nothing."""

import os
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from gsrain_engine.untrusted.array_header import array_bytes, read_array_header
from gsrain_engine.untrusted.limits import InputError, open_file

from ..capture import CaptureError


def read_floats(file: Path) -> Float32[np.ndarray, "..."]:
    """Read a .npy file of real numbers; `CaptureError` that names it where it can't be read."""
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
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large for 32 bits becomes infinite
        return np.array(numbers.reshape(shape, order="F" if is_fortran else "C"), np.float32, order="C")
