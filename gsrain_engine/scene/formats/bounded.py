"""Decompression that never yields more than was asked for: damaged files and bombs end in one error, not in swap."""

import io
import zlib
from pathlib import Path

import zstandard

from ..errors import SceneFormatError
from .memory import check_room, gaussian_bytes

_LARGEST_EXPANSION = 200
"""Gaussians in memory over bytes of their file. Real SPZ and SOG scenes expand 6 to 30 times, bombs 1000 and more."""
_ALWAYS_ALLOWED_BYTES = 64 * 2**20
"""What a file of any size may expand to: scenes made of equal Gaussians compress without a bound."""
_LARGEST_ZSTD_WINDOW = 2**27
"""What zstd itself allows without being asked (windowLog 27)."""


def check_expansion(path: Path, count: int, coefficients: int, file_bytes: int) -> None:
    """Refuse a header that asks for more memory than is free, or than its file can fill out of proportion.

    `count` Gaussians have `coefficients` spherical harmonics a colour. Call it before anything of that size is made.
    """
    wanted = gaussian_bytes(count, coefficients)
    if wanted > max(_ALWAYS_ALLOWED_BYTES, _LARGEST_EXPANSION * file_bytes):
        raise SceneFormatError(
            path,
            f"the header speaks of {count} Gaussians ({wanted / 1e9:.1f} GB), "
            f"which can't be in a file of {file_bytes} bytes",
        )
    check_room(path, count, coefficients)


def gunzip_start(path: Path, data: bytes, size: int) -> bytes:
    """First `size` bytes of a gzip stream, fewer where it ends before."""
    try:
        return zlib.decompressobj(wbits=31).decompress(data, size)
    except zlib.error:
        raise SceneFormatError(path, "the gzip stream is damaged") from None


def gunzip(path: Path, data: bytes, at_most: int) -> bytes:
    """Unpack a whole gzip stream of at most `at_most` bytes, with its checksum."""
    stream = zlib.decompressobj(wbits=31)
    try:
        unpacked = stream.decompress(data, at_most + 1)
    except zlib.error:
        raise SceneFormatError(path, "the gzip stream is damaged") from None
    if len(unpacked) > at_most:
        raise SceneFormatError(path, f"the gzip stream holds more than the {at_most} bytes that the header speaks of")
    if not stream.eof:
        raise SceneFormatError(path, "the gzip stream ends too early: the file is cut off")
    return unpacked


def unzstd(path: Path, data: bytes, size: int, name: str) -> bytes:
    """Unpack one zstd frame of exactly `size` bytes; `name` says in errors what it holds."""
    decompressor = zstandard.ZstdDecompressor(max_window_size=_LARGEST_ZSTD_WINDOW)
    try:
        with decompressor.stream_reader(io.BytesIO(data)) as reader:
            unpacked = reader.read(size + 1)
    except zstandard.ZstdError:
        raise SceneFormatError(path, f"the zstd stream of {name} is damaged") from None
    if len(unpacked) != size:
        more = "more" if len(unpacked) > size else f"only {len(unpacked)}"
        raise SceneFormatError(path, f"the zstd stream of {name} must hold {size} bytes, it holds {more}")
    return unpacked
