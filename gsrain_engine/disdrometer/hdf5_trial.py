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


def passes_trial(data: bytes, max_bytes: int, max_s: float) -> bool:
    """Return whether the library terminates on a file within `max_s`, with or without an error.

    Variables are not read if they have more than `max_bytes` together. A frozen program skips the trial.
    """
    if getattr(sys, "frozen", False):
        return True
    try:
        tried = subprocess.run(
            [sys.executable, "-P", __file__, str(max_bytes)], input=data, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, timeout=max_s, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return False
    return tried.returncode >= 0


def _try(data: bytes, max_bytes: int) -> None:
    import h5netcdf

    with h5netcdf.File(io.BytesIO(data), "r") as file:
        variables = list(file.variables.values())
        if sum(math.prod(each.shape) * getattr(each.dtype, "itemsize", 8) for each in variables) > max_bytes:
            return  # rejected by the reader before decompression
        for variable in variables:
            dict(variable.attrs)
            variable[...]


if __name__ == "__main__":
    _try(sys.stdin.buffer.read(), int(sys.argv[1]))
