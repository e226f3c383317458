"""NetCDF files with a spectrum of diameter and fall speed a record: ARM, Cloudnet, disdrodb, and others alike."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float64

from gsrain_engine.rain.disdrometer.instruments import PARSIVEL, THIES, Instrument
from gsrain_engine.rain.disdrometer.netcdf_records import (
    in_m_s,
    in_mm,
    record_seconds,
    record_times,
    reported_rates,
    usable_records,
)
from gsrain_engine.rain.disdrometer.reading import DisdrometerFileError, Reading, UnknownKindError
from gsrain_engine.rain.disdrometer.records import MOST_COUNTS, no_record_left

_SPEED_WORDS = ("vel", "speed")
_SIZE_WORDS = ("diam", "size")
_NO_CLASSES = ("width", "spread", "delta", "calculated")
_CLOSE = 0.02


class _Axes(NamedTuple):
    variable: str
    time: str
    diameter: str
    velocity: str


def read_instrument_spectra(path: Path, dataset: xr.Dataset) -> Reading:
    """Read the variable with time, diameter and fall speed as its dimensions, in whichever order.

    The instrument is told by its classes, Parsivel's or Thies's: with them comes its measuring area. Raises
    `DisdrometerFileError` where there is no such variable, where its classes are of no instrument that is known, or
    where no record can be used.
    """
    axes = _axes(path, dataset)
    spectrum = dataset[axes.variable].transpose(axes.time, axes.diameter, axes.velocity)
    if spectrum.size > MOST_COUNTS:
        raise DisdrometerFileError(path, f"{spectrum.shape[0]} spectra: split the file by days")
    if spectrum.shape[0] == 0:
        raise DisdrometerFileError(path, no_record_left(()))
    instrument = _instrument(path, dataset, axes)
    raw = spectrum.to_numpy().astype(np.float64).reshape(spectrum.shape[0], -1)
    times = record_times(dataset, axes.time)
    usable, skipped = usable_records(raw, times)
    if not usable.any():
        raise DisdrometerFileError(path, no_record_left(skipped))
    picked = np.flatnonzero(usable)[np.argsort(times[usable], kind="stable")]
    seconds = record_seconds(dataset, axes.time, times)[picked]
    reported = reported_rates(dataset, axes.time)[picked]
    return instrument.reading(path, raw[picked], "diameters first", times[picked], seconds, reported, skipped)


def _axes(path: Path, dataset: xr.Dataset) -> _Axes:
    for name, variable in dataset.data_vars.items():
        if variable.ndim != 3 or variable.dtype.kind not in "iuf" or str(name).startswith("qc_"):
            continue
        kinds = {_kind(dataset, str(dimension)): str(dimension) for dimension in variable.dims}
        if kinds.keys() == {"time", "diameter", "velocity"}:
            return _Axes(str(name), kinds["time"], kinds["diameter"], kinds["velocity"])
    names = ", ".join(str(name) for name in list(dataset.data_vars)[:8]) or "none"
    raise UnknownKindError(path, f"no variable has the dimensions time, diameter and fall speed (it has {names}, ...)")


def _kind(dataset: xr.Dataset, dimension: str) -> str:
    """`time`, `diameter` or `velocity`, by the dimension's name, else by the units of what runs along it."""
    name = dimension.lower()
    if "time" in name:
        return "time"
    if "method" in name:  # several estimates side by side
        return "unknown"
    if any(word in name for word in _SPEED_WORDS):
        return "velocity"
    if any(word in name for word in _SIZE_WORDS):
        return "diameter"
    along = [variable for variable in dataset.variables if dataset[variable].dims == (dimension,)]
    if any(in_m_s(dataset[variable]) is not None for variable in along):
        return "velocity"
    return "diameter" if any(in_mm(dataset[variable]) is not None for variable in along) else "unknown"


def _instrument(path: Path, dataset: xr.Dataset, axes: _Axes) -> Instrument:
    sizes = (dataset.sizes[axes.diameter], dataset.sizes[axes.velocity])
    for instrument in (PARSIVEL, THIES):
        if sizes != instrument.shape:
            continue
        for dimension, convert, edges in (
            (axes.diameter, in_mm, instrument.diameter_edges_mm),
            (axes.velocity, in_m_s, instrument.velocity_edges_m_s),
        ):
            if not _agree(_along(dataset, dimension, convert), edges):
                raise DisdrometerFileError(
                    path, f"{dimension} has as many classes as the {instrument.name}'s, with other bounds than it has"
                )
        return instrument
    raise UnknownKindError(
        path,
        f"{axes.variable} has {sizes[0]} diameters and {sizes[1]} fall speeds: of no instrument whose area is known",
    )


def _along(
    dataset: xr.Dataset, dimension: str, convert: Callable[[xr.DataArray], Float64[np.ndarray, "..."] | None]
) -> Float64[np.ndarray, " classes"] | None:
    """What the file says about the classes of a dimension; none where it says nothing in a unit that is known."""
    names = [dimension, *(str(name) for name in dataset.variables)]
    for name in names:
        if name in dataset.variables and dataset[name].dims == (dimension,):
            values = convert(dataset[name])
            if values is not None and not any(word in name.lower() for word in _NO_CLASSES):
                return values
    return None


def _agree(values: Float64[np.ndarray, " classes"] | None, edges: Float64[np.ndarray, " edges"]) -> bool:
    """Whether values are middles, lower or upper bounds of these classes (the last one aside), or are absent."""
    if values is None:
        return True
    lower, upper = edges[:-1], edges[1:]
    return any(
        np.allclose(values[:-1], known[:-1], rtol=_CLOSE, atol=0.01) for known in (0.5 * (lower + upper), lower, upper)
    )
