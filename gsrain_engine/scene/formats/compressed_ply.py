"""SuperSplat's compressed PLY: 16 bytes a Gaussian, quantized within the bounds of chunks of 256."""

from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt

from ..errors import SceneFormatError
from ..gaussians import COEFFICIENTS_OF_DEGREE, SH_C0, Gaussians
from .checks import check_finite, checked_gaussians
from .memory import check_room
from .ply_header import PlyElement, element_rows
from .smallest_three import with_largest

_CHUNK = 256
"""Gaussians that share one row of bounds."""
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_MEANS_BITS = (11, 10, 11)
_COLOR_BITS = (8, 8, 8, 8)
_ROTATION_BITS = (2, 10, 10, 10)
_SH_RANGE = 8.0
"""Harmonics lie in -4 .. 4; bytes 0 and 255 are the ends, the others the middles of 256 steps."""


def is_compressed(elements: dict[str, PlyElement]) -> bool:
    vertex = elements.get("vertex")
    return "chunk" in elements and vertex is not None and _PACKED[0] in _names(vertex.dtype)


def read_compressed(path: Path, file: BufferedReader, elements: dict[str, PlyElement]) -> Gaussians:
    """Read the Gaussians of a compressed PLY whose header has been read already.

    Layout as SuperSplat and splat-transform (PlayCanvas, MIT) write it: element `chunk` with bounds of means, of
    logarithms of scales and, in newer files, of colours; `vertex` with four 32-bit words; optional `sh` with a byte a
    coefficient.

    Raises:
        SceneFormatError: When a property is missing, counts contradict one another or bounds are not finite.
    """
    check_room(path, elements["vertex"].rows, COEFFICIENTS_OF_DEGREE[-1] if "sh" in elements else 1)
    rows = _read(path, file, elements["vertex"], _PACKED)
    packed = {name: _unsigned(path, rows, name, "uint32") for name in _PACKED}
    chunk = elements["chunk"]
    n = elements["vertex"].rows
    if chunk.rows != -(-n // _CHUNK):
        raise SceneFormatError(path, f"{n} Gaussians need {-(-n // _CHUNK)} chunks, the header lists {chunk.rows}")
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large becomes infinite, and is named at the end
        bounds = _Bounds(path, file, chunk)
        means = bounds.between(_fractions(packed["packed_position"], _MEANS_BITS), "x", "y", "z")
        logs = bounds.between(_fractions(packed["packed_scale"], _MEANS_BITS), "scale_x", "scale_y", "scale_z")
        colors = _fractions(packed["packed_color"], _COLOR_BITS)
        opacities = np.ascontiguousarray(colors[:, 3])
        base = colors[:, :3]
        if bounds.has_colors:
            base = bounds.between(base, "r", "g", "b")
        sh = _read_sh(path, file, elements.get("sh"), n)
        sh[:, 0] = (base - np.float32(0.5)) / np.float32(SH_C0)
        check_finite(path, {"logarithm of a scale": logs})
        np.exp(logs, out=logs)
    return checked_gaussians(path, means, logs, _quaternions(packed["packed_rotation"]), opacities, sh)


class _Bounds:
    """Rows of element `chunk`: the range that each value of up to 256 Gaussians lies in."""

    def __init__(self, path: Path, file: BufferedReader, chunk: PlyElement) -> None:
        self.has_colors = chunk.dtype is not None and "min_r" in _names(chunk.dtype)
        values = ["x", "y", "z", "scale_x", "scale_y", "scale_z", *("rgb" if self.has_colors else "")]
        self._rows = _read(path, file, chunk, tuple(f"{end}_{value}" for value in values for end in ("min", "max")))

    def between(self, fractions: Float32[np.ndarray, "n 3"], *values: str) -> Float32[np.ndarray, "n 3"]:
        """Interpolate between the bounds of each Gaussian's chunk."""
        low, high = (
            np.stack([self._rows[f"{end}_{value}"].astype(np.float32) for value in values], axis=-1)
            for end in ("min", "max")
        )
        chunk = np.arange(len(fractions)) // _CHUNK
        return low[chunk] * (1 - fractions) + high[chunk] * fractions


def _read(
    path: Path, file: BufferedReader, element: PlyElement, needed: tuple[str, ...]
) -> "np.ndarray[Any, np.dtype[Any]]":
    dtype, offset = element_rows(path, element)
    missing = [name for name in needed if name not in _names(dtype)]
    if missing:
        raise SceneFormatError(path, f"element {element.name!r} of a compressed PLY lacks {', '.join(missing)}")
    file.seek(offset)
    data = file.read(element.nbytes)
    if len(data) != element.nbytes:
        raise SceneFormatError(path, "the file became shorter while it was read")
    return np.frombuffer(data, dtype)


def _unsigned(path: Path, rows: "np.ndarray[Any, np.dtype[Any]]", name: str, kind: str) -> UInt[np.ndarray, " n"]:
    """One property, in this machine's byte order; `kind` is the type that holds the packed bits."""
    if rows[name].dtype.newbyteorder("=") != kind:
        raise SceneFormatError(path, f"property {name} of a compressed PLY must be {kind}, not {rows[name].dtype}")
    return rows[name].astype(kind)


def _read_sh(path: Path, file: BufferedReader, element: PlyElement | None, n: int) -> Float32[np.ndarray, "n k 3"]:
    """Read the harmonics of all degrees; degree 0 is left unset."""
    if element is None:
        return np.empty((n, 1, 3), np.float32)
    count = sum(name.startswith("f_rest_") for name in _names(element.dtype))
    expected = {3 * (coefficients - 1): coefficients for coefficients in COEFFICIENTS_OF_DEGREE}
    if count not in expected or element.rows != n:
        raise SceneFormatError(
            path, f"element 'sh' has {element.rows} rows of {count} f_rest_*: expected {n} rows of 0, 9, 24 or 45"
        )
    rows = _read(path, file, element, tuple(f"f_rest_{i}" for i in range(count)))
    sh = np.empty((n, expected[count], 3), np.float32)
    rest = expected[count] - 1
    for channel in range(3):
        for k in range(rest):
            sh[:, 1 + k, channel] = _SH_OF_BYTE[_unsigned(path, rows, f"f_rest_{channel * rest + k}", "uint8")]
    return sh


def _sh_of_byte() -> Float32[np.ndarray, "256"]:
    middles = (np.arange(256, dtype=np.float32) + np.float32(0.5)) / 256
    middles[0], middles[255] = 0, 1
    return (middles - np.float32(0.5)) * np.float32(_SH_RANGE)


_SH_OF_BYTE = _sh_of_byte()


def _fractions(words: UInt[np.ndarray, " n"], bits: tuple[int, ...]) -> Float32[np.ndarray, "n f"]:
    """Cut words into fields from the top bit down, each as a fraction 0 .. 1 of its largest value."""
    fields = np.empty((len(words), len(bits)), np.float32)
    shift = sum(bits)
    for i, size in enumerate(bits):
        shift -= size
        fields[:, i] = ((words >> np.uint32(shift)) & np.uint32((1 << size) - 1)) / np.float32((1 << size) - 1)
    return fields


def _quaternions(words: UInt[np.ndarray, " n"]) -> Float32[np.ndarray, "n 4"]:
    """Which of w, x, y, z is the largest stands in the upper two bits, then the three others within +-1/sqrt(2)."""
    others = (_fractions(words, _ROTATION_BITS)[:, 1:] - np.float32(0.5)) * np.float32(np.sqrt(2))
    return with_largest((words >> np.uint32(30)).astype(np.int64), others)


def _names(dtype: "np.dtype[Any] | None") -> tuple[str, ...]:
    return (dtype.names or ()) if dtype is not None else ()
