"""The bytes of a disdrometer file: inflated where gzip holds them, and never more than memory allows."""

import zlib
from dataclasses import dataclass
from pathlib import Path

from gsrain_engine.rain.disdrometer.reading import DisdrometerFileError
from gsrain_engine.untrusted.limits import TooLargeError, read_file

LARGEST_FILE = 256 * 2**20
"""Bytes, after inflation: about two months of a Parsivel's minutes as text."""

MOST_LINES = 8_000_000
"""Of text: a telegram has a line a field, and some hundred bytes in each three or four."""

_GZIP_MAGIC = b"\x1f\x8b"
_GZIP_WINDOW = 31
_BLOCK = 2**20
_TEXT_CONTROLS = b"\t\n\v\f\r\x02\x03\x04\x1a"  # telegrams begin with STX and end with ETX


@dataclass(frozen=True, slots=True)
class Contents:
    """A file in memory."""

    path: Path
    data: bytes
    cut_off: bool
    """A gzip stream that ended too early: the rest of the file is missing."""

    @property
    def is_text(self) -> bool:
        """Whether the first 4 KiB are text in any encoding that keeps ASCII."""
        start = self.data[:4096]
        return bool(start) and not any(byte < 32 and byte not in _TEXT_CONTROLS for byte in start)

    @property
    def lines(self) -> list[str]:
        """Lines of text without their ends; Latin-1, which every byte is valid in."""
        if self.data.count(b"\n") > MOST_LINES:
            raise DisdrometerFileError(self.path, f"the file holds more than {MOST_LINES:,} lines: split it by days")
        text = self.data.decode("latin-1").removeprefix("\u00ef\u00bb\u00bf")
        return [line.rstrip("\r") for line in text.split("\n")]


def read_contents(path: Path) -> Contents:
    """Read a whole file, inflating gzip.

    Raises `DisdrometerFileError` where the file is absent, empty, larger than `LARGEST_FILE`, or its gzip stream
    damaged. A gzip stream that is only cut off gives what came before the cut.
    """
    try:
        data = read_file(path, LARGEST_FILE)
    except TooLargeError:
        raise _too_large(path) from None
    except OSError as error:
        raise DisdrometerFileError(path, error.strerror or str(error)) from None
    cut_off = False
    if data.startswith(_GZIP_MAGIC):
        data, cut_off = _inflate(path, data)
    if not data:
        raise DisdrometerFileError(path, "the file is empty")
    if len(data) > LARGEST_FILE:
        raise _too_large(path)
    return Contents(path, data, cut_off)


def _too_large(path: Path) -> DisdrometerFileError:
    return DisdrometerFileError(path, f"the file holds more than {LARGEST_FILE // 2**20} MiB: split it by days")


def _inflate(path: Path, data: bytes) -> tuple[bytes, bool]:
    """Inflate one gzip member after the other, up to one byte more than `LARGEST_FILE`; whether the last is cut off."""
    parts: list[bytes] = []
    size = 0
    while data.startswith(_GZIP_MAGIC):
        member = zlib.decompressobj(_GZIP_WINDOW)
        while not member.eof and size <= LARGEST_FILE:
            try:
                part = member.decompress(data, min(_BLOCK, LARGEST_FILE + 1 - size))
            except zlib.error as error:
                raise DisdrometerFileError(path, f"the gzip stream is damaged ({error})") from None
            data = member.unconsumed_tail
            if not part and not data and not member.eof:
                return b"".join(parts), True
            parts.append(part)
            size += len(part)
        if size > LARGEST_FILE:
            break
        data = member.unused_data
    return b"".join(parts), False
