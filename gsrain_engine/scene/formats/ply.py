"""PLY files: 3DGS properties (Kerbl et al. 2023), headers, rows, and SuperSplat's compressed variant.

3DGS stores log scales, opacity logits and harmonics as 32-bit floats.
"""

import logging
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from io import BufferedReader
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Int64, UInt

from ...kernels import NOGIL
from ...safe_io.limits import open_file
from ..files import SceneFormatError
from ..gaussians import COEFFICIENTS_OF_DEGREE, SH_C0, Gaussians
from ._common import check_finite, check_room, checked_gaussians, with_largest

_MEANS = ("x", "y", "z")
_BASE_SH = ("f_dc_0", "f_dc_1", "f_dc_2")
_SCALES = ("scale_0", "scale_1", "scale_2")
_QUATERNIONS = ("rot_0", "rot_1", "rot_2", "rot_3")
_REQUIRED = (*_MEANS, *_BASE_SH, "opacity", *_SCALES, *_QUATERNIONS)
_NORMALS = ("nx", "ny", "nz")
"""Written as zeros, as in 3DGS itself: some readers count properties instead of reading their names."""

_ANTIALIASED = "SplatRenderMode: mip"
"""Comment in the header of a file with `Gaussians.antialiased`, as Brush writes it; Postshot's `antialiased 1` is
read, too."""

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
    skipped. Memory: the arrays and one block of 256 KB.

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
    mark = f"comment {_ANTIALIASED}\n" if gaussians.antialiased else ""
    header = f"ply\nformat binary_little_endian 1.0\n{mark}element vertex {len(gaussians)}\n{properties}end_header\n"
    rows = max(1, _CHUNK_BYTES // (4 * len(names)))
    with path.open("wb") as file:
        file.write(header.encode())
        for start in range(0, len(gaussians), rows):
            file.write(_rows(gaussians.take(slice(start, start + rows))).data)


# PLY header


class PlyElement(NamedTuple):
    """One element (kind of row) in a PLY file."""

    name: str
    rows: int
    dtype: "np.dtype[Any] | None"
    """Fields of a row; None with list properties, whose rows differ in length."""
    offset: int | None
    """Byte offset of its first row; None if lists or text before it make that unknown."""
    is_text: bool = False
    """True if its rows are lines of text; the fields then give only the columns."""
    is_antialiased: bool = False
    """True if the header has the comment of `_ANTIALIASED`."""

    @property
    def nbytes(self) -> int:
        """Bytes of all its rows; 0 with list properties."""
        return self.rows * self.dtype.itemsize if self.dtype is not None else 0


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
        check_finite(path, {"logarithm of a scale": scales, "logit of an opacity": opacities})
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


logger = logging.getLogger("gsrain")
_LARGEST_HEADER = 1 << 20  # bytes within which `end_header` must appear; real headers have 2 KB
_DIGITS = 20  # maximum digits of a count: more than any file needs, and quick to parse
_TEXT = "ascii"
_BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", _TEXT: "<"}

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip


def read_ply_header(path: Path, file: BinaryIO) -> dict[str, PlyElement]:
    """Read the header of a PLY file and check that the file is long enough for its rows.

    For a text (ascii) PLY, `file` is positioned at the first row afterwards.

    Raises `SceneFormatError` if the file is no PLY, has a damaged header, or is shorter than its header declares.
    """
    lines, size = _header_lines(path, file)
    kind = _format(path, lines)
    elements = _elements(path, lines, _BYTE_ORDERS[kind], size)
    if kind == _TEXT:
        elements = [element._replace(is_text=True, offset=None) for element in elements]
        file.seek(size)
    if any(words == ["comment", *mark.split()] for words in lines for mark in (_ANTIALIASED, "antialiased 1")):
        elements = [element._replace(is_antialiased=True) for element in elements]
    _check_size(path, elements, size, os.fstat(file.fileno()).st_size)
    return {element.name: element for element in elements}


def element_rows(path: Path, element: PlyElement) -> tuple["np.dtype[Any]", int]:
    """Row type of an element and the byte offset of its rows; rejects elements that lists make unreadable."""
    if element.is_text:
        raise SceneFormatError(path, f"element {element.name!r} is text (format ascii), it must be binary")
    if element.dtype is None:
        raise SceneFormatError(path, f"element {element.name!r} has a list property, a Gaussian has only numbers")
    if element.offset is None:
        raise SceneFormatError(path, f"element {element.name!r} must stand before elements with list properties")
    return element.dtype, element.offset


def _header_lines(path: Path, file: BinaryIO) -> tuple[list[list[str]], int]:
    """Words of every line after the first, and the size of the header in bytes."""
    start = file.read(_LARGEST_HEADER)
    if not start.startswith((b"ply\n", b"ply\r\n")):
        raise SceneFormatError(path, "not a PLY file: it must start with the line 'ply'")
    mark = start.find(b"\nend_header")
    end = start.find(b"\n", mark + 1)
    if mark < 0 or end < 0 or start[mark:end].strip() != b"end_header":
        raise SceneFormatError(path, f"the PLY header has no line 'end_header' in its first {len(start)} bytes")
    text = start[:mark].decode("utf-8", errors="replace")
    return [line.split() for line in text.splitlines()[1:]], end + 1


def _format(path: Path, lines: list[list[str]]) -> str:
    formats = [words[1] for words in lines if words[:1] == ["format"] and len(words) > 1]
    if len(formats) != 1 or formats[0] not in _BYTE_ORDERS:
        found = ", ".join(formats) or "none"
        raise SceneFormatError(
            path, f"the PLY header must hold one line 'format binary_little_endian 1.0', not {found}"
        )
    return formats[0]


def _elements(path: Path, lines: list[list[str]], byte_order: str, header_size: int) -> list[PlyElement]:
    counts: dict[str, int] = {}
    fields: dict[str, dict[str, str] | None] = {}
    name = None
    for words in lines:
        match words:
            case ["element", name, count] if name not in counts and count.isascii() and count.isdigit():
                counts[name], fields[name] = int(count[:_DIGITS]), {}
            case ["property", "list", *_] if name is not None:
                fields[name] = None
            case ["property", kind, field] if name is not None and kind in _TYPES:
                _add_field(path, fields[name], field, byte_order + _TYPES[kind])
            case [] | ["format" | "comment" | "obj_info", *_]:
                pass
            case _:
                raise SceneFormatError(path, f"the PLY header has a line that makes no sense: {' '.join(words)[:80]!r}")
    elements: list[PlyElement] = []
    offset: int | None = header_size
    for name, count in counts.items():
        found = fields[name]
        element = PlyElement(name, count, np.dtype(list(found.items())) if found is not None else None, offset)
        offset = offset + element.nbytes if offset is not None and element.dtype is not None else None
        elements.append(element)
    return elements


def _add_field(path: Path, fields: dict[str, str] | None, name: str, kind: str) -> None:
    if fields is None:
        return
    if name in fields:
        raise SceneFormatError(path, f"the PLY header lists property {name!r} twice")
    fields[name] = kind


def _check_size(path: Path, elements: list[PlyElement], header_size: int, file_size: int) -> None:
    """Reject a file too short for its header. Longer files are valid: some tools delete rows by editing the count."""
    is_text = any(element.is_text for element in elements)
    expected = header_size + sum(_text_bytes(element) if is_text else element.nbytes for element in elements)
    rows = ", ".join(f"{element.rows} {element.name}" for element in elements)
    if file_size < expected:
        raise SceneFormatError(
            path,
            f"the header lists {rows}, which takes {'at least ' * is_text}{expected} bytes; the file has {file_size}: "
            "it is cut off or its counts are wrong",
        )
    if file_size > expected and not is_text and all(element.dtype is not None for element in elements):
        logger.warning("%s: %d bytes follow the rows that the header lists (%s)", path, file_size - expected, rows)


def _text_bytes(element: PlyElement) -> int:
    """Minimum bytes of its rows as text: a digit and a separator per number, without the last separator."""
    return max(0, 2 * element.rows * (1 if element.dtype is None else len(element.dtype.names or ())) - 1)


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


# Compressed PLY
# SuperSplat's: 16 bytes per Gaussian, quantized within the bounds of chunks of 256.

_CHUNK = 256  # gaussians per chunk, with common bounds
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_LOG_SCALES = ("scale_x", "scale_y", "scale_z")
_MEANS_BITS = (11, 10, 11)
_COLOR_BITS = (8, 8, 8, 8)
_ROTATION_BITS = (2, 10, 10, 10)
_SH_RANGE = 8.0  # harmonics are in -4 .. 4; bytes 0 and 255 are the ends, the others the midpoints of 256 steps.


def is_compressed(elements: dict[str, PlyElement]) -> bool:
    vertex = elements.get("vertex")
    return "chunk" in elements and vertex is not None and _PACKED[0] in _names(vertex.dtype)


def read_compressed(path: Path, file: BufferedReader, elements: dict[str, PlyElement]) -> Gaussians:
    """Read the Gaussians of a compressed PLY after its header.

    Layout as written by SuperSplat and splat-transform (PlayCanvas, MIT): element `chunk` with bounds of means, log
    scales and, in newer files, colors; `vertex` with four 32-bit words; optional `sh` with a byte per coefficient.

    Raises `SceneFormatError` if a property is missing, counts contradict one another or bounds are not finite.
    """
    check_room(path, elements["vertex"].rows, COEFFICIENTS_OF_DEGREE[-1] if "sh" in elements else 1)
    rows = _read(path, file, elements["vertex"], _PACKED)
    packed = {name: _unsigned(path, rows, name, "uint32") for name in _PACKED}
    chunk = elements["chunk"]
    n = elements["vertex"].rows
    if chunk.rows != -(-n // _CHUNK):
        raise SceneFormatError(path, f"{n} Gaussians need {-(-n // _CHUNK)} chunks, the header lists {chunk.rows}")
    with np.errstate(over="ignore", invalid="ignore"):  # overflow gives infinity, which the final check reports
        has_colors = "min_r" in _names(chunk.dtype)
        values = [*_MEANS, *_LOG_SCALES, *("rgb" if has_colors else "")]
        bounds = _read(path, file, chunk, tuple(f"{end}_{value}" for value in values for end in ("min", "max")))
        means = _between(bounds, _fractions(packed["packed_position"], _MEANS_BITS), _MEANS)
        logs = _between(bounds, _fractions(packed["packed_scale"], _MEANS_BITS), _LOG_SCALES)
        colors = _fractions(packed["packed_color"], _COLOR_BITS)
        opacities = np.ascontiguousarray(colors[:, 3])
        base = _between(bounds, colors[:, :3], "rgb") if has_colors else colors[:, :3]
        sh = _read_sh(path, file, elements.get("sh"), n)
        sh[:, 0] = (base - np.float32(0.5)) / np.float32(SH_C0)
        check_finite(path, {"logarithm of a scale": logs})
        np.exp(logs, out=logs)
    return checked_gaussians(path, means, logs, _quaternions(packed["packed_rotation"]), opacities, sh)


def _between(
    bounds: "np.ndarray[Any, np.dtype[Any]]", fractions: Float32[np.ndarray, "n 3"], values: Sequence[str]
) -> Float32[np.ndarray, "n 3"]:
    """Interpolate between the bounds of each Gaussian's chunk."""
    low, high = (
        np.stack([bounds[f"{end}_{value}"].astype(np.float32) for value in values], axis=-1) for end in ("min", "max")
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
    """One property, in native byte order; `kind` is the integer type of the packed bits."""
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
    """Unpack words into bit fields from the top bit down, each as a fraction 0 .. 1 of its maximum."""
    fields = np.empty((len(words), len(bits)), np.float32)
    shift = sum(bits)
    for i, size in enumerate(bits):
        shift -= size
        fields[:, i] = ((words >> np.uint32(shift)) & np.uint32((1 << size) - 1)) / np.float32((1 << size) - 1)
    return fields


def _quaternions(words: UInt[np.ndarray, " n"]) -> Float32[np.ndarray, "n 4"]:
    """Unpack rotations: the upper two bits index the largest of w, x, y, z; the others are within +-1/sqrt(2)."""
    others = (_fractions(words, _ROTATION_BITS)[:, 1:] - np.float32(0.5)) * np.float32(np.sqrt(2))
    return with_largest((words >> np.uint32(30)).astype(np.int64), others)


def _names(dtype: "np.dtype[Any] | None") -> tuple[str, ...]:
    return (dtype.names or ()) if dtype is not None else ()
