"""Files that give a rain rate and no drops: RainSense's intensity files, and short telegrams."""

import re
from pathlib import Path

import numpy as np

from gsrain_engine.rain.disdrometer.reading import DisdrometerFileError, Reading
from gsrain_engine.rain.disdrometer.records import Record, RecordError, rain_rate
from gsrain_engine.rain.disdrometer.spectra import DropSpectra

_INTENSITY = re.compile(r"^\s*current intensity\s*:\s*(\S*)\s*$", re.IGNORECASE)


def is_rainsense_intensity(lines: list[str]) -> bool:
    """Whether the file begins with RainSense's words."""
    return bool(lines) and _INTENSITY.match(lines[0]) is not None


def read_rainsense_intensity(path: Path, lines: list[str]) -> Reading:
    """Read the one rate in mm/h of a RainSense case; it has neither a time nor a length.

    Raises `DisdrometerFileError` where it is no rate.
    """
    match = _INTENSITY.match(lines[0])
    try:
        rate = rain_rate(match[1] if match else "")
    except RecordError as error:
        raise DisdrometerFileError(path, f"line 1: {error}") from None
    if np.isnan(rate):
        raise DisdrometerFileError(path, "line 1: it says no intensity")
    nowhere = np.datetime64("NaT", "ms")
    record = Record(time=nowhere, seconds=float("nan"), reported_mm_h=rate, counts=np.zeros(0))
    return rates_reading("RainSense rain gauge", [record], [])


def rates_reading(instrument: str, records: list[Record], skipped: list[str]) -> Reading:
    """Records without a single diameter class: only their times and reported rates mean something."""
    spectra = DropSpectra(
        instrument=instrument,
        times=np.array([record.time for record in records]),
        seconds=np.array([record.seconds for record in records]),
        diameter_edges_mm=np.zeros(1),
        velocity_edges_m_s=None,
        counts=np.zeros((len(records), 0, 1)),
        area_m2=np.zeros(0),
        reported_mm_h=np.array([record.reported_mm_h for record in records]),
    )
    return Reading(spectra=spectra, skipped=tuple(skipped))
