"""OTT Parsivel logs, one record a line: the dialects that stations write."""

import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from gsrain_engine.rain.disdrometer.instruments import PARSIVEL
from gsrain_engine.rain.disdrometer.parsivel_classes import CLASSES
from gsrain_engine.rain.disdrometer.reading import Reading
from gsrain_engine.rain.disdrometer.records import Record, RecordError, drop_counts, gather, interval_s, rain_rate, utc

_COUNTS = CLASSES * CLASSES
_LOOK_AHEAD = 20


@dataclass(frozen=True, slots=True)
class Dialect:
    """How one kind of log writes its records."""

    marks: re.Pattern[str]
    """Found in a line that only this kind of log has."""
    parse: Callable[[str], Record]
    """Raises `RecordError` where the line can't be used."""


def parsivel_log_dialect(lines: list[str]) -> Dialect | None:
    """The dialect of a log by its first lines; none where it is not one."""
    start = [line for line in lines[: 2 * _LOOK_AHEAD] if line.strip()][:_LOOK_AHEAD]
    found = (dialect for dialect in _DIALECTS if any(dialect.marks.search(line) for line in start))
    return next(found, None)


def read_parsivel_log(path: Path, lines: list[str], dialect: Dialect) -> Reading:
    """Read a log of this dialect; raises `DisdrometerFileError` where no record can be used."""
    records, skipped = gather(path, _records(lines), dialect.parse)
    return PARSIVEL.reading_of(path, records, "velocities first", skipped)


def _records(lines: list[str]) -> Iterator[tuple[str, str]]:
    for i, line in enumerate(lines):
        if line.strip():
            yield f"line {i + 1}", line


def parsivel_counts(text: str, separator: str) -> Float64[np.ndarray, " 1024"]:
    """Counts of one spectrum, with or without a separator at the end."""
    return drop_counts(text.strip().removesuffix(separator).split(separator), _COUNTS)


def _fields(line: str, at_least: int) -> list[str]:
    try:
        values = next(csv.reader([line]))
    except csv.Error as error:
        raise RecordError(f"the line can't be split into fields ({error})") from None
    if len(values) < at_least:
        raise RecordError(f"{len(values)} fields instead of {at_least}: the record is cut off")
    return values


def _locarno(line: str) -> Record:
    """id, lat, lon, time, logger T, logger V, rate, ..., "32 N(D)", "32 v(D)", "1024 counts"."""
    values = _fields(line, 23)
    return Record(
        time=utc(values[3], "%d-%m-%Y %H:%M:%S"),
        seconds=float("nan"),
        reported_mm_h=rain_rate(values[6]),
        counts=parsivel_counts(values[22], ","),
    )


def _station(line: str) -> Record:
    """time; rate; ...; interval (6); ...; 32 N(D); 32 v(D); 1024 counts, joined by ; or by /."""
    values = line.strip().split(";")
    if not re.match(r"\d{14}", values[0]):
        raise RecordError("the line doesn't begin with a time: the record is cut off")
    if len(values) < 83:
        raise RecordError(f"{len(values)} fields instead of at least 83: the record is cut off")
    slashed = "/" in values[82]
    counts = values[82].removesuffix("R").removesuffix("/") if slashed else ";".join(values[82:])
    return Record(
        time=utc(values[0], "%Y%m%d%H%M%S", "%Y%m%d%H%M%S.%f"),
        seconds=interval_s(values[6]),
        reported_mm_h=rain_rate(values[1]),
        counts=parsivel_counts(counts, "/" if slashed else ";"),
    )


_DIALECTS = (
    Dialect(re.compile(r'^\d+,[\d.]+,[\d.]+,"\d\d-\d\d-\d{4} \d\d:\d\d:\d\d","'), _locarno),
    Dialect(re.compile(r"^\d{14}(\.\d+)?;[^;]*;[^;]*;[^;]*;[^;]*;[^;]*;\d+;"), _station),
)
