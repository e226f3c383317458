"""Calibrations fitted to drop spectra and to disdrometer files, with provenance."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import platformdirs
from jaxtyping import Float64

from ..rain.calibration import Calibration, Interval, Provenance, SourceFile, VelocityFit, save_calibration
from ..rain.settings import RainSettings
from ..safe_io.limits import file_sha256
from ..safe_io.text_files import printable_line
from .file_summary import MeasuredFile, check_rates, open_disdrometer_files
from .fit_models import (
    ENOUGH_DROPS,
    FEWEST_MINUTES,
    NO_RAIN,
    ClassSpeeds,
    FitOptions,
    FittedCalibration,
    Minutes,
    assumed_velocity,
    fit_axis_ratio,
    fit_rows,
    fit_velocity,
    fitted_classes,
    fitted_speeds,
    percentile_interval,
    resampling_weights,
    round_significant,
    speed_weights,
    sum_minutes,
)
from .fit_models import MIN_BIN_DROPS as FEWEST_DROPS_A_ROW
from .spectra import DropSpectra, SingleDrops, joined_series
from .tables import TableColumns


def fit_calibration(
    trusted: Sequence[DropSpectra],
    *,
    name: str,
    source: str,
    measured: Sequence[DropSpectra] | None = None,
    drops: SingleDrops | None = None,
    options: FitOptions | None = None,
) -> FittedCalibration:
    """Fit to the spectra of one or more files of one instrument.

    `trusted` are spectra after quality control; `measured` the same before it, for the check against the instrument's
    own rate (default: `trusted`). The size law is fitted to drops per cubic meter, counts / (area x class velocity x
    time), by maximum likelihood (`fit_by_likelihood`); each row lies at the mean rate of its minutes. Raises
    `ValueError` if the files' classes differ, or if there isn't enough rain for a fall speed and two rows.
    """
    options = options or FitOptions()
    measured = measured or trusted
    edges = DropSpectra.concatenate(list(trusted)).diameter_edges_mm  # also checks that they can be joined
    minutes = Minutes.concatenate([sum_minutes(each) for each in joined_series(trusted) or trusted])
    classes = fitted_classes(minutes, edges, options.smallest_mm)
    speeds = None if trusted[0].velocity_edges_m_s is None else _class_speeds(minutes, trusted[0].diameters_mm)
    middles = trusted[0].diameters_mm
    velocity = assumed_velocity() if speeds is None else fit_velocity(middles, speeds.mean_m_s, speeds.drops)
    bins, passed_over = fit_rows(minutes, edges, classes, velocity, options)
    if len(bins) < 2:
        seen = [reason for reason in passed_over if NO_RAIN not in reason]
        raise ValueError(
            f"a calibration needs two intensities with {ENOUGH_DROPS} drops, or {FEWEST_DROPS_A_ROW} in "
            f"{FEWEST_MINUTES} minutes: of {len(options.intensities_mm_h)} bins {len(bins)} have them"
            + (f" ({'; '.join(seen)})" if seen else "")
        )
    return FittedCalibration(
        calibration=Calibration(
            name=name, source=source, rows=tuple(each.row for each in bins), velocity=_rounded(velocity)
        ),
        rows=tuple(bins),
        passed_over=tuple(passed_over),
        diameter_edges_mm=edges,
        fitted_range_mm=(float(edges[classes.start]), float(edges[classes.stop])),
        speeds=speeds,
        velocity_confidence=None if speeds is None else _velocity_confidence(minutes, middles, options),
        axis_ratios=None if drops is None else fit_axis_ratio(drops),
        rate_check=check_rates(measured),
        records=sum(len(each) for each in measured),
        records_used=int(minutes.records[np.any([each.picked for each in bins], axis=0)].sum()),
        minute_rate_mm_h=minutes.rate_mm_h,
        minute_reported_mm_h=minutes.reported_mm_h,
    )


def _class_speeds(minutes: Minutes, diameters_mm: Float64[np.ndarray, " diameters"]) -> ClassSpeeds:
    drops = minutes.drops.sum(axis=0)
    with np.errstate(invalid="ignore"):
        mean = minutes.speed_sum.sum(axis=0) / drops
        square = minutes.squared_speed_sum.sum(axis=0) / drops
    return ClassSpeeds(
        drops=drops,
        mean_m_s=mean,
        deviation_m_s=np.sqrt(np.maximum(square - mean**2, 0)),
        fitted=fitted_speeds(diameters_mm, drops),
    )


def _velocity_confidence(
    minutes: Minutes, diameters_mm: Float64[np.ndarray, " diameters"], options: FitOptions
) -> tuple[Interval, Interval, Interval] | None:
    """95 % intervals of the coefficients, fitted to the same classes as the velocity itself."""
    if not options.resamples or len(minutes) < FEWEST_MINUTES:
        return None
    counted = minutes.drops.sum(axis=0)
    fitted = fitted_speeds(diameters_mm, counted)
    drawn = resampling_weights(len(minutes), options.resamples, np.random.default_rng([options.seed, 1]))
    drops, speeds = drawn @ minutes.drops[:, fitted], drawn @ minutes.speed_sum[:, fitted]
    whole = minutes.speed_sum[:, fitted].sum(axis=0) / counted[fitted]
    means = np.where(drops > 0, speeds / np.maximum(drops, 1), whole)
    a, b, c = np.polyfit(diameters_mm[fitted], means.T, 2, w=speed_weights(counted[fitted]))
    return percentile_interval(a), percentile_interval(b), percentile_interval(c)


def _rounded(velocity: VelocityFit) -> VelocityFit:
    a, b, c = (round_significant(value) for value in velocity.coefficients)
    return VelocityFit(coefficients=(a, b, c), r2=None if velocity.r2 is None else round_significant(velocity.r2))


# Calibration from files

WET_MINUTE_MM_H = 0.1
"""Minutes with less count as dry: the resolution of most rain gauges."""


_MAX_NAMES = 8  # listed in a calibration's source; its provenance lists all files


class RatesDisagreeError(ValueError):
    """Drops contradict the instrument's own rain rate; the message names the file and the ratio."""


def calibrate(
    paths: Sequence[Path | str],
    *,
    name: str,
    options: FitOptions | None = None,
    columns: TableColumns | None = None,
    force: bool = False,
) -> FittedCalibration:
    """Read files of one instrument and fit a calibration; raises as `open_disdrometer_file` does."""
    files = open_disdrometer_files([Path(path) for path in paths], columns)
    return calibrate_files(files, name=name, options=options, force=force)


def calibrate_files(
    files: Sequence[MeasuredFile], *, name: str, options: FitOptions | None = None, force: bool = False
) -> FittedCalibration:
    """Fit to all files together and record the provenance.

    Raises `RatesDisagreeError` if the drops contradict the instrument's own rate, in one file or in all together
    (`RateCheck.problem`), unless `force` is set; `ValueError` for different instruments, or without enough rain.
    """
    options = options or FitOptions()
    instruments = list(dict.fromkeys(each.trusted.instrument for each in files))
    if len(instruments) > 1:
        raise ValueError(f"files of {printable_line(' and '.join(instruments))}: calibrate each instrument by itself")
    disagreement = rates_problem(files)
    if disagreement is not None and not force:
        raise RatesDisagreeError(f"{disagreement}. Is it rain, and are these its classes?")
    each_name = [printable_line(each.path.name) for each in files]
    many = f"{len(files)} files, {each_name[0]} to {each_name[-1]}" if files else "no file"
    names = ", ".join(each_name) if 0 < len(files) <= _MAX_NAMES else many
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
) -> RainSettings:
    """Fit a calibration to files of one instrument, save it, and return rain settings that use it.

    Args:
        paths: Disdrometer files.
        intensity_mm_h: Intensity of the rain; None takes the mean of the minutes with at least `WET_MINUTE_MM_H`.
        save_to: YAML file of the calibration; None saves it in the user's cache folder, named by the files' hash.

    Raises:
        ValueError: As `calibrate` does, and if no minute has rain from which to take the intensity.
    """
    files = [Path(each) for each in paths]
    fitted = calibrate(files, name=files[0].stem if files else "")
    if save_to is None:
        digest = hashlib.sha256("".join(map(file_sha256, files)).encode()).hexdigest()[:16]
        save_to = Path(platformdirs.user_cache_dir("gsrain", appauthor=False)) / "calibrations" / f"{digest}.yaml"
    save_to = Path(save_to)
    save_to.parent.mkdir(parents=True, exist_ok=True)
    save_calibration(fitted.calibration, save_to)
    if intensity_mm_h is None:
        wet = fitted.minute_rate_mm_h[fitted.minute_rate_mm_h >= WET_MINUTE_MM_H]
        if not len(wet):
            raise ValueError(f"{files[0]}: no minute has {WET_MINUTE_MM_H:g} mm/h or more; give an intensity")
        intensity_mm_h = float(wet.mean())
    return RainSettings(intensity_mm_h=intensity_mm_h, calibration=str(save_to))


def rates_problem(files: Sequence[MeasuredFile]) -> str | None:
    """Return a sentence on the first file whose drops contradict its own rate; None if all agree."""
    for each in files:
        check = check_rates([each.reading.spectra])
        if check is not None and check.problem is not None:
            used = check_rates([each.trusted])
            left = f"; of the drops that would be used: {used.figures}" if used is not None else ""
            return f"{printable_line(each.path.name)}: {check.problem}{left}"
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
        files=tuple(SourceFile(name=each.path.name, sha256=file_sha256(each.path)) for each in files),
        instrument=files[0].trusted.instrument,
        first=str(times.min().astype("datetime64[s]")) if times.size else None,
        last=str(times.max().astype("datetime64[s]")) if times.size else None,
        records=fitted.records,
        records_used=fitted.records_used,
        highest_minute_mm_h=round(float(fitted.minute_rate_mm_h.max()), 1),
        method=(
            f"minutes within {100 * options.half_width:g} % of each intensity; maximum likelihood on counts / "
            f"(area x class velocity) from {low:g} to {high:g} mm; "
            f"95 % intervals of {options.resamples} bootstraps over minutes"
        ),
    )
