"""Zip files of scenes, `.sog` and `.usdz`: written without compression, read member by member within limits."""

import io
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

from ...safe_io.errors import SceneFormatError

_ERRORS = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError, ValueError, OSError)
"""Exceptions of `zipfile` for damaged archives, found by experiment."""

_DATE = (1980, 1, 1, 0, 0, 0)  # the earliest that a zip file can have: the same contents make the same bytes
_LOCAL_HEADER_BYTES = 30
_PADDING = struct.Struct("<HH")  # kind and length of an extra field
_PADDING_KIND = 0x1986  # as USD's own writer uses; readers skip unknown kinds


def write_stored_zip(path: Path, members: Mapping[str, bytes | Path], alignment: int = 1) -> None:
    """Write files, or bytes, in this order, each beginning at a multiple of `alignment` bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, content in members.items():
            info = zipfile.ZipInfo(name, _DATE)
            if alignment > 1:
                start = archive.fp.tell() + _LOCAL_HEADER_BYTES + len(name.encode())  # pyright: ignore[reportOptionalMemberAccess]
                padding = -(start + _PADDING.size) % alignment
                info.extra = _PADDING.pack(_PADDING_KIND, padding) + bytes(padding)
            archive.writestr(info, content if isinstance(content, bytes) else content.read_bytes())


def open_zip(path: Path, data: bytes) -> zipfile.ZipFile:
    """Open the bytes of a zip file. Raises `SceneFormatError` if its list of contents is missing or damaged."""
    try:
        return zipfile.ZipFile(io.BytesIO(data))
    except _ERRORS:
        told = "not a whole zip file: its list of contents, which stands at its end, is missing or damaged"
        raise SceneFormatError(path, told) from None


def read_member(path: Path, archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """Read a stored or deflated member of at most `most` bytes, and verify its checksum.

    Raises `SceneFormatError` if it is missing, damaged, encrypted or larger.
    """
    try:
        member = archive.getinfo(name)
    except KeyError:
        raise SceneFormatError(path, f"there is no {name} in the zip file") from None
    if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise SceneFormatError(path, f"{name} in the zip file must be stored or deflated, without a password")
    if member.file_size > most:
        raise SceneFormatError(path, f"{name} has {member.file_size} bytes, at most {most} would be right")
    try:
        with archive.open(member) as file:
            return file.read(most)
    except _ERRORS:
        raise SceneFormatError(path, f"{name} in the zip file is damaged") from None
