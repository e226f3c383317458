"""`.splat` files (Kevin Kwok's viewer, https://github.com/antimatter15/splat): 32 bytes a Gaussian, no header."""

from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8

from gsrain_engine.untrusted.limits import read_file

from ..errors import SceneFormatError
from ..gaussians import SH_C0, Gaussians, sh_from_color
from .checks import checked_gaussians
from .memory import check_room

_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quaternion", "u1", 4)])
"""Scales are linear, rgba is display colour and opacity over 255, the quaternion is (w, x, y, z) * 128 + 128."""


def read_splat(path: Path) -> Gaussians:
    """Read a .splat file; it has no spherical harmonics above degree 0.

    Raises:
        SceneFormatError: When the file is empty, ends inside a row, or holds values that no Gaussian can have.
    """
    size = path.stat().st_size
    if size == 0 or size % _ROW.itemsize:
        raise SceneFormatError(
            path, f"a .splat has {_ROW.itemsize} bytes a Gaussian; {size} bytes are no whole number of them above 0"
        )
    check_room(path, size // _ROW.itemsize, 1)
    rows = np.frombuffer(read_file(path, size), _ROW)
    quaternions = rows["quaternion"].astype(np.float32) - np.float32(128)
    rgba = rows["rgba"] / np.float32(255)
    return checked_gaussians(
        path,
        rows["mean"].astype(np.float32),
        rows["scale"].astype(np.float32),
        quaternions,
        np.ascontiguousarray(rgba[:, 3]),
        sh_from_color(rgba[:, :3]),
    )


def write_splat(gaussians: Gaussians, path: Path) -> None:
    """Write a .splat file: without harmonics above degree 0, with colours cut to 0 .. 1, in the same order.

    Raises `ValueError` without Gaussians: an empty file can't be told from a damaged one.
    """
    if not len(gaussians):
        raise ValueError("a .splat has no header and thus at least one Gaussian; there is none to write")
    rows = np.empty(len(gaussians), _ROW)
    rows["mean"] = gaussians.means
    rows["scale"] = gaussians.scales
    rows["rgba"][:, :3] = _bytes((gaussians.sh[:, 0] * np.float32(SH_C0) + np.float32(0.5)) * 255)
    rows["rgba"][:, 3] = _bytes(gaussians.opacities * 255)
    rows["quaternion"] = _bytes(gaussians.quaternions * 128 + 128)
    path.write_bytes(rows.tobytes())


def _bytes(values: Float32[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n"]:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
