"""OTT Parsivel text files: ASDO exports, station logs, and telegrams."""

import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from .instruments import CLASSES, PARSIVEL
from .spectra import (
    DisdrometerFileError,
    DisdrometerReading,
    RecordError,
    SpectrumRecord,
    numbered_lines,
    parse_drop_counts,
    parse_interval_s,
    parse_rain_rate,
    parse_records,
    parse_utc,
)

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
    """Columns of the date, the time and the rain rate in an ASDO export, whose user chooses the columns."""

    separator: str
    dates: tuple[str, ...]
    """Possible date formats."""
    names: tuple[str, ...] = ()
    """Names in the header; empty without a header."""
    date: int = 0
    time: int = 1
    rate: int = 2


def is_parsivel_asdo(lines: list[str]) -> bool:
    """Return whether the first lines are from ASDO, OTT's own program for the Parsivel."""
    return any(_OPEN in line for line in lines[:_LOOK_AHEAD])


def read_parsivel_asdo(path: Path, lines: list[str]) -> DisdrometerReading:
    """Read an ASDO file; without a header, date, time and rain rate are the first columns.

    Raises `DisdrometerFileError` if no record is usable, or if the header lacks a rain rate or changes.
    """
    columns = _columns_of(path, lines)
    records = parse_records(path, _records(path, lines, columns), lambda line: _record(line, columns))
    return PARSIVEL.reading(path, records, "velocities first")


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
    """Return whether a date like 4/13/2024 occurs; otherwise 4/3/2024 means 4 March."""
    found = (_SLASHED.match(line) for line in lines)
    return any(int(each[2]) > 12 for each in found if each is not None)


def _records(path: Path, lines: list[str], columns: _Columns) -> Iterator[tuple[str, str]]:
    for where, line in numbered_lines(lines):
        if not columns.names or not _is_header(line, columns.separator):
            yield where, line
        elif _names(line, columns.separator) != columns.names:  # each restart of the recording repeats the header
            raise DisdrometerFileError(path, f"{where}: its columns are not those before it: split the file")


def _record(line: str, columns: _Columns) -> SpectrumRecord:
    """Parse user-chosen columns;<SPECTRUM>counts, empty for 0</SPECTRUM>, or ZERO for an empty spectrum."""
    head, opened, rest = line.partition(_OPEN)
    spectrum, closed, _ = rest.partition(_CLOSE)
    if not opened or not closed:
        raise RecordError("the spectrum is not whole: the record is cut off")
    values = [value.strip(' "') for value in head.split(columns.separator)]
    least = max(len(columns.names), columns.rate + 2)  # the last value is empty, before the spectrum
    if len(values) < least:
        raise RecordError(f"{len(values) - 1} fields before the spectrum instead of {least - 1}")
    rate = values[columns.rate]
    separator = max(";,\t", key=spectrum.count)
    counts = [value.strip() or "0" for value in spectrum.removesuffix(separator).split(separator)]
    return SpectrumRecord(
        time=parse_utc(
            f"{values[columns.date]} {values[columns.time]}", *(f"{form} %H:%M:%S" for form in columns.dates)
        ),
        seconds=float("nan"),
        reported_mm_h=parse_rain_rate(rate if columns.separator == "," else rate.replace(",", ".")),
        counts=np.zeros(_COUNTS) if spectrum.strip() == "ZERO" else parse_drop_counts(counts, _COUNTS),
    )


# Station logs

_LOG_LOOK_AHEAD = 20


class Dialect(NamedTuple):
    """Record format of one kind of log."""

    marks: re.Pattern[str]
    """Pattern that occurs only in lines of this dialect."""
    parse: Callable[[str], SpectrumRecord]
    """Line parser; raises `RecordError` if the line is unusable."""


def is_parsivel_log(lines: list[str]) -> bool:
    """Return whether one of the first lines has the marks of a dialect."""
    return _dialect(lines) is not None


def read_parsivel_log(path: Path, lines: list[str]) -> DisdrometerReading:
    """Read a station's log; raises `DisdrometerFileError` if no record is usable."""
    dialect = _dialect(lines)
    assert dialect is not None
    return PARSIVEL.reading(path, parse_records(path, numbered_lines(lines), dialect.parse), "velocities first")


def _dialect(lines: list[str]) -> Dialect | None:
    start = [line for line in lines[: 2 * _LOG_LOOK_AHEAD] if line.strip()][:_LOG_LOOK_AHEAD]
    found = (dialect for dialect in _DIALECTS if any(dialect.marks.search(line) for line in start))
    return next(found, None)


def parsivel_counts(text: str, separator: str) -> Float64[np.ndarray, " 1024"]:
    """Counts of one spectrum, with or without a trailing separator."""
    return parse_drop_counts(text.strip().removesuffix(separator).split(separator), _COUNTS)


def _fields(line: str, at_least: int) -> list[str]:
    try:
        values = next(csv.reader([line]))
    except csv.Error as error:
        raise RecordError(f"the line can't be split into fields ({error})") from None
    if len(values) < at_least:
        raise RecordError(f"{len(values)} fields instead of {at_least}: the record is cut off")
    return values


def _locarno(line: str) -> SpectrumRecord:
    """Parse id, lat, lon, time, logger T, logger V, rate, ..., "32 N(D)", "32 v(D)", "1024 counts"."""
    values = _fields(line, 23)
    return SpectrumRecord(
        time=parse_utc(values[3], "%d-%m-%Y %H:%M:%S"),
        seconds=float("nan"),
        reported_mm_h=parse_rain_rate(values[6]),
        counts=parsivel_counts(values[22], ","),
    )


def _station(line: str) -> SpectrumRecord:
    """Parse time; rate; ...; interval (6); ...; 32 N(D); 32 v(D); 1024 counts, joined by ; or by /."""
    values = line.strip().split(";")
    if not re.match(r"\d{14}", values[0]):
        raise RecordError("the line doesn't begin with a time: the record is cut off")
    if len(values) < 83:
        raise RecordError(f"{len(values)} fields instead of at least 83: the record is cut off")
    slashed = "/" in values[82]
    counts = values[82].removesuffix("R").removesuffix("/") if slashed else ";".join(values[82:])
    return SpectrumRecord(
        time=parse_utc(values[0], "%Y%m%d%H%M%S", "%Y%m%d%H%M%S.%f"),
        seconds=parse_interval_s(values[6]),
        reported_mm_h=parse_rain_rate(values[1]),
        counts=parsivel_counts(counts, "/" if slashed else ";"),
    )


_FULL_HEAD, _FULL_CLASSES = 30, 64


def _full(line: str) -> SpectrumRecord:
    """Parse fields 01 to 30 of a telegram, 32 N(D), 32 v(D) and 1024 counts, joined by ;, and the logger's time."""
    values = line.strip().split(";")
    counts = values[_FULL_HEAD + _FULL_CLASSES :][:_COUNTS]
    logged = "".join(values[_FULL_HEAD + _FULL_CLASSES + _COUNTS :][:1])
    if len(counts) < _COUNTS:
        raise RecordError(f"{len(counts)} drop counts instead of {_COUNTS}: the record is cut off")
    own = f"{values[20]} {values[19]}"  # of the instrument, whose clock is rarely set
    return SpectrumRecord(
        time=parse_utc(logged, "%Y-%m-%d %H:%M:%S") if logged else parse_utc(own, "%d.%m.%Y %H:%M:%S"),
        seconds=parse_interval_s(values[8]),
        reported_mm_h=parse_rain_rate(values[0]),
        counts=parse_drop_counts(counts, _COUNTS),
    )


_DIALECTS = (
    Dialect(re.compile(r'^\d+,[\d.]+,[\d.]+,"\d\d-\d\d-\d{4} \d\d:\d\d:\d\d","'), _locarno),
    Dialect(re.compile(r"^\d{14}(\.\d+)?;[^;]*;[^;]*;[^;]*;[^;]*;[^;]*;\d+;"), _station),
    Dialect(re.compile(r"^(\d{4}\.\d{3}|NAN);\d{4}\.\d\d;\d\d;\d\d;[^;]*;[^;]*;-?\d+\.\d+;\d{4,5};\d{5};"), _full),
)

# Telegrams (Parsivel2 manual, section 11.2)

_FIELD = re.compile(r"^(\d\d):(.*)")
_FIRST = "01"
_NEEDED = {"01": "rain rate", "20": "time", "21": "date", "93": "raw spectrum"}


def is_parsivel_telegrams(lines: list[str]) -> bool:
    """Return whether a telegram with a rain rate begins within the first 200 lines."""
    return any(re.match(r"^01:(\d+\.\d+|NAN)\s*$", line) for line in lines[:200])


def read_parsivel_telegrams(path: Path, lines: list[str]) -> DisdrometerReading:
    """Read telegrams that begin with field 01; raises `DisdrometerFileError` if none is complete."""
    return PARSIVEL.reading(path, parse_records(path, _telegrams(lines), _telegram_record), "velocities first")


def _telegrams(lines: list[str]) -> Iterator[tuple[str, str]]:
    start = 0
    for i, line in enumerate([*lines, f"{_FIRST}:"]):
        if line.startswith(f"{_FIRST}:"):
            if any(_FIELD.match(each) for each in lines[start:i]):
                yield f"telegram at line {start + 1}", "\n".join(lines[start:i])
            start = i


def _telegram_record(telegram: str) -> SpectrumRecord:
    fields = {match[1]: match[2] for line in telegram.split("\n") if (match := _FIELD.match(line))}
    for field, name in _NEEDED.items():
        if field not in fields:
            raise RecordError(f"field {field} ({name}) is missing: the telegram lacks it, or is cut off")
    return SpectrumRecord(
        time=parse_utc(f"{fields['21'].strip()} {fields['20'].strip()}", "%d.%m.%Y %H:%M:%S", "%d.%m.%y %H:%M:%S"),
        seconds=parse_interval_s(fields["09"]) if "09" in fields else float("nan"),
        reported_mm_h=parse_rain_rate(fields["01"]),
        counts=parsivel_counts(fields["93"], ";"),
    )
