"""Headers of PLY files: elements, their properties and where their rows are."""

import logging
import os
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from ...safe_io.errors import SceneFormatError

ANTIALIASED = "SplatRenderMode: mip"
"""Comment in the header of a file with `Gaussians.antialiased`, as Brush writes it; Postshot's `antialiased 1` is
read, too."""

logger = logging.getLogger("gsrain")
_LARGEST_HEADER = 1 << 20  # bytes within which `end_header` must appear; real headers have 2 KB
_DIGITS = 20  # maximum digits of a count: more than any file needs, and quick to parse
_TEXT = "ascii"
_BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", _TEXT: "<"}

_UPS = {
    "x": (1.0, 0.0, 0.0), "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0), "-z": (0.0, 0.0, -1.0),
}  # fmt: skip
"""Values of nerfstudio's comment `Vertical Axis:`. "y" is missing: Brush wrote it into files of any orientation."""

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip


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
    """True if the header has the comment of `ANTIALIASED`."""
    header_bytes: int = 0
    """Byte offset of the file's first row."""
    up: tuple[float, float, float] | None = None
    """Upward direction by a comment of the header; None if it has none that can be trusted."""

    @property
    def nbytes(self) -> int:
        """Bytes of all its rows; 0 with list properties."""
        return self.rows * self.dtype.itemsize if self.dtype is not None else 0


def read_ply_header(path: Path, file: BinaryIO) -> dict[str, PlyElement]:
    """Read the header of a PLY file and check that the file is long enough for its rows.

    For a text (ascii) PLY, `file` is positioned at the first row afterwards.

    Raises `SceneFormatError` if the file is no PLY, has a damaged header, or is shorter than its header declares.
    """
    lines, size = _header_lines(path, file)
    kind = _format(path, lines)
    elements = _elements(path, lines, _BYTE_ORDERS[kind], size)
    if kind == _TEXT:
        elements = [element._replace(is_text=True, offset=None, header_bytes=size) for element in elements]
        file.seek(size)
    if any(words == ["comment", *mark.split()] for words in lines for mark in (ANTIALIASED, "antialiased 1")):
        elements = [element._replace(is_antialiased=True) for element in elements]
    ups = [_UPS[words[3].lower()] for words in lines if _names_up(words)]
    if ups:
        elements = [element._replace(up=ups[-1]) for element in elements]
    _check_size(path, elements, size, os.fstat(file.fileno()).st_size)
    return {element.name: element for element in elements}


def _names_up(words: list[str]) -> bool:
    *start, value = [word.lower() for word in words[:4]] or [""]
    return start == ["comment", "vertical", "axis:"] and value in _UPS


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
