"""Sky beside a PLY of Instant NuRec, `NAME.sky.npz` with a cubemap (README of https://github.com/NVIDIA/instant-nurec)."""

import zipfile
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from ...safe_io.errors import SceneFormatError
from ...safe_io.limits import open_file
from ...safe_io.numpy_files import read_member
from ..sky_dome import checked_cubemap

_SUFFIX, _CUBEMAP = ".sky.npz", "sky_cubemap.npy"
TO_CUBEMAP = np.diag([1.0, -1.0, 1.0])
"""From its directions to those of OpenGL's faces, as y is the other way round in both places and faces."""


def read_sky_sidecar(ply: Path) -> Float32[np.ndarray, "6 s s 3"] | None:
    """Cubemap of the file next to a PLY; None without one. Raises `SceneFormatError` if it is damaged."""
    path = ply.with_suffix(_SUFFIX)
    if not path.is_file():
        return None
    try:
        with open_file(path) as stream, zipfile.ZipFile(stream) as archive:
            return checked_cubemap(read_member(archive, archive.getinfo(_CUBEMAP)))
    except (ValueError, KeyError, zipfile.BadZipFile) as error:
        raise SceneFormatError(path, f"no sky of Instant NuRec: {error}") from None
