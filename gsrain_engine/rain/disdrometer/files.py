"""Any disdrometer file in, one reading out: the format is told by what the file holds, not by its name."""

from dataclasses import replace
from pathlib import Path

from gsrain_engine.rain.disdrometer.class_mask import is_class_mask
from gsrain_engine.rain.disdrometer.contents import Contents, read_contents
from gsrain_engine.rain.disdrometer.installed_logs import read_by_packages
from gsrain_engine.rain.disdrometer.minute_tables import is_minute_table, read_minute_table
from gsrain_engine.rain.disdrometer.netcdf import is_netcdf, read_netcdf
from gsrain_engine.rain.disdrometer.parsivel_asdo import is_parsivel_asdo, read_parsivel_asdo
from gsrain_engine.rain.disdrometer.parsivel_logs import parsivel_log_dialect, read_parsivel_log
from gsrain_engine.rain.disdrometer.parsivel_telegrams import is_parsivel_telegrams, read_parsivel_telegrams
from gsrain_engine.rain.disdrometer.rates_only import is_rainsense_intensity, read_rainsense_intensity
from gsrain_engine.rain.disdrometer.reading import DisdrometerFileError, Reading, SingleDrops, UnknownKindError
from gsrain_engine.rain.disdrometer.tables import TableColumns, read_table, table_columns
from gsrain_engine.rain.disdrometer.thies import is_thies, read_thies
from gsrain_engine.untrusted.file_kinds import kind_of_bytes

__all__ = ["DisdrometerFileError", "Reading", "SingleDrops", "UnknownKindError", "read_disdrometer"]

_TEXTS = (
    (is_parsivel_telegrams, read_parsivel_telegrams),
    (is_thies, read_thies),
    (is_minute_table, read_minute_table),
    (is_rainsense_intensity, read_rainsense_intensity),
)


def read_disdrometer(path: Path, columns: TableColumns | None = None) -> Reading:
    """Read a disdrometer file: OTT Parsivel, Thies LNM, Joss-Waldvogel, 2DVD, APU, RainSense's intensity; gzip or not.

    A table of text is read by its `columns` where they are given. Records that can't be used are left out and named in
    `Reading.skipped`. Raises `DisdrometerFileError` where none is left, `UnknownKindError` where the file is of no
    known kind.
    """
    contents = read_contents(path)
    if columns is not None:
        if not contents.is_text:
            raise DisdrometerFileError(path, "not a text: columns describe a table of text")
        return _with_cut(read_table(path, contents.lines, columns), contents)
    if is_netcdf(contents.data):
        if contents.cut_off:
            raise DisdrometerFileError(path, "the gzip stream ends too early: the NetCDF file in it is cut off")
        return read_netcdf(path, contents.data)
    if not contents.is_text:
        raise _unknown_kind(contents, "neither text nor NetCDF")
    return _with_cut(_read_text(path, contents), contents)


def _with_cut(reading: Reading, contents: Contents) -> Reading:
    if contents.cut_off:
        return replace(reading, skipped=(*reading.skipped, "end of file: the gzip stream is cut off"))
    return reading


def _read_text(path: Path, contents: Contents) -> Reading:
    lines = contents.lines
    dialect = parsivel_log_dialect(lines)
    if dialect is not None:
        return read_parsivel_log(path, lines, dialect)
    if is_parsivel_asdo(lines):
        return read_parsivel_asdo(path, lines)
    columns = table_columns(lines)
    if columns is not None:
        return read_table(path, lines, columns)
    for recognizes, read in _TEXTS:
        if recognizes(lines):
            return read(path, lines)
    if is_class_mask(lines):
        raise DisdrometerFileError(path, "a mask of diameters and speeds, no measurement")
    reading = read_by_packages(path, lines)
    if reading is not None:
        return reading
    raise _unknown_kind(contents, "line 1")


def _unknown_kind(contents: Contents, where: str) -> UnknownKindError:
    """Name the kind that the file is of, where its first bytes say it; else the kinds that can be read."""
    path = contents.path
    kind = kind_of_bytes(contents.data, path.suffix.lower())
    return UnknownKindError(path, f"{where}: not a disdrometer file of a kind that is known", kind)
