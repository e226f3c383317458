"""Models fitted to drop spectra: gamma size law, fall speed, axis ratio, bootstrap, and calibration rows."""

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy import special

from ..rain.calibration import (
    Calibration,
    CalibrationRow,
    Interval,
    RowConfidence,
    VelocityFit,
    atlas_velocity,
)
from ..rain.properties import DropSizes, flux_mm_h
from ..rain.settings import LARGEST_MM, SMALLEST_MM
from .file_summary import RateCheck
from .fit_settings import FitOptions
from .spectra import DropSpectra, SingleDrops

SHAPES = (0.2, 200.0)
SCALES_MM = (1e-3, 10.0)
"""Limits of the fitted gamma laws: beyond them a histogram is not rain."""

_LOW, _HIGH = np.log(np.array([SHAPES, SCALES_MM]).T)
_STEP = 1e-4  # of the numerical derivative, in ln shape and ln scale
_LONGEST = 0.5
_ARRIVED = 1e-7
_ROUNDS, _HALVINGS = 100, 12
_TINY = 1e-300


class GammaLaws(NamedTuple):
    """Gamma law (paper, eq. 8) of each histogram."""

    shape: Float64[np.ndarray, " fits"]
    scale_mm: Float64[np.ndarray, " fits"]


def class_shares(
    laws: GammaLaws, edges_mm: Float64[np.ndarray, " classes_and_one"]
) -> Float64[np.ndarray, "fits classes"]:
    """Share of the untruncated law's drops in each class, from the upper tail above the mean for precision."""
    shape, scale = laws.shape[:, None], laws.scale_mm[:, None]
    x = edges_mm / scale
    below, above = np.diff(special.gammainc(shape, x)), -np.diff(special.gammaincc(shape, x))
    return np.where(x[:, :-1] > shape, above, below)


def fit_by_likelihood(
    density: Float64[np.ndarray, "fits classes"], edges_mm: Float64[np.ndarray, " classes_and_one"]
) -> GammaLaws:
    """Maximize sum_i n_i ln p_i, with p_i the share of class i among these classes: binned, truncated likelihood.

    `density` is the number of drops in the air by diameter class, in any unit. Uses Fisher scoring in ln shape and ln
    scale, all fits at once, with steps halved until the likelihood rises. Raises `ValueError` for a histogram with
    fewer than three occupied classes, which can't determine two parameters.
    """
    if np.any((density > 0).sum(axis=1) < 3):
        raise ValueError("a gamma law needs drops in at least three diameter classes")
    observed = density / density.sum(axis=1, keepdims=True)
    moments = fit_by_moments(density, edges_mm)
    shape = np.clip(moments.shape, *SHAPES)
    at = np.clip(np.log(np.stack([shape, moments.shape * moments.scale_mm / shape], axis=1)), _LOW, _HIGH)
    climbing = np.arange(len(at))
    for _ in range(_ROUNDS):
        ahead = _climb(at[climbing], observed[climbing], edges_mm)
        moved = np.abs(ahead - at[climbing]).max(axis=1) > _ARRIVED
        at[climbing] = ahead
        climbing = climbing[moved]
        if not climbing.size:
            break
    shape, scale = np.exp(at).T
    return GammaLaws(shape, scale)


def fit_sizes(density: Float64[np.ndarray, " classes"], edges_mm: Float64[np.ndarray, " classes_and_one"]) -> DropSizes:
    """Fit the gamma law of one histogram of drops in the air, in any unit, by `fit_by_likelihood`.

    Raises `ValueError` for a histogram with fewer than three occupied classes.
    """
    law = fit_by_likelihood(density[None], edges_mm)
    return DropSizes(float(law.shape[0]), float(law.scale_mm[0]))


def fit_by_moments(
    density: Float64[np.ndarray, "fits classes"], edges_mm: Float64[np.ndarray, " classes_and_one"]
) -> GammaLaws:
    """Shape and scale from mean and variance of the diameters, without a correction for truncation.

    Sheppard's correction subtracts w^2/12 for the class width w, the variance that binning adds.
    """
    share = density / density.sum(axis=1, keepdims=True)
    middle, width = 0.5 * (edges_mm[:-1] + edges_mm[1:]), np.diff(edges_mm)
    mean = share @ middle
    variance = (share * ((middle - mean[:, None]) ** 2 - width**2 / 12)).sum(axis=1)
    variance = np.maximum(variance, 1e-3 * mean**2)
    return GammaLaws(mean**2 / variance, variance / mean)


def _climb(
    at: Float64[np.ndarray, "fits 2"],
    observed: Float64[np.ndarray, "fits classes"],
    edges_mm: Float64[np.ndarray, " classes_and_one"],
) -> Float64[np.ndarray, "fits 2"]:
    """Advance each fit by one step uphill; a fit stays if even a small step leads down."""
    step = _scoring_step(at, observed, edges_mm)
    step /= np.maximum(np.abs(step).max(axis=1, keepdims=True) / _LONGEST, 1)  # one factor for both keeps the direction
    likelihood = (observed * _log_shares(at, edges_mm)).sum(axis=1)
    reached, searching = at.copy(), np.arange(len(at))
    for _ in range(_HALVINGS):
        ahead = np.clip(at[searching] + step[searching], _LOW, _HIGH)
        better = (observed[searching] * _log_shares(ahead, edges_mm)).sum(axis=1) > likelihood[searching]
        reached[searching[better]] = ahead[better]
        searching = searching[~better]
        if not searching.size:
            break
        step[searching] *= 0.5
    return reached


def _log_shares(
    at: Float64[np.ndarray, "fits 2"], edges_mm: Float64[np.ndarray, " classes_and_one"]
) -> Float64[np.ndarray, "fits classes"]:
    shares = np.maximum(class_shares(GammaLaws(*np.exp(at).T), edges_mm), _TINY)
    return np.log(shares) - np.log(shares.sum(axis=1, keepdims=True))


def _scoring_step(
    at: Float64[np.ndarray, "fits 2"],
    observed: Float64[np.ndarray, "fits classes"],
    edges_mm: Float64[np.ndarray, " classes_and_one"],
) -> Float64[np.ndarray, "fits 2"]:
    slopes = np.stack(
        [(_log_shares(at + h, edges_mm) - _log_shares(at - h, edges_mm)) / (2 * _STEP) for h in _STEP * np.eye(2)],
        axis=2,
    )
    score = np.einsum("fc,fcp->fp", observed, slopes)
    information = np.einsum("fc,fcp,fcq->fpq", np.exp(_log_shares(at, edges_mm)), slopes, slopes)
    step = np.linalg.solve(information + 1e-9 * np.eye(2), score[:, :, None])[:, :, 0]
    for bound, free in ((0, 1), (1, 0)):  # a parameter at its limit is fixed and the other one optimized alone
        stuck = ((at[:, bound] <= _LOW[bound]) & (step[:, bound] < 0)) | (
            (at[:, bound] >= _HIGH[bound]) & (step[:, bound] > 0)
        )
        alone = score[:, free] / (information[:, free, free] + 1e-9)
        step[:, free] = np.where(stuck, alone, step[:, free])
        step[:, bound] = np.where(stuck, 0, step[:, bound])
    return step


# Fall speed over diameter (paper, eq. 9)

MIN_SPEED_DROPS = 10
"""Minimum number of drops for a class's mean speed."""

_DROPS_M_S = 0.8  # standard deviation of single drops within a class, as measured by a Parsivel and a 2DVD
_QUADRATIC_M_S = 0.2  # misfit of a quadratic to real fall speeds; it bounds the weight of classes with many drops


def fitted_speeds(
    diameters_mm: Float64[np.ndarray, " classes"], drops: Float64[np.ndarray, " classes"]
) -> Bool[np.ndarray, " classes"]:
    """Classes used by the quadratic: at least `MIN_SPEED_DROPS` drops and diameters that occur in rain."""
    return (drops >= MIN_SPEED_DROPS) & (diameters_mm < LARGEST_MM)


def speed_weights(drops: Float64[np.ndarray, " classes"]) -> Float64[np.ndarray, " classes"]:
    """Inverse standard error of each class's mean, in s/m, for `numpy.polyfit`."""
    return 1 / np.sqrt(_DROPS_M_S**2 / drops + _QUADRATIC_M_S**2)


def fit_velocity(
    diameters_mm: Float64[np.ndarray, " classes"],
    mean_speeds_m_s: Float64[np.ndarray, " classes"],
    drops: Float64[np.ndarray, " classes"],
) -> VelocityFit:
    """Weighted least squares through the classes' means; R^2 with the same weights.

    Weights by the number of drops alone would favor small drops. Raises `ValueError` with fewer than four classes.
    """
    used = fitted_speeds(diameters_mm, drops)
    if used.sum() < 4:
        raise ValueError(
            f"fall speed: {used.sum()} diameter classes with at least {MIN_SPEED_DROPS} drops, expected four or more"
        )
    d, v, w = diameters_mm[used], mean_speeds_m_s[used], speed_weights(drops[used])
    coefficients = np.polyfit(d, v, 2, w=w)
    unexplained = np.sum((w * (v - np.polyval(coefficients, d))) ** 2)
    spread = np.sum((w * (v - np.average(v, weights=w**2))) ** 2)
    a, b, c = (float(value) for value in coefficients)
    return VelocityFit(coefficients=(a, b, c), r2=float(1 - unexplained / spread))


def assumed_velocity() -> VelocityFit:
    """Quadratic through Atlas et al. (1973) from 0.3 to 5 mm, for instruments that measure no speed."""
    d = np.linspace(0.3, 5.0, 48)
    a, b, c = (float(value) for value in np.polyfit(d, atlas_velocity(d), 2))
    return VelocityFit(coefficients=(a, b, c))


# Axis ratio (height over width) over diameter (paper, eq. 4)

_WIDTH_MM = 0.25
_SMALLEST_MM = 1.0  # lower limit of eq. 4; smaller drops are spheres.
_FEWEST_DROPS = 20
_SPEED_BAND = 0.6
"""Drops beyond this relative deviation from Atlas et al. (1973) are splashes or mismatched shadow pairs."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AxisRatios:
    """Median axis ratio by diameter, and a line through it from 1 mm on: ratio = offset + slope D."""

    diameters_mm: Float64[np.ndarray, " classes"]
    medians: Float64[np.ndarray, " classes"]
    quartiles: Float64[np.ndarray, "2 classes"]
    drops: int
    offset: float
    slope_per_mm: float
    r2: float


def fit_axis_ratio(drops: SingleDrops) -> AxisRatios | None:
    """Fit a line through the class medians, weighted by drops.

    Uses classes of at least 20 drops; returns None with fewer than three of them.
    """
    speed = atlas_velocity(drops.diameters_mm)
    fair = np.isfinite(drops.axis_ratios) & (np.abs(drops.speeds_m_s - speed) <= _SPEED_BAND * speed)
    diameter, ratio = drops.diameters_mm[fair], drops.axis_ratios[fair]
    number = np.floor(diameter / _WIDTH_MM).astype(int)
    classes = [c for c in np.unique(number) if np.count_nonzero(number == c) >= _FEWEST_DROPS]
    middles = (np.array(classes, dtype=np.float64) + 0.5) * _WIDTH_MM
    members = [ratio[number == c] for c in classes]
    large = middles > _SMALLEST_MM
    if large.sum() < 3:
        return None
    medians = np.array([np.median(each) for each in members])
    weights = np.array([float(len(each)) for each in members])[large]
    d, r = middles[large], medians[large]
    slope, offset = (float(value) for value in np.polyfit(d, r, 1, w=np.sqrt(weights)))
    spread = np.sum(weights * (r - np.average(r, weights=weights)) ** 2)
    return AxisRatios(
        diameters_mm=middles,
        medians=medians,
        quartiles=np.array([np.quantile(each, [0.25, 0.75]) for each in members]).T,
        drops=sum(len(each) for each in members),
        offset=offset,
        slope_per_mm=slope,
        r2=float(1 - np.sum(weights * (r - offset - slope * d) ** 2) / spread),
    )


# Bootstrap over minutes

FEWEST_MINUTES = 5
"""Fewer minutes give no estimate of their variation."""

_TAILS = (0.025, 0.975)


def resampling_weights(minutes: int, resamples: int, generator: np.random.Generator) -> Float64[np.ndarray, "r m"]:
    """Number of draws of each minute in each resample of the same size, with replacement (Efron, 1979)."""
    return generator.multinomial(minutes, np.full(minutes, 1 / minutes), size=resamples).astype(np.float64)


def percentile_interval(values: Float64[np.ndarray, " resamples"]) -> Interval:
    """Central 95 % interval, rounded to four digits."""
    low, high = np.quantile(values, _TAILS)
    return round_significant(low), round_significant(high)


def round_significant(value: float) -> float:
    """Round to four digits, more than the accuracy of any fitted number."""
    return float(f"{value:.4g}")


# Minutes

MINUTE_MS = 60_000


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Minutes:
    """Sums over the records of each minute. A record of unknown time is a minute of its own."""

    seconds: Float64[np.ndarray, " minutes"]
    records: Float64[np.ndarray, " minutes"]
    rate_mm_h: Float64[np.ndarray, " minutes"]
    """Rain rate from the drops."""
    reported_mm_h: Float64[np.ndarray, " minutes"]
    """The instrument's own rain rate; NaN if it reports none."""
    drops: Float64[np.ndarray, "minutes diameters"]
    density_seconds: Float64[np.ndarray, "minutes diameters"]
    """Drops per cubic meter of air, times seconds: a drop counts 1 / (area x its speed)."""
    speed_sum: Float64[np.ndarray, "minutes diameters"]
    """Sum of the counted drops' speeds, m/s."""
    squared_speed_sum: Float64[np.ndarray, "minutes diameters"]

    def __len__(self) -> int:
        return len(self.seconds)

    @staticmethod
    def concatenate(parts: "list[Minutes]") -> "Minutes":
        names = [field.name for field in fields(Minutes)]
        return Minutes(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def sum_minutes(spectra: DropSpectra) -> Minutes:
    """Sum records by the UTC minute of their midpoint.

    Speeds are class centers; without measured speeds, Atlas et al. (1973) at the center of the diameter class.
    """
    minute, count = _minute_of_record(spectra)

    def summed(values: Float64[np.ndarray, " records *rest"]) -> Float64[np.ndarray, " minutes *rest"]:
        total = np.zeros((count, *values.shape[1:]))
        np.add.at(total, minute, values)
        return total

    speed = spectra.velocities_m_s
    if speed is None:
        speeds = atlas_velocity(spectra.diameters_mm)[:, None]
    else:
        speeds = np.broadcast_to(speed, (len(spectra.diameters_mm), len(speed)))
    slowness = np.divide(1, speeds, out=np.zeros_like(speeds), where=speeds > 0)
    seconds = summed(spectra.seconds)
    by_class = summed(spectra.counts)
    return Minutes(
        seconds=seconds,
        records=summed(np.ones(len(spectra))),
        rate_mm_h=summed(spectra.rate_mm_h * spectra.seconds) / seconds,
        reported_mm_h=summed(spectra.reported_mm_h * spectra.seconds) / seconds,
        drops=by_class.sum(axis=2),
        density_seconds=np.einsum("mdv,dv->md", by_class, slowness) / spectra.area_m2,
        speed_sum=np.einsum("mdv,dv->md", by_class, speeds),
        squared_speed_sum=np.einsum("mdv,dv->md", by_class, speeds**2),
    )


def _minute_of_record(spectra: DropSpectra) -> tuple[Int64[np.ndarray, " records"], int]:
    """Index of each record's minute, and the number of minutes."""
    ends = spectra.times.astype("datetime64[ms]")
    middles = ends.astype(np.int64) - np.rint(500 * spectra.seconds).astype(np.int64)
    known = ~np.isnat(ends)
    keys = np.where(known, np.floor_divide(middles, MINUTE_MS), 0)
    keys[~known] = keys.max(initial=0) + 1 + np.arange(np.count_nonzero(~known))
    distinct, minute = np.unique(keys, return_inverse=True)
    return minute.astype(np.int64), len(distinct)


# Calibration rows

MIN_BIN_DROPS = 500
ENOUGH_DROPS = 5000
"""A bin needs five minutes and 500 drops, or 5000 drops, which suffice even within one minute."""

NO_RAIN = "no rain"
_MIN_OF_A_CLASS = 50


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FittedRow:
    """One intensity bin: its spectrum, and the row fitted to it."""

    middle_mm_h: float
    """Center of the bin; the row's own intensity is the mean of its minutes."""
    row: CalibrationRow
    picked: Bool[np.ndarray, " minutes"]
    """Mask of the bin's minutes."""
    records: int
    drops: int
    """Counted drops in the fitted classes."""
    spectrum_m3_mm: Float64[np.ndarray, " diameters"]
    """Measured N(D) in 1/(m^3 mm), all classes."""
    moments_shape: float
    moments_scale_mm: float
    """Shape and scale by the method of moments, as a cross-check."""
    implied_mm_h: float
    """Rain rate from density, size law and fitted fall speed: 6e-4 pi N E[V D^3]."""
    moments_implied_mm_h: float
    """Rain rate with the law by moments."""

    @property
    def minutes(self) -> int:
        return int(self.picked.sum())


def fitted_classes(minutes: Minutes, edges_mm: Float64[np.ndarray, " d_and_one"], smallest_mm: float) -> slice:
    """Diameter classes for the size law: from the first with 50 drops, the instrument's detection limit, to 8 mm.

    Raises `ValueError` if fewer than three are left.
    """
    counted = minutes.drops.sum(axis=0) >= _MIN_OF_A_CLASS
    open_to_fit = (edges_mm[:-1] >= max(smallest_mm, SMALLEST_MM) - 1e-9) & (edges_mm[1:] <= LARGEST_MM + 1e-9)
    first = np.flatnonzero(counted & open_to_fit)
    last = np.flatnonzero(open_to_fit)
    if not first.size or last[-1] - first[0] < 2:
        raise ValueError(
            f"too few drops to fit: {minutes.drops.sum():,.0f} can be trusted; expected three diameter classes within "
            f"{max(smallest_mm, SMALLEST_MM):g}..{LARGEST_MM:g} mm, the first with {_MIN_OF_A_CLASS} drops or more"
        )
    return slice(int(first[0]), int(last[-1]) + 1)


def fit_rows(
    minutes: Minutes,
    edges_mm: Float64[np.ndarray, " d_and_one"],
    classes: slice,
    velocity: VelocityFit,
    options: FitOptions,
) -> tuple[list[FittedRow], list[str]]:
    """Fit a row for each bin with enough drops; return a sentence with the reason for each other bin."""
    generator = np.random.default_rng(options.seed)
    fits: list[FittedRow] = []
    passed_over: list[str] = []
    for middle in sorted(set(options.intensities_mm_h)):
        picked = np.abs(minutes.rate_mm_h - middle) <= options.half_width * middle
        reason = _why_not(minutes, classes, picked)
        if not reason:
            fit = _fit_bin(minutes, edges_mm, classes, picked, middle, velocity, options.resamples, generator)
            if not fits or fit.row.intensity_mm_h > fits[-1].row.intensity_mm_h:
                fits.append(fit)
                continue
            reason = f"the same minutes as {fits[-1].middle_mm_h:g} mm/h"
        passed_over.append(f"{middle:g} mm/h: {reason}")
    return fits, passed_over


def _why_not(minutes: Minutes, classes: slice, picked: Bool[np.ndarray, " minutes"]) -> str:
    by_class = minutes.drops[picked, classes].sum(axis=0)
    count, drops = int(picked.sum()), int(by_class.sum())
    if drops < MIN_BIN_DROPS or (count < FEWEST_MINUTES and drops < ENOUGH_DROPS):
        return f"{count} minutes with {drops} drops" if count else NO_RAIN
    if np.count_nonzero(by_class) < 3:
        return f"{drops} drops in fewer than three diameter classes"
    return ""


def _fit_bin(
    minutes: Minutes,
    edges_mm: Float64[np.ndarray, " d_and_one"],
    classes: slice,
    picked: Bool[np.ndarray, " minutes"],
    middle_mm_h: float,
    velocity: VelocityFit,
    resamples: int,
    generator: np.random.Generator,
) -> FittedRow:
    seconds, in_air = minutes.seconds[picked], minutes.density_seconds[picked]
    edges = edges_mm[classes.start : classes.stop + 1]
    density = in_air.sum(axis=0) / seconds.sum()
    laws = fit_by_likelihood(density[None, classes], edges)
    number = _whole_density(density[None, classes], laws, edges)
    confidence = None
    if resamples and picked.sum() >= FEWEST_MINUTES:
        drawn = resampling_weights(int(picked.sum()), resamples, generator)
        densities = (drawn @ in_air[:, classes]) / (drawn @ seconds)[:, None]
        densities = densities[(densities > 0).sum(axis=1) >= 3]
        others = fit_by_likelihood(densities, edges)
        confidence = RowConfidence(
            density_m3=percentile_interval(_whole_density(densities, others, edges)),
            shape=percentile_interval(others.shape),
            scale_mm=percentile_interval(others.scale_mm),
        )
    row = CalibrationRow(
        intensity_mm_h=round_significant(float(minutes.rate_mm_h[picked] @ seconds / seconds.sum())),
        density_m3=round_significant(number[0]),
        shape=round_significant(laws.shape[0]),
        scale_mm=round_significant(laws.scale_mm[0]),
        minutes=int(picked.sum()),
        confidence=confidence,
    )
    by_moments = fit_by_moments(density[None, classes], edges)
    moments = DropSizes(float(by_moments.shape[0]), float(by_moments.scale_mm[0]))
    return FittedRow(
        middle_mm_h=middle_mm_h,
        row=row,
        picked=picked,
        records=int(minutes.records[picked].sum()),
        drops=int(minutes.drops[picked, classes].sum()),
        spectrum_m3_mm=density / np.diff(edges_mm),
        moments_shape=moments.shape,
        moments_scale_mm=moments.scale_mm,
        implied_mm_h=flux_mm_h(row.density_m3, DropSizes(row.shape, row.scale_mm), velocity),
        moments_implied_mm_h=flux_mm_h(row.density_m3, moments, velocity),
    )


def _whole_density(
    density: Float64[np.ndarray, "fits classes"], laws: GammaLaws, edges_mm: Float64[np.ndarray, " classes_and_one"]
) -> Float64[np.ndarray, " fits"]:
    """Drops per cubic meter from 0.1 to 8 mm: those in the fitted classes over the law's share there."""
    ends = class_shares(laws, np.array([SMALLEST_MM, LARGEST_MM]))[:, 0]
    return density.sum(axis=1) * ends / class_shares(laws, edges_mm).sum(axis=1)


# Results


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ClassSpeeds:
    """Fall speeds by diameter class."""

    drops: Float64[np.ndarray, " diameters"]
    mean_m_s: Float64[np.ndarray, " diameters"]
    """NaN without drops."""
    deviation_m_s: Float64[np.ndarray, " diameters"]
    """Standard deviation of single drops."""
    fitted: Bool[np.ndarray, " diameters"]
    """True for classes used by the quadratic."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FittedCalibration:
    """Fitted calibration with its data and diagnostics."""

    calibration: Calibration
    rows: tuple[FittedRow, ...]
    passed_over: tuple[str, ...]
    """One sentence for each bin without a row."""
    diameter_edges_mm: Float64[np.ndarray, " diameters_and_one"]
    fitted_range_mm: Interval
    """Diameter range of the size-law fit."""
    speeds: ClassSpeeds | None
    """None if the instrument measures no speed."""
    velocity_confidence: tuple[Interval, Interval, Interval] | None
    """95 % intervals of the coefficients."""
    axis_ratios: AxisRatios | None
    rate_check: RateCheck | None
    """None if the instrument reports no rate."""
    records: int
    records_used: int
    """Records in the minutes of any row."""
    minute_rate_mm_h: Float64[np.ndarray, " minutes"]
    minute_reported_mm_h: Float64[np.ndarray, " minutes"]
