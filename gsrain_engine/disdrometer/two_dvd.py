"""Two-dimensional video (2DVD) and Joss-Waldvogel disdrometers in ARM's NetCDF."""

from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float64, Shaped

from .instruments import JOSS_WALDVOGEL, JOSS_WALDVOGEL_AREA_M2
from .netcdf import in_mm, record_times, usable_records
from .spectra import DisdrometerFileError, DisdrometerReading, DropSpectra, SingleDrops, no_record_left

DIAMETER_EDGES_MM = np.round(0.2 * np.arange(51), 6)
VELOCITY_EDGES_M_S = 0.5 * np.arange(41)
NOMINAL_AREA_M2 = 0.01
RECORD_S = 60.0
_DIAMETER, _SPEED, _RATIO, _AREA = "equivolumetric_sphere_diameter", "fall_speed", "oblateness", "area"
_NUMBER, _CLASS = "num_drops", "drop_diameter"
_LONGEST_DAYS = 31
_LARGEST_AREA_M2 = 0.1
_SMALLEST_AREA_M2 = 0.001


def is_two_dvd(dataset: xr.Dataset) -> bool:
    """Return whether the dataset has ARM's names for single drops."""
    return {_DIAMETER, _SPEED} <= set(dataset.variables) and dataset[_DIAMETER].ndim == 1


def read_two_dvd(path: Path, dataset: xr.Dataset) -> DisdrometerReading:
    """Read single drops and count them by minute from the first drop to the last, dry minutes included.

    The area of a diameter class is the mean over its drops of each drop's measuring area. Raises `DisdrometerFileError`
    if no drop is usable.
    """
    time = str(dataset[_DIAMETER].dims[0])
    diameters, speeds, ratios, areas = (_values(dataset, name, time) for name in (_DIAMETER, _SPEED, _RATIO, _AREA))
    times = record_times(dataset, time)
    usable, skipped = _usable(diameters, speeds, times)
    if not usable.any():
        raise DisdrometerFileError(path, no_record_left(skipped))
    order = np.flatnonzero(usable)[np.argsort(times[usable], kind="stable")]
    drops = SingleDrops(
        diameters_mm=diameters[order],
        speeds_m_s=speeds[order],
        axis_ratios=np.where(ratios > 0, ratios, np.nan)[order],
        times=times[order],
    )
    if drops.times[-1] - drops.times[0] > np.timedelta64(_LONGEST_DAYS, "D"):
        raise DisdrometerFileError(
            path, f"its drops fell from {drops.times[0]} to {drops.times[-1]}: at most {_LONGEST_DAYS} days"
        )
    return DisdrometerReading(spectra=drops_by_minute(drops, 1e-6 * areas[order]), drops=drops, skipped=tuple(skipped))


def is_two_dvd_minutes(dataset: xr.Dataset) -> bool:
    """Return whether the dataset has ARM's names for drops by diameter and minute (vdis)."""
    return {_NUMBER, _CLASS} <= set(dataset.variables) and dataset[_NUMBER].dims[1:] == (_CLASS,)


def read_two_dvd_minutes(path: Path, dataset: xr.Dataset) -> DisdrometerReading:
    """Read drops by diameter, with the instrument's own rain rate. Raises `DisdrometerFileError`."""
    middles = in_mm(dataset[_CLASS])
    known = 0.5 * (DIAMETER_EDGES_MM[:-1] + DIAMETER_EDGES_MM[1:])
    if middles is None or middles.shape != known.shape or not np.allclose(middles, known, atol=0.01):
        raise DisdrometerFileError(path, f"{_CLASS}: a 2DVD has {len(known)} classes of 0.2 mm, from 0 to 10 mm")
    records = usable_records(path, dataset, dataset[_NUMBER])
    return records.by_diameter("2DVD", DIAMETER_EDGES_MM, np.full(len(known), NOMINAL_AREA_M2))


def drops_by_minute(drops: SingleDrops, areas_m2: Float64[np.ndarray, " drops"]) -> DropSpectra:
    """Count drops by minute, diameter and fall speed; the nominal area replaces unknown ones (NaN)."""
    minutes = (drops.times.astype("datetime64[m]") - drops.times[0].astype("datetime64[m]")).astype(np.int64)
    rows = np.digitize(drops.diameters_mm, DIAMETER_EDGES_MM[1:-1])
    columns = np.digitize(drops.speeds_m_s, VELOCITY_EDGES_M_S[1:-1])
    counts = np.zeros((minutes[-1] + 1, len(DIAMETER_EDGES_MM) - 1, len(VELOCITY_EDGES_M_S) - 1))
    np.add.at(counts, (minutes, rows, columns), 1)

    areas_m2 = np.where((areas_m2 >= _SMALLEST_AREA_M2) & (areas_m2 <= _LARGEST_AREA_M2), areas_m2, np.nan)
    known = np.isfinite(areas_m2)
    classes = len(DIAMETER_EDGES_MM) - 1
    seen = np.bincount(rows[known], minlength=classes)
    total = np.bincount(rows[known], areas_m2[known], minlength=classes)
    middle = float(areas_m2[known].mean()) if known.any() else NOMINAL_AREA_M2
    first_end = drops.times[0].astype("datetime64[m]") + np.timedelta64(1, "m")
    return DropSpectra(
        instrument="2DVD",
        times=(first_end + np.arange(len(counts)).astype("timedelta64[m]")).astype("datetime64[ms]"),
        seconds=np.full(len(counts), RECORD_S),
        diameter_edges_mm=DIAMETER_EDGES_MM,
        velocity_edges_m_s=VELOCITY_EDGES_M_S,
        counts=counts,
        area_m2=np.where(seen > 0, total / np.maximum(seen, 1), middle),
        reported_mm_h=np.full(len(counts), np.nan),
    )


def _values(dataset: xr.Dataset, name: str, time: str) -> Float64[np.ndarray, " drops"]:
    if name in dataset and dataset[name].dims == (time,):
        return dataset[name].to_numpy().astype(np.float64)
    return np.full(dataset.sizes[time], np.nan)


def _usable(
    diameters: Float64[np.ndarray, " drops"], speeds: Float64[np.ndarray, " drops"], times: Shaped[np.ndarray, " drops"]
) -> tuple[Bool[np.ndarray, " drops"], list[str]]:
    """Mask of drops within the classes that have a time, and a sentence for each of the others."""
    checks = (
        (~np.isnat(times), "has no time", times),
        ((diameters > 0) & (diameters <= DIAMETER_EDGES_MM[-1]), "is no drop: its diameter in mm is", diameters),
        ((speeds > 0) & (speeds <= VELOCITY_EDGES_M_S[-1]), "doesn't fall like one: its speed in m/s is", speeds),
    )
    usable = np.ones(len(times), bool)
    skipped: list[str] = []
    for good, what, values in checks:
        wrong = np.flatnonzero(usable & ~good)
        skipped += [f"drop {i + 1} ({times[i]}): it {what} {values[i]}" for i in wrong]
        usable &= good
    return usable, skipped


# Joss-Waldvogel impact disdrometer (JWD, RD-80)

_LARGEST_MM = 20


def is_joss_waldvogel(dataset: xr.Dataset) -> bool:
    """Return whether the dataset has ARM's names for drops by class."""
    return {"num_drop", "mean_diam_drop_class", "delta_diam"} <= set(dataset.variables) and dataset[
        "num_drop"
    ].ndim == 2


def read_joss_waldvogel(path: Path, dataset: xr.Dataset) -> DisdrometerReading:
    """Read the drops of each minute; raises `DisdrometerFileError` if no record is usable."""
    middles = dataset["mean_diam_drop_class"].to_numpy().astype(np.float64)
    widths = dataset["delta_diam"].to_numpy().astype(np.float64)
    edges = np.round(middles[0] - widths[0] / 2 + np.concatenate([[0.0], np.cumsum(widths)]), 4)
    if not (edges[0] >= 0 and edges[-1] < _LARGEST_MM and (np.diff(edges) > 0).all()):
        raise DisdrometerFileError(path, f"delta_diam: the diameter classes must rise within 0 to {_LARGEST_MM} mm")
    records = usable_records(path, dataset, dataset["num_drop"])
    return records.by_diameter(JOSS_WALDVOGEL, edges, np.full(len(widths), JOSS_WALDVOGEL_AREA_M2))
