"""Spherical harmonics by themselves, as a NumPy array file (.npy, version 1.0): the wet colours of a layer or actor."""

from pathlib import Path

import numpy as np
from jaxtyping import Float32

from gsrain_engine.untrusted.array_header import read_array_header
from gsrain_engine.untrusted.limits import open_file

from ..errors import SceneFormatError
from .checks import check_finite

SUFFIX = ".wet.npy"


def read_harmonics(path: Path, shape: tuple[int, ...]) -> Float32[np.ndarray, "n k 3"]:
    """Read harmonics of a shape (n, k, 3) that is known before: that of the clear colours.

    Raises:
        SceneFormatError: When the file is damaged, holds something else or another shape.
    """
    with open_file(path) as file:
        try:
            found, is_fortran, dtype = read_array_header(file)
        except ValueError as error:
            raise SceneFormatError(path, f"no array file of wet colours: {error}") from None
        if dtype != np.dtype("<f4") or is_fortran or found != shape:
            order = " in Fortran's order" if is_fortran else ""
            raise SceneFormatError(path, f"holds {dtype} {found}{order}, expected float32 {shape} as the clear colours")
        sh = np.empty(shape, np.float32)
        if file.readinto(sh.view(np.uint8).reshape(-1).data) != sh.nbytes or file.read(1):
            raise SceneFormatError(path, f"does not end after the {sh.nbytes:,} bytes that {shape} numbers take")
    check_finite(path, {"wet colour": sh})
    return sh


def write_harmonics(sh: Float32[np.ndarray, "n k 3"], path: Path) -> None:
    with path.open("wb") as file:
        np.lib.format.write_array(file, np.ascontiguousarray(sh, "<f4"), version=(1, 0), allow_pickle=False)
