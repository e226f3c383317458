"""Thies laser precipitation monitor (LNM, LPM): telegrams of 22 diameters x 20 speeds, bare or wrapped by a station."""

import re
from collections.abc import Iterator
from pathlib import Path

from .instruments import THIES
from .spectra import (
    FACTORY_SECONDS,
    DisdrometerReading,
    RecordError,
    SpectrumRecord,
    numbered_lines,
    parse_drop_counts,
    parse_rain_rate,
    parse_records,
    parse_utc,
)
from .tables import rates_reading

_TELEGRAM = re.compile(r"(?:^|[\"\x02;])(\d\d;\d{4};\d\.\d\d;\d\d\.\d\d\.\d\d(?:\d\d)?;\d\d:\d\d:\d\d;.*)$")
_LOGGED_TIME = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d")
_DATE, _TIME, _RATE, _SHORT, _SPECTRUM = 3, 4, 12, 22, 79
_COUNTS = 22 * 20
_LOOK_AHEAD = 20


def is_thies(lines: list[str]) -> bool:
    """Return whether one of the first lines contains a Thies telegram."""
    return any(_TELEGRAM.search(line) for line in lines[:_LOOK_AHEAD])


def read_thies(path: Path, lines: list[str]) -> DisdrometerReading:
    """Read telegrams, one a line, bare or after a logger's time; without spectra, the reading has rates and no drops.

    Raises `DisdrometerFileError` if no record is usable.
    """
    numbered = list(_telegrams(lines))
    if all(len(_values(text)) <= _SHORT for _, text in numbered):
        return rates_reading(THIES.name, parse_records(path, numbered, _short_record))
    return THIES.reading(path, parse_records(path, numbered, _record), "diameters first")


def _telegrams(lines: list[str]) -> Iterator[tuple[str, str]]:
    """Nonempty lines from the first telegram on."""
    first = next(i for i, line in enumerate(lines) if _TELEGRAM.search(line))
    return numbered_lines(lines[first:], first + 1)


def _values(line: str) -> list[str]:
    match = _TELEGRAM.search(line)
    return match[1].rstrip('\r\n\x03" ').rstrip(";").split(";") if match else []


def _record(line: str) -> SpectrumRecord:
    values = _values(line)
    if len(values) < _SPECTRUM + _COUNTS:
        raise RecordError(f"{len(values)} values instead of {_SPECTRUM + _COUNTS} or more: the telegram is cut off")
    return _with_counts(line, values, values[_SPECTRUM : _SPECTRUM + _COUNTS])


def _short_record(line: str) -> SpectrumRecord:
    values = _values(line)
    if len(values) <= _RATE:
        raise RecordError(f"{len(values)} values: no rain rate")
    return _with_counts(line, values, [])


def _with_counts(line: str, values: list[str], counts: list[str]) -> SpectrumRecord:
    logged = _LOGGED_TIME.search(line)
    if logged:
        time = parse_utc(logged[0], "%Y-%m-%d %H:%M:%S")
    else:
        time = parse_utc(f"{values[_DATE]} {values[_TIME]}", "%d.%m.%y %H:%M:%S", "%d.%m.%Y %H:%M:%S")
    return SpectrumRecord(
        time=time,
        seconds=FACTORY_SECONDS,
        reported_mm_h=parse_rain_rate(values[_RATE]),
        counts=parse_drop_counts(counts, len(counts)),
    )
