"""Text tables of disdrometer records: NASA's minute tables, rain rates without drops, and YAML-described tables."""

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import groupby
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float64
from msgspec import Meta

from ..rain.calibration import atlas_velocity
from ..safe_io.errors import convert_checked
from ..safe_io.text_files import printable_line, read_whole, yaml_values
from ..settings import Settings
from .instruments import (
    JOSS_WALDVOGEL,
    JOSS_WALDVOGEL_AREA_M2,
    PARSIVEL,
    RD80_EDGES_MM,
    THIES,
    Instrument,
    Order,
)
from .spectra import (
    LONGEST_RECORD_S,
    DisdrometerFileError,
    DisdrometerReading,
    RecordError,
    SpectrumRecord,
    SpectrumRecords,
    numbered_lines,
    parse_drop_counts,
    parse_interval_s,
    parse_rain_rate,
    parse_records,
    parse_utc,
)

MINUTE_S = 60.0
TWO_DVD_EDGES_MM = 0.2 * np.arange(51)
TWO_DVD_AREA_M2 = 0.01
"""Nominal area, 10 x 10 cm (Kruger and Krajewski 2002)."""

_STAMP = 4
_APU, _COUNTS = 32, 50
_ROW = re.compile(r"^\s*(19|20)\d\d\s+\d{1,3}\s+\d{1,2}\s+\d{1,2}\s")


def is_minute_table(lines: list[str]) -> bool:
    """Return whether the first row is a minute with the 32 diameters of an APU or the 50 of a 2DVD."""
    first = next((line for line in lines if line.strip()), "")
    return _ROW.match(first) is not None and len(first.split()) - _STAMP in (_APU, _COUNTS)


def read_minute_table(path: Path, lines: list[str]) -> DisdrometerReading:
    """Read NASA's ground-validation tables; raises `DisdrometerFileError` if no row is usable.

    A row holds year, day of the year, hour, minute and a number a diameter: counted drops (`dropcounts`, integers) or
    number densities in 1/(m^3 mm) (`rainDSD`, with decimals), one kind a file. Densities are converted to the counts
    that the instrument would have made.
    """
    first = next(line for line in lines if line.strip())
    classes = len(first.split()) - _STAMP
    records = parse_records(path, numbered_lines(lines), lambda row: _record(row, classes))
    if classes == _COUNTS:
        name, edges, area = "2DVD", TWO_DVD_EDGES_MM, np.full(_COUNTS, TWO_DVD_AREA_M2)
    else:
        name, edges, area = "APU (OTT Parsivel)", PARSIVEL.diameter_edges_mm, PARSIVEL.area_m2
    if "." in first:
        records = replace(records, counts=drops_of_densities(records.counts, edges, area, records.seconds))
    return records.by_diameter(name, edges, area)


def _record(row: str, classes: int) -> SpectrumRecord:
    values = row.split()
    try:
        year, day, hour, minute = (int(value) for value in values[:_STAMP])
        begin = datetime.strptime(f"{year} {day} {hour} {minute}", "%Y %j %H %M")
    except ValueError:
        raise RecordError(f"{' '.join(values[:_STAMP])[:40]!r} is no year, day of the year, hour and minute") from None
    return SpectrumRecord(
        time=np.datetime64(begin + timedelta(seconds=MINUTE_S), "ms"),
        seconds=MINUTE_S,
        reported_mm_h=float("nan"),
        counts=parse_drop_counts(values[_STAMP:], classes),
    )


def drops_of_densities(
    density_m3_mm: Float64[np.ndarray, "records diameters"],
    edges_mm: Float64[np.ndarray, " diameters_and_one"],
    area_m2: float | Float64[np.ndarray, " diameters"],
    seconds: Float64[np.ndarray, " records"],
) -> Float64[np.ndarray, "records diameters"]:
    """Expected drop counts, fractional: N(D) dD swept at the fall speed of Atlas et al. (1973)."""
    swept_m3_s = atlas_velocity(0.5 * (edges_mm[:-1] + edges_mm[1:])) * area_m2
    return density_m3_mm * np.diff(edges_mm) * swept_m3_s * seconds[:, None]


# Rain rates without drops

_INTENSITY = re.compile(r"^\s*current intensity\s*:\s*(\S*)\s*$", re.IGNORECASE)


def is_rainsense_intensity(lines: list[str]) -> bool:
    """Return whether the first line is a RainSense intensity."""
    return bool(lines) and _INTENSITY.match(lines[0]) is not None


def read_rainsense_intensity(path: Path, lines: list[str]) -> DisdrometerReading:
    """Read the one rate in mm/h of a RainSense case, which has neither a time nor a length.

    Raises `DisdrometerFileError` if it is not a rate.
    """
    match = _INTENSITY.match(lines[0])
    try:
        rate = parse_rain_rate(match[1] if match else "")
    except RecordError as error:
        raise DisdrometerFileError(path, f"line 1: {error}") from None
    if np.isnan(rate):
        raise DisdrometerFileError(path, "line 1: it says no intensity")
    record = SpectrumRecords(
        times=np.array(["NaT"], "datetime64[ms]"),
        seconds=np.full(1, np.nan),
        reported_mm_h=np.array([rate]),
        counts=np.zeros((1, 0)),
    )
    return rates_reading("RainSense rain gauge", record)


def rates_reading(instrument: str, records: SpectrumRecords) -> DisdrometerReading:
    """Reading without diameter classes; only times and reported rates are meaningful."""
    return records.by_diameter(instrument, np.zeros(1), np.zeros(0))


# Text tables

_RATE_UNITS = {"mm/h": 1.0, "mm/min": 60.0, "mm/s": 3600.0, "m/s": 3.6e6}
_LARGEST_MM, _FASTEST_M_S, _LARGEST_AREA_M2 = 50.0, 50.0, 10.0
_HEADER_WITHIN, _LONGEST_NAME = 20, 60
_ISO = ("%Y-%m-%d %H:%M:%S", "%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S", "%Y-%m-%dT%H:%M:%SZ", "%Y-%m-%d %H:%M")
_TIMES = (*_ISO, "%Y/%m/%d %H:%M:%S", "%Y/%m/%d %H:%M", "%d.%m.%Y %H:%M:%S", "%Y%m%d%H%M%S", "%Y%m%d %H%M%S")
_CAMPBELL_WORDS = ('"TOA5"', '"TIMESTAMP"', '"TS"', '"",', "TOA5,", "TIMESTAMP,", "TS,")
"""First words of the lines of a Campbell logger's header: type, columns, units, sampling."""

_WITHOUT_SPEED = {
    JOSS_WALDVOGEL: (RD80_EDGES_MM, JOSS_WALDVOGEL_AREA_M2),
    "2DVD": (TWO_DVD_EDGES_MM, TWO_DVD_AREA_M2),
}

_WITH_SPEED = {each.name: each for each in (PARSIVEL, THIES)}
Column = Annotated[str, Meta(min_length=1)] | Annotated[int, Meta(ge=1, le=100_000)]
"""A column by its name in the header, or by its number, from 1 on."""

_Edges = Annotated[tuple[Annotated[float, Meta(ge=0)], ...], Meta(min_length=4, max_length=1025)]


class ColumnRange(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Adjacent columns, both ends included."""

    first: Column
    last: Column


class TableColumns(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Columns of a table of disdrometer records, as described in a YAML file."""

    instrument: Annotated[str, Meta(min_length=1, max_length=60)]
    """OTT Parsivel, Thies LNM, Joss-Waldvogel or 2DVD, whose classes and area are known; otherwise any name."""
    drops: Column | ColumnRange
    """One number a class: in adjacent columns, or in one column that holds all of them."""
    time: Column | Annotated[tuple[Column, ...], Meta(min_length=1, max_length=6)]
    """UTC, in one column or several (date and time of day), which are joined by a space."""
    time_format: Annotated[str, Meta(min_length=2, max_length=60)] | None = None
    """Format for Python's `strptime`, as `%d/%m/%Y %H:%M`; by default ISO formats and some others are tried."""
    time_is: Literal["end", "start"] = "end"
    """End or start of the record."""
    utc_offset_h: Annotated[float, Meta(ge=-14, le=14)] = 0.0
    """Hours by which the table's clock is ahead of UTC."""
    seconds: Annotated[float, Meta(ge=1, le=LONGEST_RECORD_S)] | None = None
    """Length of each record; by default from `seconds_column`, otherwise the step between records."""
    seconds_column: Column | None = None
    """Column of each record's length in s."""
    rate: Column | None = None
    """The instrument's own rain rate, for a check of the drops."""
    rate_unit: Literal["mm/h", "mm/min", "mm/s", "m/s"] = "mm/h"
    quantity: Literal["drops", "drops_m3_mm"] = "drops"
    """Counted drops, or number density in 1/(m^3 mm)."""
    order: Literal["diameters first", "velocities first"] | None = None
    """Slower index if both diameter and speed are measured; by default the maker's."""
    separator: Annotated[str, Meta(min_length=1, max_length=1)] | None = None
    """Column separator; a space matches any white space; by default the header's most frequent of , ; and tab."""
    drops_separator: Annotated[str, Meta(min_length=1, max_length=1)] | None = None
    """Separator within the single column of all drops; by default the most frequent of , ; / and space in it."""
    decimal: Literal[".", ","] = "."
    header_line: Annotated[int, Meta(ge=0, le=1000)] = 1
    """Line with the column names, from 1 on; 0 for none, with columns given by number."""
    comments: Annotated[tuple[Annotated[str, Meta(min_length=1, max_length=60)], ...], Meta(max_length=20)] = ()
    """Prefixes of lines that are not records."""
    diameter_edges_mm: _Edges | None = None
    """Bounds of the diameter classes, one more than there are classes: for other instruments or classes."""
    velocity_edges_m_s: _Edges | None = None
    """Bounds of the fall-speed classes; without them, another instrument measures no speed."""
    area_m2: Annotated[float, Meta(gt=0, le=_LARGEST_AREA_M2)] | None = None
    """Measuring area."""

    def __post_init__(self) -> None:
        super().__post_init__()
        known = (*_WITH_SPEED, *_WITHOUT_SPEED)
        if self.diameter_edges_mm is None and self.instrument not in known:
            raise ValueError(
                f"`instrument` {printable_line(self.instrument)} is none of {', '.join(known)}: "
                "give `diameter_edges_mm`, "
                "`area_m2`, and `velocity_edges_m_s` if it measures fall speed"
            )
        if self.diameter_edges_mm is not None and self.area_m2 is None:
            raise ValueError("`diameter_edges_mm` are given: give `area_m2`, too")
        if self.diameter_edges_mm is None and (self.area_m2 is not None or self.velocity_edges_m_s is not None):
            raise ValueError("`area_m2` and `velocity_edges_m_s` go with `diameter_edges_mm`: give them, too")
        for name, edges, largest in (
            ("diameter_edges_mm", self.diameter_edges_mm, _LARGEST_MM),
            ("velocity_edges_m_s", self.velocity_edges_m_s, _FASTEST_M_S),
        ):
            if edges is not None and not (np.diff(edges) > 0).all():
                raise ValueError(f"`{name}` must rise")
            if edges is not None and edges[-1] > largest:
                raise ValueError(f"`{name}` must lie within 0 to {largest:g}")
        if self.quantity == "drops_m3_mm" and self.instrument_classes() is not None:
            raise ValueError(
                "`quantity` drops_m3_mm: a number density has no fall speeds; give `diameter_edges_mm` alone"
            )
        if self.time_format is not None:
            _check_time_format(self.time_format)
        if self.separator == self.decimal == "," or (self.drops_separator or "") == self.decimal:
            raise ValueError(
                "`separator`, `drops_separator`: a comma can't separate numbers and be their `decimal` sign"
            )

    def instrument_classes(self) -> Instrument | None:
        """Classes and area of an instrument that measures fall speed; None for others."""
        if self.diameter_edges_mm is None:
            return _WITH_SPEED.get(self.instrument)
        if self.velocity_edges_m_s is None:
            return None
        edges = np.array(self.diameter_edges_mm)
        return Instrument(
            name=self.instrument,
            diameter_edges_mm=edges,
            velocity_edges_m_s=np.array(self.velocity_edges_m_s),
            area_m2=np.full(len(edges) - 1, self.area_m2),
        )

    def diameter_classes(self) -> tuple[Float64[np.ndarray, " edges"], float]:
        """Bounds of the diameters in mm and the area in m^2, for an instrument that measures no speed."""
        if self.diameter_edges_mm is None or self.area_m2 is None:
            return _WITHOUT_SPEED[self.instrument]
        return np.array(self.diameter_edges_mm), self.area_m2


def load_columns(path: Path | str) -> TableColumns:
    """Read a table description. Raises `ValueError` with the file, field and valid values, or `OSError`."""
    try:
        return convert_checked(yaml_values(read_whole(Path(path))), TableColumns)
    except ValueError as error:
        raise ValueError(f"{path}: {error}".replace(f"{path}: {path}: ", f"{path}: ")) from None


def is_named_table(lines: list[str]) -> bool:
    """Return whether `table_columns` finds a description in the header."""
    return table_columns(lines) is not None


def table_columns(lines: Sequence[str]) -> TableColumns | None:
    """Description of a table whose header names a time and all drops; None without such a header.

    Recognizes Campbell's TOA5 logs of a Parsivel, pyAtmosLogger's CSV, DISDRODB's names (NOAA's SCAMP) and RD-80
    tables.
    """
    for i, line in enumerate(lines[:_HEADER_WITHIN]):
        for separator in sorted(";\t,", key=line.count, reverse=True):
            if line.count(separator) >= 2:
                found = _described(_names(line, separator), separator, i + 1)
                if found is not None:
                    return found
    return None


def read_table(path: Path, lines: list[str], columns: TableColumns | None = None) -> DisdrometerReading:
    """Read a table that is described, by default by its header.

    Raises `DisdrometerFileError` if columns are missing or no row is usable.
    """
    columns = columns or table_columns(lines)
    assert columns is not None
    layout = _layout(path, lines, columns)
    records = parse_records(path, _table_rows(lines, columns), lambda line: _table_record(line, columns, layout))
    classes = columns.instrument_classes()
    if classes is not None:
        return classes.reading(path, records, _order(columns))
    edges, area = columns.diameter_classes()
    if columns.quantity == "drops_m3_mm":
        records = replace(records, counts=drops_of_densities(records.counts, edges, area, records.seconds))
    return records.by_diameter(columns.instrument, edges, np.full(len(edges) - 1, area))


# Headers


_TIME_NAMES = ("timestamp", "datetime_utc", "datetime [utc]", "datetime", "time_utc", "time")
_DAY_NAMES = ("yyyy-mm-dd", "date")
_RATE_NAMES = ("rainfall_rate_32bit", "ri [mm/h]", "ri", "ri [mm/hr]")
_SECONDS_NAMES = ("sample_interval", "sample interval [s]", "interval [s]", "sampleinterval")
_ALL_DROPS_NAMES = ("raw_drop_number", "rowdata", "rawdata", "raw_data", "data_raw", "spectrum", "rawspectrum")
_MEMBER = re.compile(r"^(.*?)[\[(_]?\d+(?:[,_]\d+)?[\])]?$")
"""Pattern for the stem of spectrum(17), RowData_17, M_0_16, n17."""


def _described(names: Sequence[str], separator: str, header_line: int) -> TableColumns | None:
    time = _named(names, _TIME_NAMES)
    day = _named(names, _DAY_NAMES)
    hour = _named(names, ("hh:mm:ss", "time"))
    when = (day, hour) if day is not None and hour is not None else (time,) if time is not None else None
    found = _drops_of(names)
    if when is None or found is None:
        return None
    instrument, drops = found
    seconds = _named(names, _SECONDS_NAMES)
    rate = _named(names, _RATE_NAMES)
    if rate is None:
        rate = next((name for name in names if _is_rate(name)), None)
    return TableColumns(
        instrument=instrument,
        drops=drops,
        time=tuple(names.index(name) + 1 for name in when),
        seconds_column=None if seconds is None else names.index(seconds) + 1,
        rate=None if rate is None else names.index(rate) + 1,
        separator=separator,
        # An RD-80's program follows the country's settings: with tab separators, commas are decimal.
        decimal="," if separator == "\t" and instrument == JOSS_WALDVOGEL else ".",
        header_line=header_line,
        comments=_CAMPBELL_WORDS if names[0] == "timestamp" else (),
    )


def _named(names: Sequence[str], known: Sequence[str]) -> str | None:
    return next((name for name in known if name in names), None)


def _is_rate(name: str) -> bool:
    return ("intensity" in name or "rain rate" in name or "rain_rate" in name) and not re.search(
        "snow|16 bit|min|max", name
    )


def _drops_of(names: Sequence[str]) -> tuple[str, Column | ColumnRange] | None:
    """The instrument whose number of classes matches a run of columns of one stem, and those columns."""
    sizes = {math.prod(each.shape): each.name for each in (PARSIVEL, THIES)}
    stems = [_stem(name) for name in names]
    for stem, run in groupby(range(len(names)), key=lambda i: i if stems[i] is None else stems[i]):
        first, *rest = run
        count, drops = 1 + len(rest), ColumnRange(first=first + 1, last=first + 1 + len(rest))
        if count in sizes:
            return sizes[count], drops
        if count == len(RD80_EDGES_MM) - 1 and stem == "n":
            return JOSS_WALDVOGEL, drops
    name = _named(names, _ALL_DROPS_NAMES)
    return None if name is None else (PARSIVEL.name, names.index(name) + 1)


def _stem(name: str) -> str | None:
    match = _MEMBER.match(name) if len(name) <= _LONGEST_NAME else None
    return match[1].rstrip("_") if match else None


# Rows


@dataclass(frozen=True, slots=True)
class _Layout:
    """Column indices in a row, from 0 on."""

    separator: str
    time: tuple[int, ...]
    seconds: int | None
    rate: int | None
    drops: slice | int
    columns: int
    """Minimum number of columns in a row."""
    classes: int
    """Number of drop counts."""


def _layout(path: Path, lines: Sequence[str], columns: TableColumns) -> _Layout:
    if columns.header_line > len(lines):
        raise DisdrometerFileError(path, f"header_line is {columns.header_line}, and it has {len(lines)} lines")
    # Without a header, the first record determines the separator.
    header = (
        lines[columns.header_line - 1]
        if columns.header_line
        else next((line for _, line in _table_rows(lines, columns)), "")
    )
    separator = columns.separator or max(",;\t", key=header.count)
    try:
        names = [name.strip(' "') for name in _split(header, separator)] if columns.header_line else []
    except RecordError as error:
        raise DisdrometerFileError(path, f"line {columns.header_line}, of the names: {error}") from None
    folded = [name.lower() for name in names]

    def place(column: Column, field: str) -> int:
        if isinstance(column, int):
            return column - 1
        if column in names:
            return names.index(column)
        if column.lower() in folded:
            return folded.index(column.lower())
        some = ", ".join(names[:8]) or "none: header_line is 0, and columns go by number"
        raise DisdrometerFileError(
            path, f"`{field}`: no column is called {column} (there are {some}{', ...' * (len(names) > 8)})"
        )

    expected = _classes(columns)
    if isinstance(columns.drops, ColumnRange):
        first, last = place(columns.drops.first, "drops.first"), place(columns.drops.last, "drops.last")
        if last < first:
            raise DisdrometerFileError(
                path, f"`drops`: its last column, {last + 1}, stands before its first, {first + 1}"
            )
        drops: slice | int = slice(first, last + 1)
        if last + 1 - first != expected:
            raise DisdrometerFileError(
                path, f"`drops`: {last + 1 - first} columns, and {columns.instrument} has {expected} classes"
            )
    else:
        drops = last = place(columns.drops, "drops")
    times = (columns.time,) if isinstance(columns.time, str | int) else columns.time
    time = tuple(place(each, "time") for each in times)
    seconds = None if columns.seconds_column is None else place(columns.seconds_column, "seconds_column")
    rate = None if columns.rate is None else place(columns.rate, "rate")
    needed = max(*time, seconds or 0, rate or 0, last) + 1
    return _Layout(separator, time, seconds, rate, drops, needed, expected)


def _table_rows(lines: Sequence[str], columns: TableColumns) -> Iterator[tuple[str, str]]:
    header = lines[columns.header_line - 1] if columns.header_line else None
    for where, line in numbered_lines(lines[columns.header_line :], columns.header_line + 1):
        if line != header and not line.startswith(columns.comments):  # a restarted logger repeats its header
            yield where, line


def _table_record(line: str, columns: TableColumns, layout: _Layout) -> SpectrumRecord:
    values = _split(line, layout.separator)
    if len(values) < layout.columns:
        raise RecordError(f"{len(values)} columns instead of {layout.columns}: the record is cut off")
    seconds = float("nan") if columns.seconds is None else columns.seconds
    if layout.seconds is not None:
        seconds = parse_interval_s(_point(values[layout.seconds], columns))
    rate = float("nan") if layout.rate is None else parse_rain_rate(_point(values[layout.rate], columns))
    return SpectrumRecord(
        time=_time(" ".join(values[i].strip(' "') for i in layout.time), columns, seconds),
        seconds=seconds,
        reported_mm_h=rate * _RATE_UNITS[columns.rate_unit],
        counts=parse_drop_counts(_drops(values, columns, layout), layout.classes),
    )


def _time(text: str, columns: TableColumns, seconds: float) -> np.datetime64:
    time = parse_utc(text, columns.time_format) if columns.time_format else parse_utc(text, *_TIMES)
    time -= np.timedelta64(round(3_600_000 * columns.utc_offset_h), "ms")
    if columns.time_is == "start":
        if np.isnan(seconds):
            raise RecordError("its time is that of its start, and its length is not known: give `seconds`")
        time += np.timedelta64(round(1000 * seconds), "ms")
    return time


def _drops(values: Sequence[str], columns: TableColumns, layout: _Layout) -> list[str]:
    if isinstance(layout.drops, slice):
        texts = list(values[layout.drops])
    else:
        whole = values[layout.drops].strip(' "')
        separator = columns.drops_separator or max(",;/ ", key=whole.count)
        texts = whole.split() if separator == " " else whole.removesuffix(separator).split(separator)
    return [_point(text, columns).strip() for text in texts]


def _point(text: str, columns: TableColumns) -> str:
    return text.replace(",", ".") if columns.decimal == "," else text


def _split(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    except (csv.Error, StopIteration) as error:
        raise RecordError(f"the line can't be split into columns ({error})") from None


def _names(line: str, separator: str) -> list[str]:
    try:
        return [name.strip(' "').lower() for name in _split(line, separator)]
    except RecordError:
        return []


def _classes(columns: TableColumns) -> int:
    classes = columns.instrument_classes()
    return len(columns.diameter_classes()[0]) - 1 if classes is None else classes.shape[0] * classes.shape[1]


def _order(columns: TableColumns) -> Order:
    """The given or the maker's order: Parsivel all diameters of one speed first, Thies all speeds of one diameter."""
    return columns.order or ("velocities first" if columns.instrument == PARSIVEL.name else "diameters first")


def _check_time_format(time_format: str) -> None:
    """Raise ValueError for a time format without year, month, day and hour."""
    moment = datetime(2019, 11, 28, 13, 47, 59)
    try:
        same = datetime.strptime(moment.strftime(time_format), time_format)
    except (ValueError, re.error) as error:
        raise ValueError(f"`time_format` {printable_line(time_format)}: {printable_line(error)}") from None
    if same.replace(minute=0, second=0) != moment.replace(minute=0, second=0):
        raise ValueError(
            f"`time_format` {printable_line(time_format)} must name year, month, day and hour, "
            "as %Y-%m-%d %H:%M:%S does"
        )
