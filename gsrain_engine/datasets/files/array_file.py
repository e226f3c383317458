"""Reads NumPy files of pixels; a file that is cut, or lies about its size, allocates nothing."""

from pathlib import Path

import numpy as np
from jaxtyping import Float32

from ..capture import CaptureError


def read_floats(file: Path) -> Float32[np.ndarray, "..."]:
    """Read a .npy file of real numbers; `CaptureError` that names it where it can't be read."""
    try:
        mapped = np.load(file, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError, SyntaxError, TypeError) as error:
        raise CaptureError(f"{file}: not a readable .npy file ({error})") from None
    if not isinstance(mapped, np.ndarray) or mapped.dtype.kind not in "fiub":
        raise CaptureError(f"{file}: holds no array of real numbers")
    return np.array(mapped, np.float32)
