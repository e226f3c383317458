"""Reader of disdrometer files of any format, detected from the content rather than the name."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from ..optional_packages import MissingPackageError, require_package
from ..plugins import DISDROMETERS, ExtensionError, load_extensions
from ..safe_io.file_kinds import kind_of_bytes
from ..safe_io.limits import TooLargeError, read_file
from .hdf5_trial import HDF5, NETCDF_CLASSIC
from .instruments import CLASSES
from .parsivel import (
    is_parsivel_asdo,
    is_parsivel_log,
    is_parsivel_telegrams,
    read_parsivel_asdo,
    read_parsivel_log,
    read_parsivel_telegrams,
)
from .spectra import DisdrometerFileError, DisdrometerReading, UnknownKindError
from .tables import (
    TableColumns,
    is_minute_table,
    is_named_table,
    is_rainsense_intensity,
    read_minute_table,
    read_rainsense_intensity,
    read_table,
)
from .thies import is_thies, read_thies

_TEXTS = (
    (is_parsivel_log, read_parsivel_log),
    (is_parsivel_asdo, read_parsivel_asdo),
    (is_named_table, read_table),
    (is_parsivel_telegrams, read_parsivel_telegrams),
    (is_thies, read_thies),
    (is_minute_table, read_minute_table),
    (is_rainsense_intensity, read_rainsense_intensity),
)


def read_disdrometer(path: Path, columns: TableColumns | None = None) -> DisdrometerReading:
    """Read a disdrometer file: OTT Parsivel, Thies LNM, Joss-Waldvogel, 2DVD, APU, RainSense's intensity; gzip or not.

    A text table is read by `columns` if given. Unusable records are skipped and listed in `DisdrometerReading.skipped`.
    Raises `DisdrometerFileError` if none is left, `UnknownKindError` if the format is unknown.
    """
    contents = read_contents(path)
    if columns is not None:
        if not contents.is_text:
            raise DisdrometerFileError(path, "not a text: columns describe a table of text")
        return _with_cut(read_table(path, contents.lines, columns), contents)
    if is_netcdf(contents.data):
        if contents.cut_off:
            raise DisdrometerFileError(path, "the gzip stream ends too early: the NetCDF file in it is cut off")
        try:
            require_netcdf("a NetCDF file")
        except MissingPackageError as error:
            raise DisdrometerFileError(path, str(error)) from None
        from .open_netcdf import read_netcdf  # loads slowly

        return read_netcdf(path, contents.data)
    if not contents.is_text:
        raise _unknown_kind(contents, "neither text nor NetCDF")
    return _with_cut(_read_text(path, contents), contents)


def _with_cut(reading: DisdrometerReading, contents: "FileContents") -> DisdrometerReading:
    if contents.cut_off:
        return replace(reading, skipped=(*reading.skipped, "end of file: the gzip stream is cut off"))
    return reading


def _read_text(path: Path, contents: "FileContents") -> DisdrometerReading:
    lines = contents.lines
    for recognizes, read in _TEXTS:
        if recognizes(lines):
            return read(path, lines)
    if is_class_mask(lines):
        raise DisdrometerFileError(path, "a mask of diameters and speeds, no measurement")
    reading = read_by_packages(path, lines)
    if reading is not None:
        return reading
    raise _unknown_kind(contents, "line 1")


def is_class_mask(lines: list[str]) -> bool:
    """Return whether there are 32 rows of 32 zeros and ones: classes of a Parsivel, like PyDSD's conditional matrix."""
    rows = [
        [value.strip() for value in line.strip().removesuffix(",").split(",")]
        for line in lines[: CLASSES + 2]
        if line.strip()
    ]
    return len(rows) == CLASSES and all(len(row) == CLASSES and set(row) <= {"0", "1"} for row in rows)


def _unknown_kind(contents: "FileContents", where: str) -> UnknownKindError:
    """Error with the file's actual kind if its first bytes identify one, otherwise with the readable kinds."""
    path = contents.path
    kind = kind_of_bytes(contents.data, path.name)
    return UnknownKindError(path, f"{where}: not a disdrometer file of a kind that is known", kind)


# File contents

LARGEST_FILE = 256 * 2**20
"""Bytes after inflation: about two months of one-minute Parsivel records as text."""

MAX_LINES = 8_000_000
"""Maximum number of text lines: a telegram has one line a field, with some hundred bytes in three or four."""

_GZIP_MAGIC = b"\x1f\x8b"
_GZIP_WINDOW = 31
_BLOCK = 2**20
_TEXT_CONTROLS = b"\t\n\v\f\r\x02\x03\x04\x1a"  # telegrams begin with STX and end with ETX


@dataclass(frozen=True, slots=True)
class FileContents:
    """Bytes of a file after inflation."""

    path: Path
    data: bytes
    cut_off: bool
    """True for a gzip stream that ended too early; the rest of the file is missing."""

    @property
    def is_text(self) -> bool:
        """True if the first 4 KiB are text in any encoding that extends ASCII."""
        start = self.data[:4096]
        return bool(start) and not any(byte < 32 and byte not in _TEXT_CONTROLS for byte in start)

    @property
    def lines(self) -> list[str]:
        """Lines without their ends, decoded as Latin-1, in which every byte is valid."""
        if self.data.count(b"\n") > MAX_LINES:
            raise DisdrometerFileError(self.path, f"the file holds more than {MAX_LINES:,} lines: split it by days")
        text = self.data.decode("latin-1").removeprefix("\u00ef\u00bb\u00bf")
        return [line.rstrip("\r") for line in text.split("\n")]


def read_contents(path: Path) -> FileContents:
    """Read a whole file, inflating gzip.

    Raises `DisdrometerFileError` if the file is absent, empty or larger than `LARGEST_FILE`, or its gzip stream is
    damaged. A truncated gzip stream gives the data before the cut.
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
    return FileContents(path, data, cut_off)


def require_netcdf(feature: str) -> None:
    """Raise `MissingPackageError` if a library for NetCDF files is missing; `feature` needs it."""
    for library in ("xarray", "h5netcdf"):
        require_package(library, feature)


def is_netcdf(data: bytes) -> bool:
    """Return whether the data begins like NetCDF, classic or HDF5."""
    return data.startswith((*NETCDF_CLASSIC, HDF5))


def _too_large(path: Path) -> DisdrometerFileError:
    return DisdrometerFileError(path, f"the file holds more than {LARGEST_FILE // 2**20} MiB: split it by days")


def _inflate(path: Path, data: bytes) -> tuple[bytes, bool]:
    """Inflate gzip members up to one byte more than `LARGEST_FILE`; also return whether the last is truncated."""
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


# Text formats from installed packages


@dataclass(frozen=True, slots=True)
class LogFormat:
    """Text format of disdrometer files."""

    recognizes: Callable[[list[str]], bool]
    """Fast check, without exceptions, that lines look like this format."""
    read: Callable[[Path, list[str]], DisdrometerReading]
    """Parser; raises `DisdrometerFileError` if no record is usable."""


def read_by_packages(path: Path, lines: list[str]) -> DisdrometerReading | None:
    """Read lines by the first installed package that recognizes them; None if none does.

    Raises `DisdrometerFileError` if that package fails.
    """
    for extension, kind in load_extensions(DISDROMETERS, LogFormat):
        try:
            if kind.recognizes(lines):
                return extension.expect(kind.read(path, lines), DisdrometerReading, "reads")
        except (DisdrometerFileError, OSError, MemoryError):
            raise
        except ExtensionError as error:
            raise DisdrometerFileError(path, str(error)) from error
        except Exception as error:  # third-party code: its message becomes the reason
            raise DisdrometerFileError(path, str(extension.unfit(error))) from error
    return None
