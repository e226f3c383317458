"""Reads TFRecord files without TensorFlow: where their records lie, each checked by its CRC-32C.

A record is its length (u64), a checksum of these 8 bytes (u32), the content, and a checksum of that (u32), all little
endian; a checksum is masked: turned by 15 bits, plus a constant. Facts: tensorflow/core/lib/io/record_writer.h.
"""

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import no_type_check

import numpy as np
from numba import njit

from gsrain_engine.untrusted.limits import open_file

from ..capture import CaptureError

_HEAD, _TAIL = struct.Struct("<QI"), struct.Struct("<I")
_POLYNOMIAL, _MASK = 0x82F63B78, 0xA282EAD8


@dataclass(frozen=True, slots=True)
class TFRecord:
    """Where the content of one record lies in a file."""

    file: Path
    start: int
    length: int

    def read(self) -> bytes:
        """Content. Raises `CaptureError` where the file became shorter or can't be read."""
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
    """Yield each record with its content. Raises `CaptureError` at the first that is damaged."""
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
    """CRC-32C (Castagnoli) as TFRecord masks it."""
    crc = int(_crc32c(np.frombuffer(content, np.uint8), _TABLE))
    return (((crc >> 15) | (crc << 17)) + _MASK) & 0xFFFFFFFF


def _table() -> np.ndarray:
    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = np.where(table & 1, (table >> 1) ^ np.uint32(_POLYNOMIAL), table >> 1)
    return table.astype(np.uint32)


_TABLE = _table()


@njit(cache=True)
@no_type_check
def _crc32c(content, table):
    crc = np.uint32(0xFFFFFFFF)
    for k in range(content.size):
        crc = table[(crc ^ content[k]) & np.uint32(0xFF)] ^ (crc >> np.uint32(8))
    return crc ^ np.uint32(0xFFFFFFFF)
