"""Drop spectra by diameter and fall speed from real or virtual disdrometers, and parsing of their records."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Shaped

from ..safe_io.text_files import printable_line


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DropSpectra:
    """One spectrum a record, in order of time."""

    instrument: str
    """Display name such as OTT Parsivel."""
    times: Shaped[np.ndarray, " records"]
    """End of each record in UTC, datetime64[ms]; NaT if the file has no times."""
    seconds: Float64[np.ndarray, " records"]
    diameter_edges_mm: Float64[np.ndarray, " diameters_and_one"]
    """Increasing bounds of the diameter classes, as volume-equivalent sphere diameters."""
    velocity_edges_m_s: Float64[np.ndarray, " velocities_and_one"] | None
    """Increasing bounds of the fall-speed classes; None if the instrument measures no speed."""
    counts: Float64[np.ndarray, "records diameters velocities"]
    """Number of drops; one velocity class if the instrument measures no speed."""
    area_m2: Float64[np.ndarray, " diameters"]
    """Horizontal area in which drops of each class are counted."""
    reported_mm_h: Float64[np.ndarray, " records"]
    """The instrument's own rain rate; NaN if it reports none."""

    def __post_init__(self) -> None:
        if self.velocity_edges_m_s is None and self.counts.shape[2] != 1:
            raise ValueError(f"counts of {self.counts.shape[2]} velocity classes without their bounds")

    def __len__(self) -> int:
        return len(self.counts)

    def __getitem__(self, records: slice | Bool[np.ndarray, " picked"]) -> "DropSpectra":
        return replace(
            self,
            times=self.times[records],
            seconds=self.seconds[records],
            counts=self.counts[records],
            reported_mm_h=self.reported_mm_h[records],
        )

    @property
    def diameters_mm(self) -> Float64[np.ndarray, " diameters"]:
        """Center of each diameter class."""
        return 0.5 * (self.diameter_edges_mm[:-1] + self.diameter_edges_mm[1:])

    @property
    def velocities_m_s(self) -> Float64[np.ndarray, " velocities"] | None:
        """Center of each fall-speed class; None if no speed is measured."""
        edges = self.velocity_edges_m_s
        return None if edges is None else 0.5 * (edges[:-1] + edges[1:])

    @property
    def rate_mm_h(self) -> Float64[np.ndarray, " records"]:
        """Rain rate of each record from its drops: their volume, pi D^3 / 6, over area and time."""
        volume_mm3 = np.pi / 6 * self.diameters_mm**3
        by_diameter = self.counts.sum(axis=2) @ (volume_mm3 / (1e6 * self.area_m2))  # mm
        return 3600 * by_diameter / self.seconds

    @staticmethod
    def concatenate(parts: "list[DropSpectra]") -> "DropSpectra":
        """Join records of one instrument. Raises `ValueError` if classes or areas differ."""
        first = parts[0]
        for other in parts[1:]:
            for name in ("diameter_edges_mm", "velocity_edges_m_s", "area_m2"):
                mine, its = getattr(first, name), getattr(other, name)
                if (mine is None) != (its is None) or (mine is not None and not np.array_equal(mine, its)):
                    raise ValueError(f"{first.instrument} and {other.instrument} differ in {name}")
        joined = {
            name: np.concatenate([getattr(each, name) for each in parts])
            for name in ("times", "seconds", "counts", "reported_mm_h")
        }
        return replace(first, **joined)


# Readings of disdrometer files


class DisdrometerFileError(ValueError):
    """No record can be read from a file; the message names the file, the record and the reason."""

    def __init__(self, path: Path, reason: str):
        super().__init__(f"{path}: {printable_line(reason)}")


KNOWN_KINDS = "OTT Parsivel, Thies LNM, Joss-Waldvogel RD-80, 2DVD, APU, RainSense (docs/guide/calibration.md)"
"""Recognized file kinds, for messages."""


class UnknownKindError(DisdrometerFileError):
    """A file of an unknown kind; `problem` is the message without the file's name.

    `kind` describes the actual kind if it is evident ("an archive: unpack it").
    """

    def __init__(self, path: Path, what: str, kind: str | None = None):
        known = f"{printable_line(what)}; known are {KNOWN_KINDS}; --columns FILE.yaml describes other tables of text"
        self.problem = known if kind is None else f"not a disdrometer file; it is {kind}"
        self.kind = kind
        ValueError.__init__(self, f"{path}: {self.problem}")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SingleDrops:
    """Individually measured drops, in order of time."""

    diameters_mm: Float64[np.ndarray, " drops"]
    """Volume-equivalent sphere diameter."""
    speeds_m_s: Float64[np.ndarray, " drops"]
    """Fall speed, positive downward."""
    axis_ratios: Float64[np.ndarray, " drops"]
    """Height over width; NaN if not measured."""
    times: Shaped[np.ndarray, " drops"]
    """UTC, datetime64[ms]."""

    def __len__(self) -> int:
        return len(self.diameters_mm)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DisdrometerReading:
    """Contents of one disdrometer file."""

    spectra: DropSpectra
    drops: SingleDrops | None = None
    """Single drops of a 2DVD, otherwise None."""
    skipped: tuple[str, ...] = ()
    """One sentence with the reason for each skipped record."""
    length_is_assumed: bool = False
    """True if neither the file nor its times tell the length of a record, which is the makers' default then."""


def with_common_lengths(readings: Sequence[DisdrometerReading]) -> list[DisdrometerReading]:
    """Take the length of records that no single file tells from the times of all files: one telegram a file."""
    times = [each.spectra.times for each in readings if each.length_is_assumed]
    known = [each[~np.isnat(each)] for each in times]
    seconds = median_step_s(np.unique(np.concatenate([np.empty(0, "M8[ms]"), *known])))

    def common(reading: DisdrometerReading) -> DisdrometerReading:
        spectra = replace(reading.spectra, seconds=np.full(len(reading.spectra), seconds))
        return replace(reading, spectra=spectra)

    return [common(each) if each.length_is_assumed else each for each in readings]


def joined_series(parts: Sequence[DropSpectra]) -> list[DropSpectra]:
    """Join the spectra of files that follow one another in time, so that a minute may lie in several files.

    Files that overlap in time are of different places, and stay apart, as do those without times.
    """
    series: list[list[DropSpectra]] = []
    ends: list[np.datetime64] = []
    with_times = [each for each in parts if len(each) and not np.isnat(each.times).any()]
    for each in sorted(with_times, key=lambda spectra: spectra.times[0]):
        half_record = np.timedelta64(round(500 * float(each.seconds[0])), "ms")
        place = next((k for k, end in enumerate(ends) if end <= each.times[0] - half_record), len(ends))
        if place == len(ends):
            series.append([])
            ends.append(each.times[-1])
        series[place].append(each)
        ends[place] = each.times[-1]
    others = [each for each in parts if len(each) and np.isnat(each.times).any()]
    return [*(DropSpectra.concatenate(each) for each in series), *others]


# Parsing of records

MAX_COUNTS = 2**27
"""Maximum number of counts in all spectra of one file: 1 GiB, or three months of one-minute Parsivel records."""

FACTORY_SECONDS = 60.0
"""The makers' default length of a record, for files that neither state nor imply it."""

MAX_DROPS = 1e9
"""Maximum per class and record; larger numbers mean damage, not rain."""

LONGEST_RECORD_S = 3600.0
"""Maximum length of a record, also as implied by the step between records."""

_NO_RATES = (-9.999, -99.9, -99.99, -999.0, -9999.0)  # Loggers' codes for a missing rate


class RecordError(ValueError):
    """A record is unusable; the message gives the reason."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SpectrumRecord:
    """One spectrum as stored in its file."""

    time: np.datetime64
    """End of the record, UTC, in milliseconds."""
    seconds: float
    """NaN if not in the file."""
    reported_mm_h: float
    """NaN if the instrument reports none."""
    counts: Float64[np.ndarray, " classes"]
    """Counts in file order."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SpectrumRecords:
    """The usable records of a file, in order of time."""

    times: Shaped[np.ndarray, " records"]
    """End of each record, UTC, datetime64[ms]."""
    seconds: Float64[np.ndarray, " records"]
    reported_mm_h: Float64[np.ndarray, " records"]
    counts: Float64[np.ndarray, "records classes"]
    """Counts in file order."""
    skipped: tuple[str, ...] = ()
    """One sentence with the reason for each unusable record."""
    length_is_assumed: bool = False

    def reading(
        self,
        instrument: str,
        diameter_edges_mm: Float64[np.ndarray, " diameters_and_one"],
        velocity_edges_m_s: Float64[np.ndarray, " velocities_and_one"] | None,
        counts: Float64[np.ndarray, "records diameters velocities"],
        area_m2: Float64[np.ndarray, " diameters"],
    ) -> DisdrometerReading:
        """Reading with the records' counts arranged by class."""
        spectra = DropSpectra(
            instrument=instrument,
            times=self.times,
            seconds=self.seconds,
            diameter_edges_mm=diameter_edges_mm,
            velocity_edges_m_s=velocity_edges_m_s,
            counts=counts,
            area_m2=area_m2,
            reported_mm_h=self.reported_mm_h,
        )
        return DisdrometerReading(spectra=spectra, skipped=self.skipped, length_is_assumed=self.length_is_assumed)

    def by_diameter(
        self,
        instrument: str,
        edges_mm: Float64[np.ndarray, " classes_and_one"],
        area_m2: Float64[np.ndarray, " classes"],
    ) -> DisdrometerReading:
        """Reading of an instrument that measures no fall speed."""
        return self.reading(instrument, edges_mm, None, self.counts[:, :, None], area_m2)


def parse_records(
    path: Path, numbered: Iterable[tuple[str, str]], parse: Callable[[str], SpectrumRecord]
) -> SpectrumRecords:
    """Parse each record; unusable ones become sentences.

    `numbered` gives each record's position ("line 7") and text. A record without a length gets the median step. Raises
    `DisdrometerFileError` if none is left, or if they exceed `MAX_COUNTS`.
    """
    records: list[SpectrumRecord] = []
    skipped: list[str] = []
    last: tuple[np.datetime64, str] | None = None
    size = 0
    for where, text in numbered:
        try:
            record = parse(text)
            if (record.time, text) == last:
                raise RecordError(f"the record of {record.time} stands there twice")
        except RecordError as error:
            skipped.append(f"{where}: {error}")
            continue
        last = (record.time, text)
        size += len(record.counts)
        if size > MAX_COUNTS:
            raise DisdrometerFileError(path, f"{where}: more than {len(records)} spectra: split the file by days")
        records.append(record)
    if not records:
        raise DisdrometerFileError(path, no_record_left(skipped))
    records.sort(key=lambda record: record.time)
    times = np.array([record.time for record in records])
    seconds = np.array([record.seconds for record in records])
    return SpectrumRecords(
        times=times,
        seconds=np.where(np.isnan(seconds), median_step_s(times), seconds),
        reported_mm_h=np.array([record.reported_mm_h for record in records]),
        counts=np.stack([record.counts for record in records]),
        skipped=tuple(skipped),
        length_is_assumed=bool(np.isnan(seconds).all()) and not len(_usable_steps_s(times)),
    )


def numbered_lines(lines: Iterable[str], first: int = 1) -> Iterator[tuple[str, str]]:
    """Yield each nonempty line with its position, for `parse_records`; `first` is the number of the first line."""
    return ((f"line {i}", line) for i, line in enumerate(lines, first) if line.strip())


def no_record_left(skipped: Sequence[str]) -> str:
    """Message for a file without usable records: the first reason and the number of further ones."""
    if not skipped:
        return "it holds no record"
    more = f" (and {len(skipped) - 1} more such records)" if len(skipped) > 1 else ""
    return f"no record can be used: {skipped[0]}{more}"


def median_step_s(times: Shaped[np.ndarray, " records"]) -> float:
    """Median time between sorted records in s; `FACTORY_SECONDS` if no step is usable."""
    near = _usable_steps_s(times)
    return float(np.median(near)) if near.size else FACTORY_SECONDS


def _usable_steps_s(times: Shaped[np.ndarray, " records"]) -> Float64[np.ndarray, " steps"]:
    steps = np.diff(times) / np.timedelta64(1, "s")
    return steps[(steps > 0) & (steps <= LONGEST_RECORD_S)]


def parse_drop_counts(values: Sequence[str], expected: int) -> Float64[np.ndarray, " classes"]:
    """Drop counts as numbers; raises `RecordError` if one is missing, negative or not a number."""
    if len(values) != expected:
        raise RecordError(f"{len(values)} drop counts instead of {expected}: the record is cut off or damaged")
    numbers: list[float] = []
    for value in values:
        try:
            numbers.append(float(value))
        except ValueError:
            raise RecordError(f"drop count {len(numbers) + 1} is {value!r}, not a number") from None
    counts = np.array(numbers)
    bad = np.flatnonzero(~((counts >= 0) & (counts <= MAX_DROPS)))
    if bad.size:
        raise RecordError(f"drop count {bad[0] + 1} is {values[bad[0]]}")
    return counts


def parse_rain_rate(text: str) -> float:
    """Rate in mm/h; NaN for NAN or an empty field. Raises `RecordError` if it is not a rate."""
    if text.strip(' "').upper() in ("", "NAN", "NA"):
        return float("nan")
    rate = parse_number(text, "rain rate")
    if rate in _NO_RATES:
        return float("nan")
    if not 0 <= rate < float("inf"):
        raise RecordError(f"rain rate is {text.strip()}")
    return rate


def parse_interval_s(text: str) -> float:
    """Length of a record in s; raises `RecordError` unless it is 1 s to an hour."""
    seconds = parse_number(text, "sample interval")
    if not 1 <= seconds <= LONGEST_RECORD_S:
        raise RecordError(f"sample interval is {text.strip()[:40]} s, not 1 to {LONGEST_RECORD_S:g}")
    return seconds


def parse_number(text: str, what: str) -> float:
    """Number from text; raises `RecordError` that names the quantity."""
    try:
        return float(text)
    except ValueError:
        raise RecordError(f"{what} {text.strip()[:40]!r} is not a number") from None


def parse_utc(text: str, *formats: str) -> np.datetime64:
    """UTC time from text in the first matching format; raises `RecordError`."""
    for pattern in formats:
        try:
            return np.datetime64(datetime.strptime(text.strip(), pattern), "ms")
        except ValueError:
            continue
    raise RecordError(f"time {text.strip()[:40]!r} can't be read")
