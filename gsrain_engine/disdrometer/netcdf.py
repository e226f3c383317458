"""NetCDF files of drop spectra: shared variables, GSRAIN's own format, and instruments' spectra."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float64, Shaped

from ..safe_io.files import whole_file
from .instruments import PARSIVEL, THIES, Instrument
from .spectra import (
    MAX_COUNTS,
    MAX_DROPS,
    DisdrometerFileError,
    DisdrometerReading,
    DropSpectra,
    SpectrumRecords,
    UnknownKindError,
    median_step_s,
    no_record_left,
)

_MM_H = {"mm/h": 1.0, "mm/s": 3600.0, "m/s": 3.6e6, "kg/m2/s": 3600.0}
_MM = {"mm": 1.0, "millimeter": 1.0, "m": 1000.0, "meter": 1000.0, "cm": 10.0, "um": 1e-3, "µm": 1e-3}
_M_S = {"m/s": 1.0, "cm/s": 0.01}
_RATES = ("rainfall_rate_32bit", "precip_rate", "rainfall_rate", "rain_rate", "precipitation_rate", "rain_intensity")
_INTERVALS = ("interval", "sample_interval", "measurement_interval", "sampling_interval")


def in_unit(variable: xr.DataArray, factors: dict[str, float]) -> Float64[np.ndarray, "..."] | None:
    """Values converted by the factor of the variable's unit; None for other units."""
    factor = factors.get(_plain_unit(str(variable.attrs.get("units", ""))))
    with np.errstate(over="ignore"):
        return None if factor is None else variable.to_numpy().astype(np.float64) * factor


def in_mm(variable: xr.DataArray) -> Float64[np.ndarray, "..."] | None:
    """Values in mm; None if the unit is not a length."""
    return in_unit(variable, _MM)


def in_m_s(variable: xr.DataArray) -> Float64[np.ndarray, "..."] | None:
    """Values in m/s; None if the unit is not a speed."""
    return in_unit(variable, _M_S)


def _plain_unit(unit: str) -> str:
    """Normalize a unit's spelling: `mm hr-1`, `mm h^-1`, `mm/hr` and `mm hour**-1` are all mm/h."""
    text = unit.strip().replace("**", "").replace("^", "").replace("hour", "h").replace("hr", "h").replace("sec", "s")
    parts = text.replace(" / ", "/").split()
    top = [part for part in parts if not part.endswith("-1")]
    return "/".join([" ".join(top), *(part.removesuffix("-1") for part in parts if part.endswith("-1"))]).replace(
        "kg m-2", "kg/m2"
    )


def record_times(dataset: xr.Dataset, dimension: str) -> Shaped[np.ndarray, " records"]:
    """Times of the records, datetime64[ms]; NaT if the file has none."""
    size = dataset.sizes[dimension]
    for name in (dimension, "time"):
        if name in dataset.variables and dataset[name].shape == (size,):
            values = dataset[name].to_numpy()
            if np.issubdtype(values.dtype, np.datetime64):
                return values.astype("datetime64[ms]")
    return np.full(size, np.datetime64("NaT", "ms"))


def reported_rates(dataset: xr.Dataset, dimension: str) -> Float64[np.ndarray, " records"]:
    """The instrument's own rate in mm/h; NaN if missing or negative."""
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
    """Length of each record in s: as stated in the file, otherwise the median step between records."""
    step = median_step_s(np.sort(times))
    for name in _INTERVALS:
        if name in dataset and dataset[name].dims in ((), (dimension,)):
            stated = dataset[name].to_numpy().astype(np.float64)
            stated = np.broadcast_to(stated, len(times))
            return np.where((stated >= 1) & (stated <= 3600), stated, step)
    return np.full(len(times), step)


def usable_records(
    path: Path, dataset: xr.Dataset, variable: xr.DataArray, *, is_rolling: bool = False
) -> SpectrumRecords:
    """Records of a variable of counts, its first dimension that of the records.

    Records with a missing or negative count are skipped, and of rolling sums those that overlap the one before. Raises
    `DisdrometerFileError` if none is left, or if there are too many.
    """
    if variable.size > MAX_COUNTS:
        raise DisdrometerFileError(path, f"{len(variable)} spectra: split the file by days")
    if not len(variable):
        raise DisdrometerFileError(path, no_record_left(()))
    time = str(variable.dims[0])
    counts = variable.to_numpy().astype(np.float64).reshape(len(variable), -1)
    times = record_times(dataset, time)
    seconds, reported = record_seconds(dataset, time, times), reported_rates(dataset, time)
    good = (counts >= 0) & (counts <= MAX_DROPS)
    usable = np.asarray(good.all(axis=1))
    wrong = "drop counts are missing, negative or beyond any rain"
    skipped = [
        f"record {i + 1} ({times[i]}): {int((~good[i]).sum())} of {counts.shape[1]} {wrong}"
        for i in np.flatnonzero(~usable)
    ]
    if is_rolling:
        overlapping = _overlapping(times, seconds)
        skipped += [
            f"record {i + 1} ({times[i]}): it overlaps the one before (sums that roll on)"
            for i in np.flatnonzero(usable & overlapping)
        ]
        usable &= ~overlapping
    if not usable.any():
        raise DisdrometerFileError(path, no_record_left(skipped))
    picked = np.flatnonzero(usable)[np.argsort(times[usable], kind="stable")]
    return SpectrumRecords(
        times=times[picked],
        seconds=seconds[picked],
        reported_mm_h=reported[picked],
        counts=counts[picked],
        skipped=tuple(skipped),
    )


def _overlapping(
    times: Shaped[np.ndarray, " records"], seconds: Float64[np.ndarray, " records"]
) -> Bool[np.ndarray, " records"]:
    """Mask of records that begin before the last accepted record has ended; times are ends."""
    overlapping = np.zeros(len(times), bool)
    last_end = None
    for i in np.argsort(times, kind="stable"):
        if np.isnat(times[i]):
            continue
        start = times[i] - np.timedelta64(round(1000 * float(seconds[i])), "ms")
        overlapping[i] = last_end is not None and start < last_end
        if not overlapping[i]:
            last_end = times[i]
    return overlapping


# GSRAIN's drop-spectra format: NetCDF-4 (CF-1.10)

FORMAT_ATTRIBUTE = "gsrain_drop_spectra"
"""File attribute that identifies the format; its value is the layout version."""

_VERSION = 1
_NAMES = ("time", "seconds", "diameter", "diameter_bounds", "area", "drops", "rainfall_rate")
_EPOCH = np.datetime64("1970-01-01T00:00:00", "ms")
_TIME_UNITS = "milliseconds since 1970-01-01T00:00:00Z"


def write_spectra(path: Path | str, spectra: DropSpectra) -> None:
    """Write spectra to a file atomically."""
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
    """Return whether `write_spectra` wrote the dataset."""
    return FORMAT_ATTRIBUTE in dataset.attrs


def read_gsrain_spectra(path: Path, dataset: xr.Dataset) -> DisdrometerReading:
    """Read a file of `write_spectra`. Raises `DisdrometerFileError` if an array is missing or invalid."""
    version = dataset.attrs[FORMAT_ATTRIBUTE]
    if version != _VERSION:
        raise DisdrometerFileError(path, f"{FORMAT_ATTRIBUTE} is {version}; this GSRAIN reads {_VERSION}")
    missing = [name for name in _NAMES if name not in dataset.variables]
    if missing:
        raise DisdrometerFileError(path, f"{missing[0]} is missing")
    try:
        return DisdrometerReading(spectra=_spectra(dataset))
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


# Instruments' spectra: ARM, Cloudnet, disdrodb and similar

_SPEED_WORDS = ("vel", "speed")
_SIZE_WORDS = ("diam", "size")
_NO_CLASSES = ("width", "spread", "delta", "calculated")
_CLOSE = 0.02


class _Axes(NamedTuple):
    variable: str
    time: str
    diameter: str
    velocity: str


def read_instrument_spectra(path: Path, dataset: xr.Dataset) -> DisdrometerReading:
    """Read the variable with the dimensions time, diameter and fall speed, in any order.

    The instrument (Parsivel or Thies) and so its measuring area follow from the classes. Raises `DisdrometerFileError`
    if there is no such variable, if its classes belong to no known instrument, or if no record is usable.
    """
    axes = _axes(path, dataset)
    spectrum = dataset[axes.variable].transpose(axes.time, axes.diameter, axes.velocity)
    return _instrument(path, dataset, axes).reading(path, usable_records(path, dataset, spectrum), "diameters first")


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
    """`time`, `diameter` or `velocity`, by the dimension's name, otherwise by the units of its variables."""
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
    """Values of a dimension's classes in the file; None without values in a known unit."""
    names = [dimension, *(str(name) for name in dataset.variables)]
    for name in names:
        if name in dataset.variables and dataset[name].dims == (dimension,):
            values = convert(dataset[name])
            if values is not None and not any(word in name.lower() for word in _NO_CLASSES):
                return values
    return None


def _agree(values: Float64[np.ndarray, " classes"] | None, edges: Float64[np.ndarray, " edges"]) -> bool:
    """Return whether values are centers, lower or upper bounds of these classes (ignoring the last), or are absent."""
    if values is None:
        return True
    lower, upper = edges[:-1], edges[1:]
    return any(
        np.allclose(values[:-1], known[:-1], rtol=_CLOSE, atol=0.01) for known in (0.5 * (lower + upper), lower, upper)
    )


# Recovery of truncated classic files: counts complete records and corrects the header

_DIMENSIONS, _VARIABLES = 10, 11
_TYPE_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8}
_STREAMING = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class RecordLayout:
    """Layout of a classic NetCDF file's records, which interleave all record variables."""

    written: int
    """Number of records in the header."""
    start: int
    """First byte of the first record."""
    size: int
    """Bytes of a record."""
    fixed_end: int
    """First byte after the non-record data."""


def with_whole_records(data: bytes) -> tuple[bytes, int, int]:
    """Return the file with a header that counts only complete records, their number, and the expected number.

    Complete files, and files truncated before their first record, are returned unchanged. Raises `ValueError` if the
    header can't be read. Source: the NetCDF classic format specification (Unidata).
    """
    layout = record_layout(data)
    if len(data) < max(layout.start, layout.fixed_end):
        return data, 0, layout.written
    whole = min(layout.written, (len(data) - layout.start) // layout.size) if layout.size else layout.written
    if whole == layout.written:
        return data, whole, whole
    return data[:4] + struct.pack(">I", whole) + data[8:], whole, layout.written


def record_layout(data: bytes) -> RecordLayout:
    """Read the header; raises `ValueError` if it is truncated or damaged."""
    try:
        return _NetcdfHeader(data).layout()
    except (struct.error, KeyError, IndexError, OverflowError):
        raise ValueError("its header is cut off or damaged") from None


class _NetcdfHeader:
    def __init__(self, data: bytes):
        self.data = data
        self.at = 4
        self.offset_format = ">Q" if data[3] == 2 else ">I"

    def layout(self) -> RecordLayout:
        written = self.number()
        lengths = [(self.skip_name(), self.number())[1] for _ in range(self.entries(_DIMENSIONS))]
        self.skip_attributes()
        start, end, size, fixed_end, recorded = 2**63, 0, 0, 0, 0
        sizes: list[int] = []
        for _ in range(self.entries(_VARIABLES)):
            self.skip_name()
            dimensions = [self.number() for _ in range(self.number())]
            self.skip_attributes()
            item = _TYPE_SIZES[self.number()]
            self.number()  # vsize is wrong for large variables, so it is computed from the dimensions
            begin = self.number(self.offset_format)
            per_record = bool(dimensions) and lengths[dimensions[0]] == 0
            for dimension in dimensions[1:] if per_record else dimensions:
                item *= lengths[dimension]
            if per_record:
                recorded += 1
                sizes.append(item)
                start = min(start, begin)
            else:
                fixed_end = max(fixed_end, begin + item)
        # A lone record variable is not padded to four bytes.
        size = sizes[0] if recorded == 1 else sum(-(-each // 4) * 4 for each in sizes)
        end = max(self.at, fixed_end)
        return RecordLayout(0 if written == _STREAMING else written, start if recorded else end, size, end)

    def number(self, layout: str = ">I") -> int:
        (value,) = struct.unpack_from(layout, self.data, self.at)
        self.at += struct.calcsize(layout)
        return value

    def entries(self, tag: int) -> int:
        """Length of a list with this tag; an absent list is stored as two zeros."""
        found, length = self.number(), self.number()
        if found not in (0, tag) or length > len(self.data):
            raise KeyError(tag)
        return length

    def skip_name(self) -> None:
        length = self.number()
        self.at += -(-length // 4) * 4

    def skip_attributes(self) -> None:
        for _ in range(self.entries(12)):
            self.skip_name()
            size = _TYPE_SIZES[self.number()] * self.number()
            self.at += -(-size // 4) * 4
