"""From disdrometer files to a calibration with its provenance."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import platformdirs

from gsrain_engine.untrusted.limits import open_file
from gsrain_engine.untrusted.printable import printable

from ..calibration import Provenance, SourceFile, save_calibration
from ..disdrometer.reading import SingleDrops
from ..disdrometer.tables import TableColumns
from ..rain import Rain
from .calibrate import fit_calibration
from .fit_options import FitOptions
from .measured_file import MeasuredFile, check_rates, open_measured
from .result import FittedCalibration

WET_MINUTE_MM_H = 0.1
"""Below this a minute counts as dry: the resolution of most rain gauges."""


class RatesDisagreeError(ValueError):
    """Drops that don't give the instrument's own rain rate: in one sentence, which file's and by how much."""


def calibrate(
    paths: Sequence[Path | str],
    *,
    name: str,
    options: FitOptions | None = None,
    columns: TableColumns | None = None,
    force: bool = False,
) -> FittedCalibration:
    """Read files of one instrument and fit a calibration; raises as `open_measured` and `calibrate_files` do."""
    files = [open_measured(Path(path), columns) for path in paths]
    return calibrate_files(files, name=name, options=options, force=force)


def calibrate_files(
    files: Sequence[MeasuredFile], *, name: str, options: FitOptions | None = None, force: bool = False
) -> FittedCalibration:
    """Fit to all files together, and note where the numbers come from.

    Raises `RatesDisagreeError` where the drops don't give the instrument's own rate, in a file or in all together
    (`RateCheck.problem`), unless it is to be done by `force`; `ValueError` where the files are of different
    instruments, or where there isn't enough rain in them.
    """
    options = options or FitOptions()
    instruments = list(dict.fromkeys(each.trusted.instrument for each in files))
    if len(instruments) > 1:
        raise ValueError(f"files of {printable(' and '.join(instruments))}: calibrate each instrument by itself")
    disagreement = rates_problem(files)
    if disagreement is not None and not force:
        raise RatesDisagreeError(f"{disagreement}. Is it rain, and are these its classes?")
    names = ", ".join(printable(each.path.name) for each in files)
    try:
        fitted = fit_calibration(
            [each.trusted for each in files],
            name=name,
            source=f"fitted by GSRAIN to {names} ({instruments[0]})" + (f"; {disagreement}" if disagreement else ""),
            measured=[each.reading.spectra for each in files],
            drops=_all_drops(files),
            options=options,
        )
    except ValueError as error:
        raise ValueError(f"{names if len(files) == 1 else f'{len(files)} files together'}: {error}") from None
    calibration = msgspec.structs.replace(fitted.calibration, provenance=_provenance(files, fitted, options))
    return replace(fitted, calibration=calibration)


def rain_as_measured(
    paths: Sequence[Path | str], intensity_mm_h: float | None = None, *, save_to: Path | str | None = None
) -> Rain:
    """Fit a calibration to files of one instrument, save it, and return rain that falls by it.

    Args:
        paths: Disdrometer files.
        intensity_mm_h: Intensity of the rain; None takes the mean of the minutes with at least `WET_MINUTE_MM_H`.
        save_to: YAML file of the calibration; None keeps it in the user's cache folder, under the files' hash.

    Raises:
        ValueError: As `calibrate` does, and where no minute has rain that could give the intensity.
    """
    files = [Path(each) for each in paths]
    fitted = calibrate(files, name=files[0].stem if files else "")
    if save_to is None:
        digest = hashlib.sha256("".join(map(_sha256, files)).encode()).hexdigest()[:16]
        save_to = Path(platformdirs.user_cache_dir("gsrain", appauthor=False)) / "calibrations" / f"{digest}.yaml"
    save_to = Path(save_to)
    save_to.parent.mkdir(parents=True, exist_ok=True)
    save_calibration(fitted.calibration, save_to)
    if intensity_mm_h is None:
        wet = fitted.minute_rate_mm_h[fitted.minute_rate_mm_h >= WET_MINUTE_MM_H]
        if not len(wet):
            raise ValueError(f"{files[0]}: no minute has {WET_MINUTE_MM_H:g} mm/h or more; give an intensity")
        intensity_mm_h = float(wet.mean())
    return Rain(intensity_mm_h=intensity_mm_h, calibration=str(save_to))


def rates_problem(files: Sequence[MeasuredFile]) -> str | None:
    """Name the first file whose drops don't give its own rate, and by how much; None where all do."""
    for each in files:
        check = check_rates([each.reading.spectra])
        if check is not None and check.problem is not None:
            used = check_rates([each.trusted])
            left = f"; of the drops that would be used: {used.figures}" if used is not None else ""
            return f"{printable(each.path.name)}: {check.problem}{left}"
    together = check_rates([each.reading.spectra for each in files])
    problem = None if together is None else together.problem
    return None if problem is None else f"{len(files)} files together: {problem}"


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
