"""Summary of a disdrometer file: contents, rejected records, and agreement of its rain rates."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..safe_io.text_files import printable_line
from .filter import QualityControlReport, apply_quality_control
from .measurement import INSTRUMENT as VIRTUAL_INSTRUMENT
from .open import read_disdrometer
from .spectra import DisdrometerReading, DropSpectra, with_common_lengths
from .tables import TableColumns

LOWEST_CHECKED_MM_H = 0.5
"""Lower rates are too coarse to compare: a Parsivel's telegram rounds them."""

FEWEST_CHECKED = 30
"""Minimum number of records above `LOWEST_CHECKED_MM_H` for a meaningful ratio."""

FEWEST_FAR_OFF, FAR_OFF = 5, 3.0
"""Number of records that suffices if the ratio is beyond 3 or 1/3."""

LOWEST_RATIO, HIGHEST_RATIO, LOWEST_CORRELATION = 0.7, 1.4, 0.9
"""Real Parsivels' drops give 0.98 to 1.14 times the instrument's rate (r = 0.99); snow and insects 2 to 80 times."""

_REASONS = 5  # maximum number of reasons printed for a file, most frequent first
_LONGEST_NAME = 80


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RateCheck:
    """Rate from the drops compared with the instrument's own, over records that report more than 0.5 mm/h."""

    records: int
    ratio: float
    """Ratio of the sums."""
    correlation: float | None
    """None if all records have the same rate."""

    @property
    def problem(self) -> str | None:
        """One sentence on the disagreement that rules out a calibration; None if rates agree or records are too few."""
        far_off = self.records >= FEWEST_FAR_OFF and not 1 / FAR_OFF <= self.ratio <= FAR_OFF
        if self.records < FEWEST_CHECKED and not far_off:
            return None
        low = self.correlation is not None and self.correlation < LOWEST_CORRELATION
        if LOWEST_RATIO <= self.ratio <= HIGHEST_RATIO and not low:
            return None
        return (
            f"its drops give {self.ratio:.3g} times the instrument's own rain rate, {_correlation(self.correlation)}, "
            f"in {self.records:,} records above {LOWEST_CHECKED_MM_H:g} mm/h; rain gives {LOWEST_RATIO:g} to "
            f"{HIGHEST_RATIO:g} times and r of {LOWEST_CORRELATION:g} or more"
        )

    @property
    def figures(self) -> str:
        return f"{self.ratio:.3f}, {_correlation(self.correlation)}"

    @property
    def agrees(self) -> bool | None:
        """None if there are too few records."""
        if self.problem is not None:
            return False
        return None if self.records < FEWEST_CHECKED else True

    @property
    def line(self) -> str:
        few = f"too few to judge, {FEWEST_CHECKED} are needed"
        verdict = {True: "agrees", False: "DISAGREES", None: few}[self.agrees]
        records = f"{self.records:,} records above {LOWEST_CHECKED_MM_H:g} mm/h"
        return f"rate from the drops over the instrument's own: {self.figures} ({records}: {verdict})"


def check_rates(measured: Sequence[DropSpectra]) -> RateCheck | None:
    """Compare rates over all records together; None if fewer than two report more than 0.5 mm/h."""
    rate = np.concatenate([each.rate_mm_h for each in measured])
    reported = np.concatenate([each.reported_mm_h for each in measured])
    checked = reported > LOWEST_CHECKED_MM_H  # NaN compares false
    if np.count_nonzero(checked) < 2:
        return None
    rate, reported = rate[checked], reported[checked]
    alike = np.ptp(rate) == 0 or np.ptp(reported) == 0
    return RateCheck(
        records=len(rate),
        ratio=float(rate.sum() / reported.sum()),
        correlation=None if alike else float(np.corrcoef(rate, reported)[0, 1]),
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MeasurementSummary:
    """Statistics of a disdrometer file, without its spectra."""

    file: str
    """File name without folders."""
    instrument: str
    records: int
    seconds: float
    """Median length of a record."""
    first: str | None
    """End of the first record, UTC, to the second; None if the file has no times."""
    last: str | None
    drops: float
    """Counted drops; fractional if derived from densities."""
    rain_mm: float
    """Rain depth from all drops."""
    reported_rain_mm: float | None
    """Rain depth by the instrument's own rate, over records that have one; None if none has."""
    skipped: tuple[tuple[str, int], ...]
    """Reasons for unreadable records with an example and a count each, most frequent first."""
    records_without_drops: int
    records_with_few_drops: int
    """Records with drops, but fewer than 10 that pass quality control."""
    quality: QualityControlReport
    rate_check: RateCheck | None
    """Check of all drops; it decides whether the rates agree."""
    used_rate_check: RateCheck | None
    """Check of the drops that pass quality control: one phantom drop of 18 mm spoils r over all drops."""

    @property
    def lines(self) -> list[str]:
        """The summary as text lines; all but the first are indented."""
        span = f", {self.first} to {self.last} UTC" if self.first is not None else ""
        own = (
            "it reports no rate of its own"
            if self.reported_rain_mm is None
            else f"{self.reported_rain_mm:.4g} mm by its own rate"
        )
        quality, instrument = self.quality, printable_line(self.instrument, _LONGEST_NAME)
        rejected = (
            ("records that can't be read", sum(count for _, count in self.skipped)),
            ("without a drop", self.records_without_drops),
            ("with fewer than 10 drops to trust", self.records_with_few_drops),
        )
        lines = [
            f"{printable_line(self.file)}: {instrument}, {self.records:,} records of {self.seconds:g} s{span}",
            f"  {self.drops:,.0f} drops, {self.rain_mm:.4g} mm of rain; {own}",
            f"  used: {quality.records_kept:,} records with {quality.drops_kept:,.0f} drops; rejected: "
            + (", ".join(f"{count:,} {what}" for what, count in rejected if count) or "nothing"),
        ]
        lines += [f"  {count:,} unreadable: {printable_line(reason)}" for reason, count in self.skipped[:_REASONS]]
        if len(self.skipped) > _REASONS:
            lines.append(f"  {sum(count for _, count in self.skipped[_REASONS:]):,} unreadable for other reasons")
        lines += [
            f"  {mask.drops:,.0f} drops removed as {mask.name}: {mask.rule}"
            for mask in quality.masks
            if mask.drops >= 0.5
        ]
        for reason in dict.fromkeys(mask.not_applied for mask in quality.masks if mask.not_applied):
            names = ", ".join(mask.name for mask in quality.masks if mask.not_applied == reason)
            lines.append(f"  not checked for {names}: {reason}")
        lines.append(f"  {self._rate_line}")
        if self.used_rate_check is not None:
            lines.append(f"  by the drops that are used: {self.used_rate_check.figures}")
        return lines

    @property
    def _rate_line(self) -> str:
        if self.rate_check is not None:
            return self.rate_check.line
        missing = (
            "it reports none" if self.reported_rain_mm is None else f"fewer than two above {LOWEST_CHECKED_MM_H:g} mm/h"
        )
        return f"rate from the drops over the instrument's own: not checked, {missing}"

    def numbers(self) -> dict[str, Any]:
        """The summary as a dictionary for `--json`, with units in the names."""
        check, used = self.rate_check, self.used_rate_check
        return {
            "file": self.file,
            "instrument": self.instrument,
            "records": self.records,
            "record_s": self.seconds,
            "first": self.first,
            "last": self.last,
            "drops": self.drops,
            "rain_mm": self.rain_mm,
            "reported_rain_mm": self.reported_rain_mm,
            "records_used": self.quality.records_kept,
            "rejected": {
                "unreadable": sum(count for _, count in self.skipped),
                "without_drops": self.records_without_drops,
                "few_drops": self.records_with_few_drops,
                "reasons": [{"reason": reason, "records": count} for reason, count in self.skipped],
            },
            "rate_ratio": None if check is None else check.ratio,
            "rate_correlation": None if check is None else check.correlation,
            "rate_records": 0 if check is None else check.records,
            "rate_ratio_used": None if used is None else used.ratio,
            "rate_correlation_used": None if used is None else used.correlation,
            "rates_agree": None if check is None else check.agrees,
            "quality": asdict(self.quality),
        }


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MeasuredFile:
    """Contents of a disdrometer file before and after quality control."""

    path: Path
    reading: DisdrometerReading
    trusted: DropSpectra
    quality: QualityControlReport

    def measured(self) -> MeasurementSummary:
        spectra = self.reading.spectra
        times = spectra.times[~np.isnat(spectra.times)].astype("datetime64[s]")
        reports = np.isfinite(spectra.reported_mm_h)
        drops = spectra.counts.sum(axis=(1, 2))
        rejected = self.quality.records - self.quality.records_kept
        dry = min(int((drops == 0).sum()), rejected)  # no simulated drop is rejected, but dry records are counted too
        rain_mm = spectra.rate_mm_h * spectra.seconds / 3600
        reported_mm = spectra.reported_mm_h * spectra.seconds / 3600
        return MeasurementSummary(
            file=self.path.name,
            instrument=spectra.instrument,
            records=len(spectra),
            seconds=float(np.median(spectra.seconds)),
            first=str(times.min()) if times.size else None,
            last=str(times.max()) if times.size else None,
            drops=float(drops.sum()),
            rain_mm=float(rain_mm.sum()),
            reported_rain_mm=float(reported_mm[reports].sum()) if reports.any() else None,
            skipped=_reasons(self.reading.skipped),
            records_without_drops=dry,
            records_with_few_drops=rejected - dry,
            quality=self.quality,
            rate_check=check_rates([spectra]),
            used_rate_check=check_rates([self.trusted]),
        )


def open_disdrometer_file(path: Path, columns: TableColumns | None = None) -> MeasuredFile:
    """Read a file and apply quality control, which keeps all simulated drops. Raises `DisdrometerFileError`.

    `columns` describes a text table whose header doesn't.
    """
    (file,) = open_disdrometer_files([path], columns)
    return file


def open_disdrometer_files(
    paths: Sequence[Path], columns: TableColumns | None = None, on_progress: Callable[[], None] | None = None
) -> list[MeasuredFile]:
    """Read the files of one measurement, as `open_disdrometer_file` does each; calls `on_progress` after each.

    The length of records that no single file tells follows from the times of all (`with_common_lengths`).
    """
    readings: list[DisdrometerReading] = []
    for path in paths:
        readings.append(read_disdrometer(path, columns))
        if on_progress is not None:
            on_progress()
    return [_measured(path, each) for path, each in zip(paths, with_common_lengths(readings), strict=True)]


def _measured(path: Path, reading: DisdrometerReading) -> MeasuredFile:
    if reading.spectra.instrument == VIRTUAL_INSTRUMENT:
        trusted, quality = apply_quality_control(reading.spectra, smallest_mm=0, speed_tolerance=np.inf, fewest_drops=0)
    else:
        trusted, quality = apply_quality_control(reading.spectra)
    return MeasuredFile(path=path, reading=reading, trusted=trusted, quality=quality)


def _reasons(skipped: Sequence[str]) -> tuple[tuple[str, int], ...]:
    """Count sentences that differ only in numbers and quoted names together, under the first of each kind."""
    examples: dict[str, str] = {}
    counts: Counter[str] = Counter()
    for sentence in skipped:
        reason = sentence.partition(": ")[2] or sentence
        kind = re.sub(r"'[^']*'|\d+([.:T-]\d+)*", "0", reason)
        examples.setdefault(kind, reason)
        counts[kind] += 1
    return tuple((examples[kind], count) for kind, count in counts.most_common())


def _correlation(value: float | None) -> str:
    return "all rates alike" if value is None else f"r = {value:.3f}"
