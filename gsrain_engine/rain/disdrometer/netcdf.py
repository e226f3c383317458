"""NetCDF files of disdrometers, classic or HDF5: opened from memory, and handed to the instrument's own reader."""

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import h5py
import xarray as xr

from gsrain_engine.rain.disdrometer.disdrodb import is_disdrodb, read_disdrodb
from gsrain_engine.rain.disdrometer.hdf5_trial import LARGEST_DATASET, passes_trial
from gsrain_engine.rain.disdrometer.instrument_spectra import read_instrument_spectra
from gsrain_engine.rain.disdrometer.joss_waldvogel import is_joss_waldvogel, read_joss_waldvogel
from gsrain_engine.rain.disdrometer.netcdf_classic import with_whole_records
from gsrain_engine.rain.disdrometer.netcdf_spectra import is_gsrain_spectra, read_gsrain_spectra
from gsrain_engine.rain.disdrometer.reading import DisdrometerFileError, Reading
from gsrain_engine.rain.disdrometer.two_dvd import is_two_dvd, is_two_dvd_minutes, read_two_dvd, read_two_dvd_minutes

_CLASSIC = (b"CDF\x01", b"CDF\x02")
_HDF5 = b"\x89HDF\r\n\x1a\n"


def is_netcdf(data: bytes) -> bool:
    """Whether a file begins as NetCDF, classic or HDF5."""
    return data.startswith((*_CLASSIC, _HDF5))


def read_netcdf(path: Path, data: bytes) -> Reading:
    """Read single drops (2DVD), drops by diameter (Joss-Waldvogel), or spectra of diameter and fall speed.

    A classic file that ends too early gives its whole records. Raises `DisdrometerFileError` where the file is damaged,
    larger than memory allows, or holds none of these.
    """
    lost = ""
    if data.startswith(_CLASSIC):
        try:
            data, whole, expected = with_whole_records(data)
        except ValueError as error:
            raise _damaged(path, error) from None
        if whole < expected:
            lost = f"record {whole + 1}: the file ends in it, and {expected - whole - 1} more are missing"
            if whole == 0:
                raise DisdrometerFileError(path, f"no record can be used: {lost}")
    reading = _read(path, _opened(path, data))
    return replace(reading, skipped=(*reading.skipped, lost)) if lost else reading


def _read(path: Path, dataset: xr.Dataset) -> Reading:
    if is_gsrain_spectra(dataset):
        return read_gsrain_spectra(path, dataset)
    if is_two_dvd(dataset):
        return read_two_dvd(path, dataset)
    if is_two_dvd_minutes(dataset):
        return read_two_dvd_minutes(path, dataset)
    if is_disdrodb(dataset):
        return read_disdrodb(path, dataset)
    if is_joss_waldvogel(dataset):
        return read_joss_waldvogel(path, dataset)
    return read_instrument_spectra(path, dataset)


def _opened(path: Path, data: bytes) -> xr.Dataset:
    try:
        engine = "scipy"
        if data.startswith(_HDF5):
            engine = "h5netcdf"
            if not passes_trial(data):
                raise DisdrometerFileError(path, "the NetCDF file is damaged: HDF5's library does not come to its end")
            _check_size(path, _unpacked_bytes(data))
        with xr.open_dataset(BytesIO(data), engine=engine, decode_timedelta=False) as dataset:
            _check_size(path, dataset.nbytes)
            return dataset.load()
    except DisdrometerFileError:
        raise
    except Exception as error:  # the libraries raise nearly anything on a damaged file
        raise _damaged(path, error) from None


def _unpacked_bytes(data: bytes) -> int:
    """Bytes of all variables of an HDF5 file, before one of them is unpacked."""
    sizes: list[int] = []

    def note(_: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            sizes.append(item.nbytes)

    with h5py.File(BytesIO(data), "r") as file:
        file.visititems(note)
    return sum(sizes)


def _check_size(path: Path, size: int) -> None:
    if size > LARGEST_DATASET:
        raise DisdrometerFileError(path, f"it holds more than {LARGEST_DATASET // 2**20} MiB: split it by days")


def _damaged(path: Path, error: Exception) -> DisdrometerFileError:
    reason = str(error).strip().split("\n")[0] or type(error).__name__
    return DisdrometerFileError(path, f"the NetCDF file is damaged or cut off ({reason})")
