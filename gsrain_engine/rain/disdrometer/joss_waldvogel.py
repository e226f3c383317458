"""Joss-Waldvogel impact disdrometer (JWD, RD-80): its 20 diameters, without fall speeds; and ARM's NetCDF of it."""

from pathlib import Path

import numpy as np
import xarray as xr

from gsrain_engine.rain.disdrometer.netcdf_records import record_seconds, record_times, reported_rates, usable_records
from gsrain_engine.rain.disdrometer.reading import DisdrometerFileError, Reading
from gsrain_engine.rain.disdrometer.records import no_record_left
from gsrain_engine.rain.disdrometer.spectra import DropSpectra

NAME = "Joss-Waldvogel"
AREA_M2 = 0.005
"""The cone's 50 cm^2 (Joss and Waldvogel 1967)."""
RD80_EDGES_MM = np.array(
    [0.313, 0.405, 0.505, 0.596, 0.715, 0.827, 0.999, 1.232, 1.429, 1.582, 1.748]
    + [2.077, 2.441, 2.727, 3.011, 3.385, 3.704, 4.127, 4.573, 5.145, 5.6]
)
"""Bounds of an RD-80's classes (Distromet's instructions); the last one is open, and ends here."""

_LARGEST_MM = 20


def is_joss_waldvogel(dataset: xr.Dataset) -> bool:
    """Whether the dataset has ARM's names for drops by class."""
    return {"num_drop", "mean_diam_drop_class", "delta_diam"} <= set(dataset.variables) and dataset[
        "num_drop"
    ].ndim == 2


def read_joss_waldvogel(path: Path, dataset: xr.Dataset) -> Reading:
    """Read the drops of each minute; raises `DisdrometerFileError` where no record can be used."""
    time, _ = (str(dimension) for dimension in dataset["num_drop"].dims)
    middles = dataset["mean_diam_drop_class"].to_numpy().astype(np.float64)
    widths = dataset["delta_diam"].to_numpy().astype(np.float64)
    edges = np.round(middles[0] - widths[0] / 2 + np.concatenate([[0.0], np.cumsum(widths)]), 4)
    if not (edges[0] >= 0 and edges[-1] < _LARGEST_MM and (np.diff(edges) > 0).all()):
        raise DisdrometerFileError(path, f"delta_diam: the diameter classes must rise within 0 to {_LARGEST_MM} mm")
    counts = dataset["num_drop"].to_numpy().astype(np.float64)
    times = record_times(dataset, time)
    usable, skipped = usable_records(counts, times)
    if not usable.any():
        raise DisdrometerFileError(path, no_record_left(skipped))
    spectra = DropSpectra(
        instrument=NAME,
        times=times,
        seconds=record_seconds(dataset, time, times),
        diameter_edges_mm=edges,
        velocity_edges_m_s=None,
        counts=counts[:, :, None],
        area_m2=np.full(len(widths), AREA_M2),
        reported_mm_h=reported_rates(dataset, time),
    )
    return Reading(spectra=spectra[usable], skipped=tuple(skipped))
