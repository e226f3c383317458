"""PLY files with the properties of 3DGS (Kerbl et al. 2023).

3DGS stores log scales, opacity logits and harmonics as 32-bit floats.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from io import BufferedReader
from pathlib import Path
from typing import Any, no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Int64

from ...kernels import NOGIL
from ...safe_io.limits import open_file
from ..files import SceneFormatError
from ..gaussians import COEFFICIENTS_OF_DEGREE, Gaussians
from ._common import check_finite, check_room, checked_gaussians
from .compressed_ply import is_compressed, read_compressed
from .ply_header import ANTIALIASED, PlyElement, element_rows, read_ply_header

_MEANS = ("x", "y", "z")
_BASE_SH = ("f_dc_0", "f_dc_1", "f_dc_2")
_SCALES = ("scale_0", "scale_1", "scale_2")
_QUATERNIONS = ("rot_0", "rot_1", "rot_2", "rot_3")
_REQUIRED = (*_MEANS, *_BASE_SH, "opacity", *_SCALES, *_QUATERNIONS)
_NORMALS = ("nx", "ny", "nz")
"""Written as zeros, as in 3DGS itself: some readers count properties instead of reading their names."""

_CHUNK_BYTES = 1 << 18  # rows are read and distributed to the arrays in blocks that fit into the CPU cache
_CHUNK_LINES = 1024
_LONGEST_LINE = 1 << 14  # Bytes; a Gaussian of SH degree 3 has some 700

_Arrays = tuple[
    Float32[np.ndarray, "n 3"],
    Float32[np.ndarray, "n 3"],
    Float32[np.ndarray, "n 4"],
    Float32[np.ndarray, " n"],
    Float32[np.ndarray, "n k 3"],
]
"""Means, log scales, quaternions, opacity logits, harmonics."""

_LARGEST_LOGIT = 100.0
"""Written for an opacity of 1 or 0, whose logit is infinite: it converts back to exactly 1 or 0 in 32-bit floats."""

_SMALLEST_SCALE = np.float32(1e-37)  # written for a scale of 0, whose logarithm is infinite


def read_ply(path: Path) -> Gaussians:
    """Read a 3DGS PLY of SH degree 0 to 3, or SuperSplat's compressed PLY, recognized by its header.

    Properties may have any order and type, in either byte order or as text; unknown properties and elements are
    skipped. An infinite logit is an opacity of 1 or 0. Memory: the arrays and one block of 256 KB.

    Raises `SceneFormatError` if the file is damaged or is not a file of Gaussians.
    """
    with open_file(path) as file:
        elements = read_ply_header(path, file)
        if is_compressed(elements):
            return read_compressed(path, file, elements)
        return _read_vertices(path, file, elements, slice(None))


def read_ply_parts(path: Path, rows: int) -> Iterator[Gaussians]:
    """Read a PLY as `read_ply` does, `rows` Gaussians at a time; one that is text or compressed all at once."""
    with open_file(path) as file:
        elements = read_ply_header(path, file)
        vertex = elements.get("vertex")
        if vertex is None or vertex.is_text or is_compressed(elements):
            yield read_ply(path)
            return
        for first in range(0, vertex.rows, rows):
            yield _read_vertices(path, file, elements, slice(first, first + rows))


def write_ply(gaussians: Gaussians, path: Path) -> None:
    """Write the standard 3DGS layout, little endian, with normals of 0; f_rest has 0, 9, 24 or 45 properties.

    Antialiased Gaussians are marked by a comment in the header, which other programs ignore.
    """
    rest = 3 * (gaussians.sh.shape[1] - 1)
    names = [*_MEANS, *_NORMALS, *_BASE_SH, *(f"f_rest_{i}" for i in range(rest)), "opacity", *_SCALES, *_QUATERNIONS]
    properties = "".join(f"property float {name}\n" for name in names)
    mark = f"comment {ANTIALIASED}\n" if gaussians.antialiased else ""
    header = f"ply\nformat binary_little_endian 1.0\n{mark}element vertex {len(gaussians)}\n{properties}end_header\n"
    rows = max(1, _CHUNK_BYTES // (4 * len(names)))
    with path.open("wb") as file:
        file.write(header.encode())
        for start in range(0, len(gaussians), rows):
            file.write(_rows(gaussians.take(slice(start, start + rows))).data)


def _read_vertices(path: Path, file: BufferedReader, elements: dict[str, PlyElement], rows: slice) -> Gaussians:
    if "vertex" not in elements:
        found = ", ".join(elements) or "none"
        raise SceneFormatError(path, f"a PLY of Gaussians has an element 'vertex', not {found}")
    vertex = elements["vertex"]
    if vertex.is_text and vertex.dtype is not None:
        dtype, offset = vertex.dtype, None
    else:
        dtype, offset = element_rows(path, vertex)
    coefficients = _coefficients(path, dtype, has_faces="face" in elements)
    first, last, _ = rows.indices(vertex.rows)
    n = last - first
    check_room(path, n, coefficients)
    means, scales, quaternions = (np.empty((n, size), np.float32) for size in (3, 3, 4))
    opacities = np.empty(n, np.float32)
    sh = np.empty((n, coefficients, 3), np.float32)
    if offset is not None:
        file.seek(offset + first * dtype.itemsize)
    # Numbers too large for 32 bits become infinite, and are reported below.
    with np.errstate(over="ignore", invalid="ignore"):
        arrays = means, scales, quaternions, opacities, sh
        if offset is not None:
            _spread_rows(path, file, dtype, arrays)
        else:
            _skip_rows_before(file, elements)
            _spread_lines(path, file, dtype, arrays)
        check_finite(path, {"logarithm of a scale": scales})
        np.exp(scales, out=scales)
        activate_opacities(opacities)
    found = checked_gaussians(path, means, scales, quaternions, opacities, sh)
    return replace(found, antialiased=vertex.is_antialiased)


def activate_opacities(logits: Float32[np.ndarray, " n"]) -> None:
    """Convert logits to opacities in place: 1 / (1 + exp(-x))."""
    with np.errstate(over="ignore"):  # exp overflows for large negative logits, and the opacity is 0
        np.exp(np.negative(logits, out=logits), out=logits)
    logits += 1
    np.reciprocal(logits, out=logits)


def _coefficients(path: Path, dtype: "np.dtype[Any]", *, has_faces: bool) -> int:
    """Number of spherical harmonics per color, from the names of the properties."""
    names = dtype.names or ()
    missing = [name for name in _REQUIRED if name not in names]
    if missing:
        told = f"element 'vertex' has no property {', '.join(missing)}: not a PLY of Gaussians"
        if not any(name in names for name in (*_BASE_SH, *_SCALES, *_QUATERNIONS)):
            told += " but a mesh" if has_faces else " but a point cloud"
        raise SceneFormatError(path, told)
    rest = {name for name in names if re.fullmatch(r"f_rest_\d+", name)}
    expected = {3 * (coefficients - 1): coefficients for coefficients in COEFFICIENTS_OF_DEGREE}
    if len(rest) not in expected or rest != {f"f_rest_{i}" for i in range(len(rest))}:
        raise SceneFormatError(
            path, f"{len(rest)} properties f_rest_*: expected 0, 9, 24 or 45, counted from f_rest_0 (SH degree 0 to 3)"
        )
    return expected[len(rest)]


def _properties(coefficients: int) -> list[str]:
    """Names of the properties in the order of the arrays; the file has all harmonics of red, then of green, of blue."""
    rest = coefficients - 1
    harmonics = [f"f_rest_{channel * rest + k}" for k in range(rest) for channel in range(3)]
    return [*_MEANS, *_SCALES, *_QUATERNIONS, "opacity", *_BASE_SH, *harmonics]


def _spread_rows(path: Path, file: BufferedReader, dtype: "np.dtype[Any]", arrays: _Arrays) -> None:
    """Copy the properties of the file's next rows into arrays, block by block, converted to float32."""
    count, names = len(arrays[0]), _properties(arrays[4].shape[1])
    piece = np.empty(min(count, max(1, _CHUNK_BYTES // dtype.itemsize)), dtype)
    places = {name: number for number, name in enumerate(dtype.names or ())}
    is_plain = all(dtype[name] == np.float32 for name in places)
    columns = np.array([places[name] if is_plain else i for i, name in enumerate(names)], np.int64)
    for start in range(0, count, len(piece) or 1):
        rows = piece[: count - start]
        if file.readinto(rows.view(np.uint8).data) != rows.nbytes:
            raise SceneFormatError(path, "the file became shorter while it was read")
        if is_plain:
            numbers = rows.view(np.float32).reshape(len(rows), len(places))
        else:
            numbers = np.stack([rows[name] for name in names], axis=1, dtype=np.float32, casting="unsafe")
        _copy_rows(numbers, columns, arrays, start)


def _skip_rows_before(file: BufferedReader, elements: dict[str, PlyElement]) -> None:
    for element in elements.values():
        if element.name == "vertex":
            return
        for _ in range(element.rows):
            if not file.readline(_LONGEST_LINE):
                return


def _spread_lines(path: Path, file: BufferedReader, dtype: "np.dtype[Any]", arrays: _Arrays) -> None:
    """Copy the numbers of the next lines of text into arrays, block by block."""
    count, names = len(arrays[0]), list(dtype.names or ())
    columns = np.array([names.index(name) for name in _properties(arrays[4].shape[1])], np.int64)
    for start in range(0, count, _CHUNK_LINES):
        lines = [
            file.readline(_LONGEST_LINE).decode("ascii", "replace") for _ in range(min(_CHUNK_LINES, count - start))
        ]
        for number, line in enumerate(lines, start):
            if len(line.split()) != len(names):
                found = len(line.split())
                raise SceneFormatError(
                    path, f"vertex {number}: {found} numbers in its line, its header lists {len(names)}"
                )
        try:
            numbers = np.loadtxt(lines, np.float64, comments=None, ndmin=2).astype(np.float32)
        except ValueError:
            raise SceneFormatError(path, f"vertices {start} to {start + len(lines) - 1}: a word is no number") from None
        _copy_rows(numbers, columns, arrays, start)


def _rows(gaussians: Gaussians) -> Float32[np.ndarray, "n p"]:
    n = len(gaussians)
    opacities = gaussians.opacities.astype(np.float64)
    with np.errstate(divide="ignore"):
        logits = np.clip(np.log(opacities) - np.log1p(-opacities), -_LARGEST_LOGIT, _LARGEST_LOGIT)
    columns = (
        gaussians.means,
        np.zeros((n, 3)),
        gaussians.sh[:, 0],
        gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(n, -1),
        logits[:, None],
        np.log(np.maximum(gaussians.scales, _SMALLEST_SCALE)),
        gaussians.quaternions,
    )
    return np.concatenate(columns, axis=1, dtype="<f4")


# Rows to arrays


def _copy_rows(rows: Float32[np.ndarray, "r p"], columns: Int64[np.ndarray, " c"], arrays: _Arrays, start: int) -> None:
    means, scales, quaternions, opacities, sh = (array[start : start + len(rows)] for array in arrays)
    _spread(rows, columns, means, scales, quaternions, opacities, sh.reshape(len(rows), 3 * sh.shape[1]))


@numba.njit(cache=True, nogil=NOGIL)
@no_type_check
def _spread(rows, columns, means, scales, quaternions, opacities, sh):
    """Copy the numbers of a file, one row at a time: by columns, each number would touch a cache line.

    `columns` are those of `rows` for the elements of the arrays, in the arrays' memory order; the harmonics of a row
    are (3 k).
    """
    for n in range(len(rows)):
        for i in range(3):
            means[n, i] = rows[n, columns[i]]
            scales[n, i] = rows[n, columns[3 + i]]
        for i in range(4):
            quaternions[n, i] = rows[n, columns[6 + i]]
        opacities[n] = rows[n, columns[10]]
        for i in range(sh.shape[1]):
            sh[n, i] = rows[n, columns[11 + i]]
