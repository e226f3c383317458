"""NASA's ground-validation tables: a minute a row, as year, day of the year, hour, minute and a number a diameter."""

import re
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from gsrain_engine.rain.calibration import atlas_velocity
from gsrain_engine.rain.disdrometer import parsivel_classes
from gsrain_engine.rain.disdrometer.reading import Reading
from gsrain_engine.rain.disdrometer.records import Record, RecordError, drop_counts, gather
from gsrain_engine.rain.disdrometer.spectra import DropSpectra

MINUTE_S = 60.0
TWO_DVD_EDGES_MM = 0.2 * np.arange(51)
TWO_DVD_AREA_M2 = 0.01
"""Nominal: 10 x 10 cm (Kruger and Krajewski 2002)."""

_STAMP = 4
_APU, _COUNTS = 32, 50
_ROW = re.compile(r"^\s*(19|20)\d\d\s+\d{1,3}\s+\d{1,2}\s+\d{1,2}\s")


def is_minute_table(lines: list[str]) -> bool:
    """Recognize a minute with the 32 diameters of an APU or the 50 of a 2DVD in the first full row."""
    first = next((line for line in lines if line.strip()), "")
    return _ROW.match(first) is not None and len(first.split()) - _STAMP in (_APU, _COUNTS)


def read_minute_table(path: Path, lines: list[str]) -> Reading:
    """Read either table; raises `DisdrometerFileError` where no row can be used.

    Both come as drops counted (`dropcounts`, whole numbers) and as number densities in 1/(m^3 mm) (`rainDSD`, with
    decimals), of which one file has one: densities become the counts that the instrument would have made of them.
    """
    first = next(line for line in lines if line.strip())
    classes = len(first.split()) - _STAMP
    records, skipped = gather(path, _rows(lines), lambda row: _record(row, classes))
    values = np.stack([record.counts for record in records])
    if classes == _COUNTS:
        name, edges, area = "2DVD", TWO_DVD_EDGES_MM, np.full(_COUNTS, TWO_DVD_AREA_M2)
    else:
        name, edges, area = "APU (OTT Parsivel)", parsivel_classes.DIAMETER_EDGES_MM, parsivel_classes.AREA_M2
    counts = values if "." not in first else drops_of_densities(values, edges, area, MINUTE_S)
    spectra = DropSpectra(
        instrument=name,
        times=np.array([record.time for record in records]),
        seconds=np.full(len(records), MINUTE_S),
        diameter_edges_mm=edges,
        velocity_edges_m_s=None,
        counts=counts[:, :, None],
        area_m2=area,
        reported_mm_h=np.full(len(records), np.nan),
    )
    return Reading(spectra=spectra, skipped=tuple(skipped))


def _rows(lines: list[str]) -> Iterator[tuple[str, str]]:
    for i, line in enumerate(lines):
        if line.strip():
            yield f"line {i + 1}", line


def _record(row: str, classes: int) -> Record:
    values = row.split()
    try:
        year, day, hour, minute = (int(value) for value in values[:_STAMP])
        begin = datetime.strptime(f"{year} {day} {hour} {minute}", "%Y %j %H %M")
    except ValueError:
        raise RecordError(f"{' '.join(values[:_STAMP])[:40]!r} is no year, day of the year, hour and minute") from None
    end = begin + timedelta(seconds=MINUTE_S)
    return Record(
        time=np.datetime64(end, "ms"),
        seconds=MINUTE_S,
        reported_mm_h=float("nan"),
        counts=drop_counts(values[_STAMP:], classes),
    )


def drops_of_densities(
    density_m3_mm: Float64[np.ndarray, "records diameters"],
    edges_mm: Float64[np.ndarray, " diameters_and_one"],
    area_m2: float | Float64[np.ndarray, " diameters"],
    seconds: float | Float64[np.ndarray, " records"],
) -> Float64[np.ndarray, "records diameters"]:
    """Drops that would have been counted, not whole numbers: N(D) dD, at the fall speed of Atlas et al. (1973)."""
    swept_m3_s = atlas_velocity(0.5 * (edges_mm[:-1] + edges_mm[1:])) * area_m2
    return density_m3_mm * np.diff(edges_mm) * swept_m3_s * np.reshape(seconds, (-1, 1))
