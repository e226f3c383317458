"""DISDRODB products in NetCDF (L0 to L2E): spectra with their classes and sensor."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Float64, Int64

from ..safe_io.text_files import printable_line
from .instruments import JOSS_WALDVOGEL, JOSS_WALDVOGEL_AREA_M2, PARSIVEL, THIES, Instrument
from .netcdf import in_m_s, in_mm, usable_records
from .spectra import DisdrometerFileError, DisdrometerReading

_PRODUCT, _ROLLED, _SENSOR = "disdrodb_product", "disdrodb_rolled_product", "sensor_name"
_COUNTS = ("raw_drop_number", "drop_number", "raw_drop_counts", "drop_counts")
"""Raw counts come first: GSRAIN applies its own quality control."""

_DIAMETER, _VELOCITY = "diameter_bin", "velocity_bin"
_CLOSE_MM, _CLOSE_M_S = 0.02, 0.02
_LARGEST_MM, _FASTEST_M_S = 50.0, 50.0
_MAKERS = {"PARSIVEL": PARSIVEL, "PARSIVEL2": PARSIVEL, "LPM": THIES, "LPM_V0": THIES}

_OTHERS = {
    "RD80": (JOSS_WALDVOGEL, JOSS_WALDVOGEL_AREA_M2),
    "PWS100": ("Campbell PWS100", 0.004),
    "ODM470": ("Eigenbrodt ODM470", 0.00264),
    "SWS250": ("Biral SWS250", 0.006504),
}
"""Name and area in m^2; areas as in DISDRODB's `get_sampling_area`."""


def is_disdrodb(dataset: xr.Dataset) -> bool:
    """Return whether attributes and bins are those of a DISDRODB product."""
    return (
        {_PRODUCT, _SENSOR} <= set(dataset.attrs)
        and {f"{_DIAMETER}_lower", f"{_DIAMETER}_upper"} <= set(dataset.variables)
        and any(name in dataset for name in _COUNTS)
    )


def read_disdrodb(path: Path, dataset: xr.Dataset) -> DisdrometerReading:
    """Read a product; of rolling sums, only records that don't overlap.

    Classes that a product omits at the ends of a Parsivel's or a Thies's range are restored, without drops. The rates
    of L2E are derived from the drops, so they are not used as the instrument's own rate. Raises `DisdrometerFileError`
    if the bins don't rise, the sensor is unknown, or no record is usable.
    """
    name = next(each for each in _COUNTS if each in dataset)
    measures_speed = f"{_VELOCITY}_center" in dataset[name].dims
    dims = ("time", f"{_DIAMETER}_center", *((f"{_VELOCITY}_center",) if measures_speed else ()))
    if set(dataset[name].dims) != set(dims):
        raise DisdrometerFileError(
            path, f"{name} has the dimensions {', '.join(map(str, dataset[name].dims))}, not {', '.join(dims)}"
        )
    is_rolling = str(dataset.attrs.get(_ROLLED, "")).lower() == "true"
    records = usable_records(path, dataset, dataset[name].transpose(*dims), is_rolling=is_rolling)
    sensor = str(dataset.attrs[_SENSOR])
    kind = sensor.upper().replace("-", "").removeprefix("OTT_").removeprefix("THIES_")
    diameters = _edges(path, dataset, _DIAMETER, in_mm, _LARGEST_MM)
    velocities = _edges(path, dataset, _VELOCITY, in_m_s, _FASTEST_M_S) if measures_speed else None
    maker = _MAKERS.get(kind)
    if maker is not None and velocities is not None:
        rows = _places(path, "diameter", diameters, maker.diameter_edges_mm, _CLOSE_MM)
        columns = _places(path, "velocity", velocities, maker.velocity_edges_m_s, _CLOSE_M_S)
        whole = np.zeros((len(records.counts), *maker.shape))
        whole[:, rows[:, None], columns] = records.counts.reshape(-1, len(rows), len(columns))
        return maker.reading(path, replace(records, counts=whole.reshape(len(whole), -1)), "diameters first")
    if maker is not None or kind not in _OTHERS:
        known = ", ".join((*_MAKERS, *_OTHERS))
        needed = "has no fall speeds" if maker is not None else f"is none whose area is known ({known})"
        raise DisdrometerFileError(path, f"{_SENSOR} {printable_line(sensor, 60)} {needed}")
    name, area_m2 = _OTHERS[kind]
    area = np.full(len(diameters) - 1, area_m2)
    if velocities is None:
        return records.by_diameter(name, diameters, area)
    other = Instrument(name=name, diameter_edges_mm=diameters, velocity_edges_m_s=velocities, area_m2=area)
    return other.reading(path, records, "diameters first")


def _edges(
    path: Path,
    dataset: xr.Dataset,
    axis: str,
    convert: Callable[[xr.DataArray], Float64[np.ndarray, "..."] | None],
    largest: float,
) -> Float64[np.ndarray, " edges"]:
    bounds: list[Float64[np.ndarray, " classes"]] = []
    for side in ("lower", "upper"):
        name = f"{axis}_{side}"
        if name not in dataset.variables or dataset[name].dims != (f"{axis}_center",):
            raise DisdrometerFileError(path, f"{name} is missing: the bounds of the classes")
        # DISDRODB omits the unit of some variables; it is always mm or m/s.
        values = (
            convert(dataset[name]) if dataset[name].attrs.get("units") else dataset[name].to_numpy().astype(np.float64)
        )
        if values is None:
            raise DisdrometerFileError(
                path, f"{name} is in {printable_line(dataset[name].attrs['units'], 40)}, not in mm or m/s"
            )
        bounds.append(values)
    lower, upper = bounds
    edges = np.append(lower, upper[-1:])
    if not (edges.size >= 2 and edges[0] >= 0 and edges[-1] <= largest and (np.diff(edges) > 0).all()):
        raise DisdrometerFileError(path, f"{axis}_lower and {axis}_upper must rise within 0 to {largest:g}")
    if not np.allclose(lower[1:], upper[:-1], atol=1e-3):
        raise DisdrometerFileError(path, f"{axis}_upper: each class must end where the next begins")
    return edges


def _places(
    path: Path, axis: str, edges: Float64[np.ndarray, " edges"], known: Float64[np.ndarray, " known"], close: float
) -> Int64[np.ndarray, " classes"]:
    """Indices of the file's classes among the maker's."""
    first = int(np.argmin(np.abs(known - edges[0])))
    run = known[first : first + len(edges)]
    if len(run) != len(edges) or not np.allclose(run[:-1], edges[:-1], atol=close, rtol=0):
        # The last bound is not compared: an open class may end anywhere.
        raise DisdrometerFileError(path, f"{axis}_bin_lower: its classes are not those of the sensor that it names")
    return np.arange(first, first + len(edges) - 1)
