"""Fit a calibration to drop spectra: rows by intensity, fall speed, axis ratio, and how well the rates agree."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from ..calibration import Calibration, Interval, VelocityFit
from ..disdrometer.reading import SingleDrops
from ..disdrometer.spectra import DropSpectra
from ..drop_sizes import DropSizes
from ..rain_state import flux_mm_h
from .axis_ratio import fit_axis_ratio
from .bootstrap import FEWEST_MINUTES, interval, resampling_weights, rounded
from .fit_options import FitOptions
from .measured_file import check_rates
from .minutes import Minutes, sum_minutes
from .result import ClassSpeeds, FittedCalibration, FittedRow
from .rows import ENOUGH_DROPS, NO_RAIN, BinFit, fit_rows, fitted_classes
from .rows import FEWEST_DROPS as FEWEST_DROPS_A_ROW
from .velocity_fit import assumed_velocity, fit_velocity, fitted_speeds, speed_weights


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

    `trusted` are spectra without splashes and the like; `measured` the same as they came, by which the instrument's own
    rate is judged (default: the trusted ones). The size law is fitted to drops in a cubic metre, counts / (area x class
    velocity x time), by maximum likelihood (gamma_fit.py); rows stand at the mean rate of their minutes. Raises
    `ValueError` where the files' classes differ, or where there isn't enough rain for a fall speed and two rows.
    """
    options = options or FitOptions()
    measured = measured or trusted
    edges = DropSpectra.concatenate(list(trusted)).diameter_edges_mm  # also checks that they can be joined
    minutes = Minutes.concatenate([sum_minutes(each) for each in trusted])
    classes = fitted_classes(minutes, edges, options.smallest_mm)
    speeds = None if trusted[0].velocity_edges_m_s is None else _class_speeds(minutes, trusted[0].diameters_mm)
    middles = trusted[0].diameters_mm
    velocity = assumed_velocity() if speeds is None else fit_velocity(middles, speeds.mean_m_s, speeds.drops)
    bins, passed_over = fit_rows(minutes, edges, classes, options)
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
        rows=tuple(_with_rates(each, velocity) for each in bins),
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


def _with_rates(fit: BinFit, velocity: VelocityFit) -> FittedRow:
    moments = DropSizes(float(fit.moments.shape[0]), float(fit.moments.scale_mm[0]))
    return FittedRow(
        middle_mm_h=fit.middle_mm_h,
        row=fit.row,
        minutes=int(fit.picked.sum()),
        records=fit.records,
        drops=fit.drops,
        spectrum_m3_mm=fit.spectrum_m3_mm,
        moments_shape=moments.shape,
        moments_scale_mm=moments.scale_mm,
        implied_mm_h=flux_mm_h(fit.row.density_m3, DropSizes(fit.row.shape, fit.row.scale_mm), velocity),
        moments_implied_mm_h=flux_mm_h(fit.row.density_m3, moments, velocity),
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
    """Intervals of the coefficients, through the classes of the fit itself."""
    if not options.resamples or len(minutes) < FEWEST_MINUTES:
        return None
    counted = minutes.drops.sum(axis=0)
    fitted = fitted_speeds(diameters_mm, counted)
    drawn = resampling_weights(len(minutes), options.resamples, np.random.default_rng([options.seed, 1]))
    drops, speeds = drawn @ minutes.drops[:, fitted], drawn @ minutes.speed_sum[:, fitted]
    whole = minutes.speed_sum[:, fitted].sum(axis=0) / counted[fitted]
    means = np.where(drops > 0, speeds / np.maximum(drops, 1), whole)
    a, b, c = np.polyfit(diameters_mm[fitted], means.T, 2, w=speed_weights(counted[fitted]))
    return interval(a), interval(b), interval(c)


def _rounded(velocity: VelocityFit) -> VelocityFit:
    a, b, c = (rounded(value) for value in velocity.coefficients)
    return VelocityFit(coefficients=(a, b, c), r2=None if velocity.r2 is None else rounded(velocity.r2))
