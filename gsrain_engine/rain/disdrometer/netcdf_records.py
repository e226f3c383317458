"""What every disdrometer's NetCDF file has: times, rates in some unit, and records that can't be used."""

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float64, Shaped

from gsrain_engine.rain.disdrometer.records import MOST_DROPS, usual_step_s

_MM_H = {"mm/h": 1.0, "mm/s": 3600.0, "m/s": 3.6e6, "kg/m2/s": 3600.0}
_MM = {"mm": 1.0, "millimeter": 1.0, "m": 1000.0, "meter": 1000.0, "cm": 10.0, "um": 1e-3, "µm": 1e-3}
_M_S = {"m/s": 1.0, "cm/s": 0.01}
_RATES = ("rainfall_rate_32bit", "precip_rate", "rainfall_rate", "rain_rate", "precipitation_rate", "rain_intensity")
_INTERVALS = ("interval", "sample_interval", "measurement_interval", "sampling_interval")


def in_unit(variable: xr.DataArray, factors: dict[str, float]) -> Float64[np.ndarray, "..."] | None:
    """Values in the unit whose spellings have these factors; none where the variable's unit is another."""
    factor = factors.get(_plain_unit(str(variable.attrs.get("units", ""))))
    with np.errstate(over="ignore"):
        return None if factor is None else variable.to_numpy().astype(np.float64) * factor


def in_mm(variable: xr.DataArray) -> Float64[np.ndarray, "..."] | None:
    """Values in mm; none where they are no lengths."""
    return in_unit(variable, _MM)


def in_m_s(variable: xr.DataArray) -> Float64[np.ndarray, "..."] | None:
    """Values in m/s; none where they are no speeds."""
    return in_unit(variable, _M_S)


def _plain_unit(unit: str) -> str:
    """`mm hr-1`, `mm h^-1`, `mm/hr` and `mm hour**-1` are all mm/h."""
    text = unit.strip().replace("**", "").replace("^", "").replace("hour", "h").replace("hr", "h").replace("sec", "s")
    parts = text.replace(" / ", "/").split()
    top = [part for part in parts if not part.endswith("-1")]
    return "/".join([" ".join(top), *(part.removesuffix("-1") for part in parts if part.endswith("-1"))]).replace(
        "kg m-2", "kg/m2"
    )


def record_times(dataset: xr.Dataset, dimension: str) -> Shaped[np.ndarray, " records"]:
    """Times of the records, datetime64[ms]; NaT where the file has none."""
    size = dataset.sizes[dimension]
    for name in (dimension, "time"):
        if name in dataset.variables and dataset[name].shape == (size,):
            values = dataset[name].to_numpy()
            if np.issubdtype(values.dtype, np.datetime64):
                return values.astype("datetime64[ms]")
    return np.full(size, np.datetime64("NaT", "ms"))


def reported_rates(dataset: xr.Dataset, dimension: str) -> Float64[np.ndarray, " records"]:
    """The instrument's own rate in mm/h; NaN where it gives none, or a negative one."""
    found = [name for name in _RATES if name in dataset]
    found += [str(name) for name in dataset.data_vars if "rain" in str(name) or "precip" in str(name)]
    for name in found:
        if dataset[name].dims == (dimension,):
            rates = in_unit(dataset[name], _MM_H)
            if rates is not None:
                return np.where((rates >= 0) & (rates < np.inf), rates, np.nan)
    return np.full(dataset.sizes[dimension], np.nan)


def record_seconds(
    dataset: xr.Dataset, dimension: str, times: Shaped[np.ndarray, " records"]
) -> Float64[np.ndarray, " records"]:
    """Length of each record in s: what the file says, else the usual step from one to the next."""
    step = usual_step_s(list(np.sort(times)))
    for name in _INTERVALS:
        if name in dataset and dataset[name].dims in ((), (dimension,)):
            stated = dataset[name].to_numpy().astype(np.float64)
            stated = np.broadcast_to(stated, len(times))
            return np.where((stated >= 1) & (stated <= 3600), stated, step)
    return np.full(len(times), step)


def usable_records(
    counts: Float64[np.ndarray, "records classes"], times: Shaped[np.ndarray, " records"]
) -> tuple[Bool[np.ndarray, " records"], list[str]]:
    """Which records have counts that are all numbers from 0 on, and a sentence for each of the others."""
    good = (counts >= 0) & (counts <= MOST_DROPS)
    usable = np.asarray(good.all(axis=1))
    wrong = "drop counts are missing, negative or beyond any rain"
    skipped = [
        f"record {i + 1} ({times[i]}): {int((~good[i]).sum())} of {counts.shape[1]} {wrong}"
        for i in np.flatnonzero(~usable)
    ]
    return usable, skipped
