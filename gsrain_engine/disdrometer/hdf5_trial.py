"""Tries HDF5 files in a process of their own first: a damaged one can keep HDF5's library busy forever, or crash it.

Run as a program it reads a file from its input, opens it as `netcdf` will, and looks at everything in it.
"""

import io
import math
import subprocess
import sys

LARGEST_DATASET = 2 * 2**30
"""Bytes of all variables once unpacked."""

_MIN_S, _PER_BYTE_S = 30.0, 1e-7
"""How long the trial may take: to load the libraries, and for a file's bytes."""


def passes_trial(data: bytes) -> bool:
    """Whether the library comes to an end with a file, by an error or not. A frozen program has no trial."""
    if getattr(sys, "frozen", False):
        return True
    try:
        tried = subprocess.run(
            [sys.executable, "-P", __file__], input=data, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            timeout=_MIN_S + _PER_BYTE_S * len(data), check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return False
    return tried.returncode >= 0


def _try(data: bytes) -> None:
    import h5netcdf

    with h5netcdf.File(io.BytesIO(data), "r") as file:
        variables = list(file.variables.values())
        if sum(math.prod(each.shape) * getattr(each.dtype, "itemsize", 8) for each in variables) > LARGEST_DATASET:
            return  # refused by its reader before anything is unpacked
        for variable in variables:
            dict(variable.attrs)
            variable[...]


if __name__ == "__main__":
    _try(sys.stdin.buffer.read())
