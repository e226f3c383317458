"""OTT Parsivel telegrams, one field a line, each with its number (Parsivel2 manual, section 11.2)."""

import re
from collections.abc import Iterator
from pathlib import Path

from gsrain_engine.rain.disdrometer.instruments import PARSIVEL
from gsrain_engine.rain.disdrometer.parsivel_logs import parsivel_counts
from gsrain_engine.rain.disdrometer.reading import Reading
from gsrain_engine.rain.disdrometer.records import Record, RecordError, gather, interval_s, rain_rate, utc

_FIELD = re.compile(r"^(\d\d):(.*)")
_FIRST = "01"
_NEEDED = {"01": "rain rate", "09": "sample interval", "20": "time", "21": "date", "93": "raw spectrum"}


def is_parsivel_telegrams(lines: list[str]) -> bool:
    """Whether a telegram with a rain rate begins within the first lines."""
    return any(re.match(r"^01:\d+\.\d+\s*$", line) for line in lines[:200])


def read_parsivel_telegrams(path: Path, lines: list[str]) -> Reading:
    """Read telegrams that begin with field 01; raises `DisdrometerFileError` where none is whole."""
    records, skipped = gather(path, _telegrams(lines), _record)
    return PARSIVEL.reading_of(path, records, "velocities first", skipped)


def _telegrams(lines: list[str]) -> Iterator[tuple[str, str]]:
    start = 0
    for i, line in enumerate([*lines, f"{_FIRST}:"]):
        if line.startswith(f"{_FIRST}:"):
            if any(_FIELD.match(each) for each in lines[start:i]):
                yield f"telegram at line {start + 1}", "\n".join(lines[start:i])
            start = i


def _record(telegram: str) -> Record:
    fields = {match[1]: match[2] for line in telegram.split("\n") if (match := _FIELD.match(line))}
    for field, name in _NEEDED.items():
        if field not in fields:
            raise RecordError(f"field {field} ({name}) is missing: the telegram is cut off")
    return Record(
        time=utc(f"{fields['21'].strip()} {fields['20'].strip()}", "%d.%m.%Y %H:%M:%S", "%d.%m.%y %H:%M:%S"),
        seconds=interval_s(fields["09"]),
        reported_mm_h=rain_rate(fields["01"]),
        counts=parsivel_counts(fields["93"], ";"),
    )
