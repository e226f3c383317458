"""Counts of drops by diameter and fall speed: what every disdrometer measures, real or virtual."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Shaped

from ..safe_io.text_files import printable_line


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DropSpectra:
    """One spectrum a record, in order of time."""

    instrument: str
    """As a person would call it: OTT Parsivel."""
    times: Shaped[np.ndarray, " records"]
    """When each record ended, in UTC, datetime64[ms]; NaT where the file doesn't say."""
    seconds: Float64[np.ndarray, " records"]
    """How long each record was measured."""
    diameter_edges_mm: Float64[np.ndarray, " diameters_and_one"]
    """Bounds of the diameter classes, rising; of the sphere that holds the drop's water."""
    velocity_edges_m_s: Float64[np.ndarray, " velocities_and_one"] | None
    """Bounds of the fall-speed classes, rising; none where the instrument measures no speed."""
    counts: Float64[np.ndarray, "records diameters velocities"]
    """Drops; one velocity class where the instrument measures no speed."""
    area_m2: Float64[np.ndarray, " diameters"]
    """Horizontal area in which a drop of each class is counted."""
    reported_mm_h: Float64[np.ndarray, " records"]
    """The instrument's own rain rate; NaN where it gives none."""

    def __post_init__(self) -> None:
        if self.velocity_edges_m_s is None and self.counts.shape[2] != 1:
            raise ValueError(f"counts of {self.counts.shape[2]} velocity classes without their bounds")

    def __len__(self) -> int:
        return len(self.counts)

    def __getitem__(self, records: slice | Bool[np.ndarray, " picked"]) -> "DropSpectra":
        """Some of the records."""
        return replace(
            self,
            times=self.times[records],
            seconds=self.seconds[records],
            counts=self.counts[records],
            reported_mm_h=self.reported_mm_h[records],
        )

    @property
    def diameters_mm(self) -> Float64[np.ndarray, " diameters"]:
        """Middle of each diameter class."""
        return 0.5 * (self.diameter_edges_mm[:-1] + self.diameter_edges_mm[1:])

    @property
    def velocities_m_s(self) -> Float64[np.ndarray, " velocities"] | None:
        """Middle of each fall-speed class, where speed is measured."""
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
        """Join records of one instrument: same classes, same area. Raises `ValueError` when they differ."""
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


# § What a disdrometer file gives: spectra, single drops where the instrument sees them, and what was left out.


class DisdrometerFileError(ValueError):
    """A file from which no record can be taken, in one sentence: which file, which record, and why."""

    def __init__(self, path: Path, reason: str):
        super().__init__(f"{path}: {printable_line(reason)}")


KNOWN_KINDS = (
    "OTT Parsivel (telegrams, ASDO's text, station logs, Campbell TOA5, CSV of pyAtmosLogger and SCAMP, NetCDF of "
    "Cloudnet, ARM and DISDRODB), Thies LNM (telegrams, NetCDF), Joss-Waldvogel RD-80 (text, ARM's NetCDF), "
    "2DVD (ARM's NetCDF, NASA's tables), APU (NASA's tables), RainSense, what gsrain disdrometer -o writes"
)
"""Files that are told apart by what they hold, for people."""


class UnknownKindError(DisdrometerFileError):
    """A file of no kind that is known; `problem` says so without its name.

    `kind` says what else it is, where that is plain ("an archive: unpack it").
    """

    def __init__(self, path: Path, what: str, kind: str | None = None):
        other = "of any other table of text say which column is what, by --columns FILE.yaml"
        known = f"{printable_line(what)}; known are {KNOWN_KINDS}; {other}"
        self.problem = known if kind is None else f"not a disdrometer file; it is {kind}"
        self.kind = kind
        ValueError.__init__(self, f"{path}: {self.problem}")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SingleDrops:
    """Drops seen one by one, in order of time."""

    diameters_mm: Float64[np.ndarray, " drops"]
    """Diameter of the sphere that holds the drop's water."""
    speeds_m_s: Float64[np.ndarray, " drops"]
    """Fall speed, downwards positive."""
    axis_ratios: Float64[np.ndarray, " drops"]
    """Height over width; NaN where it wasn't measured."""
    times: Shaped[np.ndarray, " drops"]
    """UTC, datetime64[ms]."""

    def __len__(self) -> int:
        return len(self.diameters_mm)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DisdrometerReading:
    """One file, read."""

    spectra: DropSpectra
    drops: SingleDrops | None = None
    """Where the instrument sees single drops (2DVD)."""
    skipped: tuple[str, ...] = ()
    """One sentence for each record left out: which, and why."""


# § Records of a disdrometer's log, one by one: numbers and times from text, and what makes spectra of them.

MAX_COUNTS = 2**27
"""Numbers in all spectra of one file: 1 GiB, or three months of a Parsivel's minutes."""

FACTORY_SECONDS = 60.0
"""Length of a record where the file neither states nor shows it: what the makers set."""

MAX_DROPS = 1e9
"""In one class of one record: more is damage, not rain."""

LONGEST_RECORD_S = 3600.0
"""Also the longest step from record to record that shows their length."""

_NO_RATES = (-9.999, -99.9, -99.99, -999.0, -9999.0)
"""Loggers' numbers for none."""


class RecordError(ValueError):
    """Why a record can't be used."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SpectrumRecord:
    """One spectrum as its file writes it."""

    time: np.datetime64
    """End of the record, UTC, in milliseconds."""
    seconds: float
    """NaN where the file doesn't say."""
    reported_mm_h: float
    """NaN where the instrument gives none."""
    counts: Float64[np.ndarray, " classes"]
    """In the order of the file."""


def parse_records(
    path: Path, numbered: Iterable[tuple[str, str]], parse: Callable[[str], SpectrumRecord]
) -> tuple[list[SpectrumRecord], list[str]]:
    """Parse each record; those that can't be used become sentences.

    `numbered` says where a record stands ("line 7") and its text. Returns the records in order of time, each with
    its length. Raises `DisdrometerFileError` where none is left or where they are more than memory allows.
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
    return _with_seconds(sorted(records, key=lambda record: record.time)), skipped


def no_record_left(skipped: Sequence[str]) -> str:
    """Say why a file gives no record at all: the first reason, and how many more there are."""
    if not skipped:
        return "it holds no record"
    more = f" (and {len(skipped) - 1} more such records)" if len(skipped) > 1 else ""
    return f"no record can be used: {skipped[0]}{more}"


def median_step_s(times: Sequence[np.datetime64]) -> float:
    """Usual time from one record to the next in s; `FACTORY_SECONDS` where none shows."""
    steps = [float((later - earlier) / np.timedelta64(1, "s")) for earlier, later in pairwise(times)]
    near = [step for step in steps if 0 < step <= LONGEST_RECORD_S]
    return float(np.median(near)) if near else FACTORY_SECONDS


def _with_seconds(records: list[SpectrumRecord]) -> list[SpectrumRecord]:
    if not any(np.isnan(record.seconds) for record in records):
        return records
    step = median_step_s([record.time for record in records])
    return [replace(record, seconds=step) if np.isnan(record.seconds) else record for record in records]


def parse_drop_counts(values: Sequence[str], expected: int) -> Float64[np.ndarray, " classes"]:
    """Counts of drops as numbers; raises `RecordError` where one is missing, negative or not a number."""
    if len(values) != expected:
        raise RecordError(f"{len(values)} drop counts instead of {expected}: the record is cut off or damaged")
    try:
        counts = np.array([float(value) for value in values])
    except ValueError:
        wrong = next(i for i, value in enumerate(values) if not _is_number(value))
        raise RecordError(f"drop count {wrong + 1} is {values[wrong]!r}, not a number") from None
    bad = np.flatnonzero(~((counts >= 0) & (counts <= MAX_DROPS)))
    if bad.size:
        raise RecordError(f"drop count {bad[0] + 1} is {values[bad[0]]}")
    return counts


def parse_rain_rate(text: str) -> float:
    """Rate in mm/h; NaN where a logger wrote NAN or nothing. Raises `RecordError` where it is no rate."""
    if text.strip(' "').upper() in ("", "NAN", "NA"):
        return float("nan")
    rate = parse_number(text, "rain rate")
    if rate in _NO_RATES:
        return float("nan")
    if not 0 <= rate < float("inf"):
        raise RecordError(f"rain rate is {text.strip()}")
    return rate


def parse_interval_s(text: str) -> float:
    """Length of a record in s; raises `RecordError` where it is not 1 s to an hour."""
    seconds = parse_number(text, "sample interval")
    if not 1 <= seconds <= LONGEST_RECORD_S:
        raise RecordError(f"sample interval is {text.strip()[:40]} s, not 1 to {LONGEST_RECORD_S:g}")
    return seconds


def parse_number(text: str, what: str) -> float:
    """Number from text; raises `RecordError` that says what isn't one."""
    try:
        return float(text)
    except ValueError:
        raise RecordError(f"{what} {text.strip()[:40]!r} is not a number") from None


def parse_utc(text: str, *formats: str) -> np.datetime64:
    """Time in UTC from text in the first of these formats that fits; raises `RecordError`."""
    for pattern in formats:
        try:
            return np.datetime64(datetime.strptime(text.strip(), pattern), "ms")
        except ValueError:
            continue
    raise RecordError(f"time {text.strip()[:40]!r} can't be read")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
