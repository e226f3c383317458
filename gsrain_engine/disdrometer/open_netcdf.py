"""NetCDF files of any instrument, detected from their content."""

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import h5py
import xarray as xr

from ..safe_io.limits import max_expanded_bytes, reading_deadline
from .disdrodb import is_disdrodb, read_disdrodb
from .hdf5_trial import HDF5, NETCDF_CLASSIC, passes_trial
from .netcdf import is_gsrain_spectra, read_gsrain_spectra, read_instrument_spectra, with_whole_records
from .spectra import DisdrometerFileError, DisdrometerReading
from .two_dvd import (
    is_joss_waldvogel,
    is_two_dvd,
    is_two_dvd_minutes,
    read_joss_waldvogel,
    read_two_dvd,
    read_two_dvd_minutes,
)

_LARGEST_DATASET = 2 * 2**30  # bytes of all variables

_DATASETS = (
    (is_gsrain_spectra, read_gsrain_spectra),
    (is_two_dvd, read_two_dvd),
    (is_two_dvd_minutes, read_two_dvd_minutes),
    (is_disdrodb, read_disdrodb),
    (is_joss_waldvogel, read_joss_waldvogel),
)


def read_netcdf(path: Path, data: bytes) -> DisdrometerReading:
    """Read single drops (2DVD), drops by diameter (Joss-Waldvogel), or spectra of diameter and fall speed.

    A truncated classic file gives its complete records. Raises `DisdrometerFileError` if the file is damaged, larger
    than memory allows, or holds none of these.
    """
    lost = ""
    if data.startswith(NETCDF_CLASSIC):
        try:
            data, whole, expected = with_whole_records(data)
        except ValueError as error:
            raise _damaged(path, error) from None
        if whole < expected:
            lost = f"record {whole + 1}: the file ends in it, and {expected - whole - 1} more are missing"
            if whole == 0:
                raise DisdrometerFileError(path, f"no record can be used: {lost}")
    dataset = _opened(path, data)
    read = next((read for recognizes, read in _DATASETS if recognizes(dataset)), read_instrument_spectra)
    reading = read(path, dataset)
    return replace(reading, skipped=(*reading.skipped, lost)) if lost else reading


def _opened(path: Path, data: bytes) -> xr.Dataset:
    try:
        engine = "scipy"
        if data.startswith(HDF5):
            engine = "h5netcdf"
            if not passes_trial(data, _max_bytes(data), reading_deadline(len(data)).seconds):
                raise DisdrometerFileError(path, "the NetCDF file is damaged: HDF5's library does not come to its end")
            _check_size(path, _unpacked_bytes(data), data)
        with xr.open_dataset(BytesIO(data), engine=engine, decode_timedelta=False) as dataset:
            _check_size(path, dataset.nbytes, data)
            return dataset.load()
    except DisdrometerFileError:
        raise
    except Exception as error:  # the libraries raise nearly any exception on a damaged file
        raise _damaged(path, error) from None


def _unpacked_bytes(data: bytes) -> int:
    """Decompressed bytes of all variables of an HDF5 file, without decompressing any."""
    sizes: list[int] = []

    def note(_: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            sizes.append(item.nbytes)

    with h5py.File(BytesIO(data), "r") as file:
        file.visititems(note)
    return sum(sizes)


def _max_bytes(data: bytes) -> int:
    return min(_LARGEST_DATASET, max_expanded_bytes(len(data), is_uniform=True))


def _check_size(path: Path, size: int, data: bytes) -> None:
    if size > (largest := _max_bytes(data)):
        advice = ": split it by days" if largest == _LARGEST_DATASET else f", too many for {len(data)} bytes"
        raise DisdrometerFileError(path, f"it holds more than {largest // 2**20} MiB{advice}")


def _damaged(path: Path, error: Exception) -> DisdrometerFileError:
    reason = str(error).strip().split("\n")[0] or type(error).__name__
    return DisdrometerFileError(path, f"the NetCDF file is damaged or cut off ({reason})")
