"""From disdrometer files to a calibration with its provenance."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from gsrain_engine.untrusted.limits import open_file

from ..calibration import Provenance, SourceFile
from ..counted_drops import INSTRUMENT as VIRTUAL_INSTRUMENT
from ..disdrometer.files import Reading, SingleDrops, read_disdrometer
from ..disdrometer.quality import QualityReport, keep_trusted
from ..disdrometer.spectra import DropSpectra
from .calibrate import fit_calibration
from .fit_options import FitOptions
from .result import FittedCalibration


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MeasuredFile:
    """A disdrometer file: as it is, and what can be trusted in it."""

    path: Path
    reading: Reading
    trusted: DropSpectra
    quality: QualityReport


def open_measured(path: Path) -> MeasuredFile:
    """Read a file and mask what can't be trusted; of simulated drops, all can. Raises `DisdrometerFileError`."""
    reading = read_disdrometer(path)
    if reading.spectra.instrument == VIRTUAL_INSTRUMENT:
        trusted, quality = keep_trusted(reading.spectra, smallest_mm=0, speed_tolerance=np.inf, fewest_drops=0)
    else:
        trusted, quality = keep_trusted(reading.spectra)
    return MeasuredFile(path=path, reading=reading, trusted=trusted, quality=quality)


def calibrate(paths: Sequence[Path | str], *, name: str, options: FitOptions | None = None) -> FittedCalibration:
    """Read files of one instrument and fit a calibration; raises as `open_measured` and `calibrate_files` do."""
    return calibrate_files([open_measured(Path(path)) for path in paths], name=name, options=options)


def calibrate_files(
    files: Sequence[MeasuredFile], *, name: str, options: FitOptions | None = None
) -> FittedCalibration:
    """Fit to all files together, and note where the numbers come from.

    Raises `ValueError` where the files are of different instruments, or where there isn't enough rain in them.
    """
    options = options or FitOptions()
    instruments = list(dict.fromkeys(each.trusted.instrument for each in files))
    if len(instruments) > 1:
        raise ValueError(f"files of {' and '.join(instruments)}: calibrate each instrument by itself")
    names = ", ".join(each.path.name for each in files)
    fitted = fit_calibration(
        [each.trusted for each in files],
        name=name,
        source=f"fitted by GSRAIN to {names} ({instruments[0]})",
        measured=[each.reading.spectra for each in files],
        drops=_all_drops(files),
        options=options,
    )
    calibration = msgspec.structs.replace(fitted.calibration, provenance=_provenance(files, fitted, options))
    return replace(fitted, calibration=calibration)


def _all_drops(files: Sequence[MeasuredFile]) -> SingleDrops | None:
    seen = [each.reading.drops for each in files if each.reading.drops is not None]
    if not seen:
        return None
    fields = ("diameters_mm", "speeds_m_s", "axis_ratios", "times")
    return SingleDrops(**{field: np.concatenate([getattr(drops, field) for drops in seen]) for field in fields})


def _provenance(files: Sequence[MeasuredFile], fitted: FittedCalibration, options: FitOptions) -> Provenance:
    times = np.concatenate([each.reading.spectra.times for each in files])
    times = times[~np.isnat(times)]
    low, high = fitted.fitted_range_mm
    return Provenance(
        files=tuple(SourceFile(name=each.path.name, sha256=_sha256(each.path)) for each in files),
        instrument=files[0].trusted.instrument,
        first=str(times.min().astype("datetime64[s]")) if times.size else None,
        last=str(times.max().astype("datetime64[s]")) if times.size else None,
        records=fitted.records,
        records_used=fitted.records_used,
        method=(
            f"minutes within {100 * options.half_width:g} % of each intensity; maximum likelihood on counts / "
            f"(area x class velocity) from {low:g} to {high:g} mm; "
            f"95 % intervals of {options.resamples} bootstraps over minutes"
        ),
    )


def _sha256(path: Path) -> str:
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
