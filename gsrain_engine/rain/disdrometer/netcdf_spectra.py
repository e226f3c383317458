"""Our own file of drop spectra: NetCDF-4 (CF-1.10), every array of `DropSpectra` by its own name and unit."""

from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Float64

from gsrain_engine.scene.atomic_files import whole_file

from .reading import DisdrometerFileError, Reading
from .spectra import DropSpectra

FORMAT_ATTRIBUTE = "gsrain_drop_spectra"
"""Attribute of the file that tells it from others; its value is the version of the layout."""

_VERSION = 1
_NAMES = ("time", "seconds", "diameter", "diameter_bounds", "area", "drops", "rainfall_rate")
_EPOCH = np.datetime64("1970-01-01T00:00:00", "ms")
_TIME_UNITS = "milliseconds since 1970-01-01T00:00:00Z"


def write_spectra(path: Path | str, spectra: DropSpectra) -> None:
    """Write spectra to a file, whole or not at all."""
    speeds = spectra.velocities_m_s
    counts = spectra.counts if speeds is not None else spectra.counts[:, :, 0]
    axes = ("time", "diameter", "velocity")[: counts.ndim]
    since = (spectra.times - _EPOCH) / np.timedelta64(1, "ms")
    variables = {
        "time": ("time", since, {"units": _TIME_UNITS, "calendar": "standard", "long_name": "end of the record, UTC"}),
        "seconds": ("time", spectra.seconds, {"units": "s", "long_name": "length of the record"}),
        "diameter": ("diameter", spectra.diameters_mm, _axis("mm", "diameter", "volume-equivalent drop diameter")),
        "diameter_bounds": (("diameter", "bound"), _bounds(spectra.diameter_edges_mm), {"units": "mm"}),
        "area": ("diameter", spectra.area_m2, {"units": "m2", "long_name": "horizontal area in which drops count"}),
        "drops": (axes, counts, {"units": "1", "long_name": "drops counted"}),
        "rainfall_rate": (
            "time",
            spectra.reported_mm_h,
            {"units": "mm h-1", "standard_name": "rainfall_rate", "long_name": "rain rate that the instrument reports"},
        ),
    }
    if speeds is not None and spectra.velocity_edges_m_s is not None:
        variables["velocity"] = ("velocity", speeds, _axis("m s-1", "velocity", "fall speed"))
        variables["velocity_bounds"] = (("velocity", "bound"), _bounds(spectra.velocity_edges_m_s), {"units": "m s-1"})
    file = xr.Dataset(
        variables,
        attrs={
            "Conventions": "CF-1.10",
            "title": "Drop size and fall speed spectra",
            "instrument": spectra.instrument,
            FORMAT_ATTRIBUTE: _VERSION,
        },
    )
    encoding = {name: {"_FillValue": None} for name in file.variables} | {
        "drops": {"_FillValue": None, "zlib": True, "complevel": 4, "shuffle": True}
    }
    with whole_file(Path(path)) as beside:
        file.to_netcdf(beside, engine="h5netcdf", encoding=encoding)


def is_gsrain_spectra(dataset: xr.Dataset) -> bool:
    """Whether `write_spectra` wrote this."""
    return FORMAT_ATTRIBUTE in dataset.attrs


def read_gsrain_spectra(path: Path, dataset: xr.Dataset) -> Reading:
    """Read what `write_spectra` wrote. Raises `DisdrometerFileError` where an array is missing or can't be right."""
    version = dataset.attrs[FORMAT_ATTRIBUTE]
    if version != _VERSION:
        raise DisdrometerFileError(path, f"{FORMAT_ATTRIBUTE} is {version}; this GSRAIN reads {_VERSION}")
    missing = [name for name in _NAMES if name not in dataset.variables]
    if missing:
        raise DisdrometerFileError(path, f"{missing[0]} is missing")
    try:
        return Reading(spectra=_spectra(dataset))
    except ValueError as error:
        raise DisdrometerFileError(path, str(error)) from None


def _spectra(dataset: xr.Dataset) -> DropSpectra:
    counts = _numbers(dataset, "drops", 0.0)
    measures_speed = "velocity_bounds" in dataset.variables
    return DropSpectra(
        instrument=str(dataset.attrs.get("instrument", "unknown")),
        times=dataset["time"].to_numpy().astype("datetime64[ms]"),
        seconds=_numbers(dataset, "seconds", 1e-3),
        diameter_edges_mm=_edges(dataset, "diameter_bounds"),
        velocity_edges_m_s=_edges(dataset, "velocity_bounds") if measures_speed else None,
        counts=counts if measures_speed else counts[..., None],
        area_m2=_numbers(dataset, "area", 1e-9),
        reported_mm_h=dataset["rainfall_rate"].to_numpy().astype(np.float64),
    )


def _numbers(dataset: xr.Dataset, name: str, least: float) -> Float64[np.ndarray, "..."]:
    values = dataset[name].to_numpy().astype(np.float64)
    if not np.all(np.isfinite(values) & (values >= least)):
        raise ValueError(f"{name} must be numbers of at least {least:g}")
    return values


def _axis(units: str, name: str, long_name: str) -> dict[str, str]:
    return {"units": units, "bounds": f"{name}_bounds", "long_name": long_name}


def _bounds(edges: Float64[np.ndarray, " n_and_one"]) -> Float64[np.ndarray, "n 2"]:
    return np.stack([edges[:-1], edges[1:]], axis=1)


def _edges(dataset: xr.Dataset, name: str) -> Float64[np.ndarray, " n_and_one"]:
    bounds = _numbers(dataset, name, 0.0)
    edges = np.append(bounds[:, 0], bounds[-1:, 1])
    if not np.all(np.diff(edges) > 0):
        raise ValueError(f"{name} must rise")
    return edges
