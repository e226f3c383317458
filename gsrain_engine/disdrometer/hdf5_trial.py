"""Trial of HDF5 files in a separate process, since a damaged file can hang or crash the HDF5 library.

Run as a program, this module reads a file from standard input, opens it as `netcdf` does, and reads all its variables.
"""

import io
import math
import subprocess
import sys

HDF5 = b"\x89HDF\r\n\x1a\n"
"""First bytes of a file."""
NETCDF_CLASSIC = b"CDF\x01", b"CDF\x02"
"""First bytes of the older kind of NetCDF, which needs no trial."""

LARGEST_DATASET = 2 * 2**30
"""Maximum bytes of all variables after decompression."""

_MIN_S, _PER_BYTE_S = 30.0, 1e-7  # time limit of the trial: seconds to load the libraries, and per byte of the file


def passes_trial(data: bytes) -> bool:
    """Return whether the library terminates on a file, with or without an error. A frozen program skips the trial."""
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
            return  # rejected by the reader before decompression
        for variable in variables:
            dict(variable.attrs)
            variable[...]


if __name__ == "__main__":
    _try(sys.stdin.buffer.read())
