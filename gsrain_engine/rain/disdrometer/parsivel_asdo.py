"""Text files of ASDO, OTT's own program for the Parsivel: columns that a person chose, then the spectrum."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gsrain_engine.rain.disdrometer.instruments import PARSIVEL
from gsrain_engine.rain.disdrometer.parsivel_classes import CLASSES
from gsrain_engine.rain.disdrometer.reading import DisdrometerFileError, Reading
from gsrain_engine.rain.disdrometer.records import Record, RecordError, drop_counts, gather, rain_rate, utc

_COUNTS = CLASSES * CLASSES
_OPEN, _CLOSE = "<SPECTRUM>", "</SPECTRUM>"
_LOOK_AHEAD = 40
_SEPARATORS = ";\t,"
_YEAR_FIRST = ("%Y/%m/%d", "%Y-%m-%d", "%d.%m.%Y", "%d.%m.%y")
_DAY_FIRST, _MONTH_FIRST = ("%d/%m/%Y", "%d-%m-%Y"), ("%m/%d/%Y", "%m-%d-%Y")
_SLASHED = re.compile(r"^\"?(\d{1,2})[/-](\d{1,2})[/-]\d{4}")
_SNOW = re.compile("snow|schnee|neige|nieve|neve", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class _Columns:
    """Where the date, the time and the rain rate stand."""

    separator: str
    dates: tuple[str, ...]
    """Forms that dates may have."""
    names: tuple[str, ...] = ()
    """As the header has them; empty where there is none."""
    date: int = 0
    time: int = 1
    rate: int = 2


def is_parsivel_asdo(lines: list[str]) -> bool:
    """Whether a text is ASDO's, by its first lines."""
    return any(_OPEN in line for line in lines[:_LOOK_AHEAD])


def read_parsivel_asdo(path: Path, lines: list[str]) -> Reading:
    """Read an ASDO file; where it has no header, date, time and rain rate come first.

    Raises `DisdrometerFileError` where no record can be used, or where its header has no rain rate or changes.
    """
    columns = _columns_of(path, lines)
    records, skipped = gather(path, _records(path, lines, columns), lambda line: _record(line, columns))
    return PARSIVEL.reading_of(path, records, "velocities first", skipped)


def _columns_of(path: Path, lines: list[str]) -> _Columns:
    first = next(line for line in lines if _OPEN in line).partition(_OPEN)[0]
    separator = max(_SEPARATORS, key=first.count)
    dates = _YEAR_FIRST + (_MONTH_FIRST if _months_first(lines) else _DAY_FIRST)
    header = next((line for line in lines[:_LOOK_AHEAD] if _is_header(line, separator)), None)
    if header is None:
        return _Columns(separator, dates)
    names = _names(header, separator)
    rate = next((i for i, name in enumerate(names) if "intens" in name and not _SNOW.search(name)), None)
    if rate is None:
        raise DisdrometerFileError(path, "its header names no intensity of precipitation: choose it in ASDO, too")
    date = next((i for i, name in enumerate(names) if name.startswith(("dat", "fech"))), 0)
    time = next((i for i, name in enumerate(names) if name.startswith(("time", "zeit", "uhr", "heure", "hora"))), 1)
    return _Columns(separator, dates, names, date, time, rate)


def _is_header(line: str, separator: str) -> bool:
    return _OPEN not in line and line.count(separator) >= 2 and not line.lstrip('" ')[:1].isdigit()


def _names(header: str, separator: str) -> tuple[str, ...]:
    return tuple(name.strip(' "').lower() for name in header.split(separator))


def _months_first(lines: list[str]) -> bool:
    """Whether 4/13/2024 stands somewhere; otherwise 4/3/2024 is the fourth of March."""
    found = (_SLASHED.match(line) for line in lines)
    return any(int(each[2]) > 12 for each in found if each is not None)


def _records(path: Path, lines: list[str], columns: _Columns) -> Iterator[tuple[str, str]]:
    for i, line in enumerate(lines):
        if not line.strip():
            continue
        if columns.names and _is_header(line, columns.separator):  # one stands wherever recording began again
            if _names(line, columns.separator) != columns.names:
                raise DisdrometerFileError(path, f"line {i + 1}: its columns are not those before it: split the file")
            continue
        yield f"line {i + 1}", line


def _record(line: str, columns: _Columns) -> Record:
    """Chosen columns;<SPECTRUM>counts, none for 0</SPECTRUM>, or ZERO for all."""
    head, opened, rest = line.partition(_OPEN)
    spectrum, closed, _ = rest.partition(_CLOSE)
    if not opened or not closed:
        raise RecordError("the spectrum is not whole: the record is cut off")
    values = [value.strip(' "') for value in head.split(columns.separator)]
    least = max(len(columns.names), columns.rate + 2)  # the last is empty, before the spectrum
    if len(values) < least:
        raise RecordError(f"{len(values) - 1} fields before the spectrum instead of {least - 1}")
    rate = values[columns.rate]
    separator = max(";,\t", key=spectrum.count)
    counts = [value.strip() or "0" for value in spectrum.removesuffix(separator).split(separator)]
    return Record(
        time=utc(f"{values[columns.date]} {values[columns.time]}", *(f"{form} %H:%M:%S" for form in columns.dates)),
        seconds=float("nan"),
        reported_mm_h=rain_rate(rate if columns.separator == "," else rate.replace(",", ".")),
        counts=np.zeros(_COUNTS) if spectrum.strip() == "ZERO" else drop_counts(counts, _COUNTS),
    )
