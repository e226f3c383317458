"""Records and tables of datasets: Parquet (pyarrow is imported on first use), TFRecord, and point clouds in PLY."""

import os
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from io import TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float64, UInt8

from ...kernels import kernel
from ...optional_packages import MissingPackageError, import_package
from ...safe_io.errors import SceneFormatError
from ...safe_io.limits import InputError, check_expansion, check_file, open_file
from ...scene.formats.ply_header import element_rows, read_ply_header
from ..capture import CaptureError

_BATCH_ROWS = 8
_DAMAGES = (OSError, ValueError, KeyError, TypeError, IndexError, NotImplementedError, MemoryError)
"""Base classes of Arrow's errors."""


@dataclass(frozen=True, slots=True)
class ParquetFile:
    """A table on disk. Every method raises `CaptureError`, which names the file."""

    path: Path

    def rows(self, columns: Sequence[str], optional: Sequence[str] = ()) -> Iterator[dict[str, Any]]:
        """Yield rows in order, lists as NumPy arrays, other values as Python's; missing optional columns are None."""
        opened = self._opened()
        there = set(opened.schema_arrow.names)
        missing = [name for name in columns if name not in there]
        if missing:
            raise CaptureError(f"{self.path}: has no column {missing[0]!r}")
        read = [*columns, *(name for name in optional if name in there)]
        absent = {name: None for name in optional if name not in there}
        try:
            for batch in opened.iter_batches(batch_size=_BATCH_ROWS, columns=read):
                arrays = [(name, batch.column(name)) for name in read]
                for k in range(batch.num_rows):
                    yield {**absent, **{name: _plain(array[k]) for name, array in arrays}}
        except _DAMAGES as error:
            raise CaptureError(f"{self.path}: can't be read ({error})") from None

    def row_groups(self, columns: Sequence[str]) -> list[tuple[int, int, dict[str, Any]]]:
        """Group, index in the group, and some columns of each row, for `cell`."""
        opened = self._opened()
        try:
            return [
                (group, place, row)
                for group in range(opened.num_row_groups)
                for place, row in enumerate(opened.read_row_group(group, columns=list(columns)).to_pylist())
            ]
        except _DAMAGES as error:
            raise CaptureError(f"{self.path}: can't be read ({error})") from None

    def cell(self, column: str, group: int, place: int) -> Any:
        """One value, such as an image; its row group is cached because neighbors are usually read next."""
        return _group(self.path, column, group)[place].as_py()

    def _opened(self) -> Any:
        try:
            check_file(self.path)
            opened = parquet_module().ParquetFile(self.path)
            groups = (opened.metadata.row_group(number) for number in range(opened.num_row_groups))
            size = sum(group.total_byte_size for group in groups)
            check_expansion(self.path, size, self.path.stat().st_size, is_uniform=True)
            return opened
        except _DAMAGES as error:
            raise CaptureError(f"{self.path}: not a Parquet file that can be read ({error})") from None


@lru_cache(maxsize=2)
def _group(path: Path, column: str, group: int) -> Any:
    try:
        check_file(path)
        return parquet_module().ParquetFile(path).read_row_group(group, columns=[column]).column(column)
    except _DAMAGES as error:
        raise CaptureError(f"{path}: can't be read ({error})") from None


def _plain(value: Any) -> Any:
    """Python value of a pyarrow scalar; lists of numbers become arrays directly."""
    values = getattr(value, "values", None)
    if values is not None and value.is_valid:
        return np.asarray(values.to_numpy(zero_copy_only=False))
    return value.as_py()


@cache
def parquet_module() -> Any:
    try:
        return import_package("pyarrow.parquet", "a Parquet file of Waymo", "waymo")
    except MissingPackageError as error:
        raise CaptureError(str(error)) from None


# TFRecord, without TensorFlow
# A record is its length (u64), a checksum of these 8 bytes (u32), the content, and a checksum of it (u32), all little
# endian; a checksum is a CRC-32C rotated by 15 bits plus a constant. Facts: tensorflow/core/lib/io/record_writer.h.

_HEAD, _TAIL = struct.Struct("<QI"), struct.Struct("<I")
_POLYNOMIAL, _MASK = 0x82F63B78, 0xA282EAD8


@dataclass(frozen=True, slots=True)
class TFRecord:
    """Position of one record's content in a file."""

    file: Path
    start: int
    length: int

    def read(self) -> bytes:
        """Read the content. Raises `CaptureError` if the file became shorter or can't be read."""
        try:
            with open_file(self.file) as stream:
                stream.seek(self.start)
                content = stream.read(self.length)
        except OSError as error:
            raise CaptureError(f"{self.file}: can't be read ({error.strerror})") from None
        if len(content) != self.length:
            raise CaptureError(f"{self.file}: cut off inside a record")
        return content


def records_in(file: Path) -> Iterator[tuple[TFRecord, bytes]]:
    """Yield each record with its content. Raises `CaptureError` at the first damaged one."""
    with open_file(file) as stream:
        size, place = os.fstat(stream.fileno()).st_size, 0
        while place < size:
            head = stream.read(_HEAD.size)
            if len(head) < _HEAD.size:
                raise CaptureError(f"{file}: cut off at byte {place}")
            length, checksum = _HEAD.unpack(head)
            if masked_crc32c(head[:8]) != checksum:
                raise CaptureError(f"{file}: no TFRecord begins at byte {place} (checksum of its length)")
            if place + _HEAD.size + length + _TAIL.size > size:
                raise CaptureError(f"{file}: cut off inside the record at byte {place}")
            content, tail = stream.read(length), stream.read(_TAIL.size)
            if masked_crc32c(content) != _TAIL.unpack(tail)[0]:
                raise CaptureError(f"{file}: the record at byte {place} is damaged (checksum of its content)")
            yield TFRecord(file, place + _HEAD.size, length), content
            place += _HEAD.size + length + _TAIL.size


def masked_crc32c(content: bytes) -> int:
    """CRC-32C (Castagnoli) as masked in TFRecord."""
    crc = int(_crc32c(np.frombuffer(content, np.uint8), _TABLE))
    return (((crc >> 15) | (crc << 17)) + _MASK) & 0xFFFFFFFF


def _table() -> np.ndarray:
    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = np.where(table & 1, (table >> 1) ^ np.uint32(_POLYNOMIAL), table >> 1)
    return table.astype(np.uint32)


_TABLE = _table()


@kernel()
@no_type_check
def _crc32c(content, table):
    crc = np.uint32(0xFFFFFFFF)
    for k in range(content.size):
        crc = table[(crc ^ content[k]) & np.uint32(0xFF)] ^ (crc >> np.uint32(8))
    return crc ^ np.uint32(0xFFFFFFFF)


# Point clouds in PLY

_LARGEST_HEADER = 1 << 20
_MAX_TEXT_BYTES = 1 << 32
_COLORS = ("red", "green", "blue")


def read_point_ply(file: Path) -> tuple[Float64[np.ndarray, "p 3"], UInt8[np.ndarray, "p 3"] | None]:
    """Read finite points and their colors (0..255); raises `CaptureError` that names the file."""
    try:
        with open_file(file) as stream:
            text = b"\nformat ascii" in stream.read(_LARGEST_HEADER).partition(b"end_header")[0]
        columns = _text_columns(file) if text else _binary_columns(file)
    except (InputError, SceneFormatError) as error:
        raise CaptureError(str(error)) from None
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{file}: {error}") from None
    if not all(axis in columns for axis in "xyz"):
        raise CaptureError(f"{file}: its vertices have no x, y, z")
    points = np.stack([columns[axis] for axis in "xyz"], axis=1).astype(np.float64)
    finite = np.isfinite(points).all(axis=1)
    if not all(name in columns for name in _COLORS):
        return points[finite], None
    colors = np.stack([columns[name] for name in _COLORS], axis=1)[finite].astype(np.float64)
    whole = colors.max(initial=0) > 1 or columns["red"].dtype.kind in "iu"
    return points[finite], np.clip(colors if whole else colors * 255, 0, 255).astype(np.uint8)


def _binary_columns(file: Path) -> dict[str, np.ndarray]:
    with open_file(file) as stream:
        elements = read_ply_header(file, stream)
        if "vertex" not in elements:
            raise CaptureError(f"{file}: a PLY of points has an element 'vertex'")
        dtype, offset = element_rows(file, elements["vertex"])
        stream.seek(offset)
        rows = np.frombuffer(stream.read(elements["vertex"].nbytes), dtype)
    return {name: rows[name] for name in dtype.names or ()}


def _text_columns(file: Path) -> dict[str, np.ndarray]:
    """Columns of the element vertex, which must come first and have only scalar properties."""
    names: list[str] = []
    count, element = 0, ""
    with TextIOWrapper(open_file(file, _MAX_TEXT_BYTES), encoding="utf-8") as stream:
        for line in stream:
            match line.split():
                case ["element", element, number] if element != "vertex" or number.isdigit():
                    count = int(number[:12]) if element == "vertex" else count
                case ["property", "list", *_] if element == "vertex":
                    raise CaptureError(f"{file}: its vertices have lists")
                case ["property", _, name] if element == "vertex":
                    names.append(name)
                case ["end_header"]:
                    break
                case _:
                    pass
        try:
            values = np.array([[float(word) for word in line.split()] for line in islice(stream, count)], np.float64)
            columns = values.reshape(count, len(names)).T
        except ValueError:
            expected = f"{count} vertices of {len(names)} numbers were to come"
            raise CaptureError(f"{file}: {expected}, it is cut off or damaged") from None
    return dict(zip(names, columns, strict=True))
