"""Rows of a calibration: minutes of like intensity, and the drops in a cubic metre of them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from ..calibration import CalibrationRow, RowConfidence
from ..drop_sizes import LARGEST_MM, SMALLEST_MM
from .bootstrap import FEWEST_MINUTES, interval, resampling_weights, rounded
from .fit_options import FitOptions
from .gamma_fit import GammaLaws, class_shares, fit_by_likelihood, fit_by_moments
from .minutes import Minutes

FEWEST_DROPS = 500
ENOUGH_DROPS = 5000
"""A bin takes five minutes and 500 drops, or 5000 drops: then even one minute has a spectrum of its own."""

NO_RAIN = "no rain"
_LEAST_OF_A_CLASS = 50


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BinFit:
    """A row before the fall speed is known."""

    middle_mm_h: float
    row: CalibrationRow
    picked: Bool[np.ndarray, " minutes"]
    records: int
    drops: int
    spectrum_m3_mm: Float64[np.ndarray, " diameters"]
    moments: GammaLaws


def fitted_classes(minutes: Minutes, edges_mm: Float64[np.ndarray, " d_and_one"], smallest_mm: float) -> slice:
    """Diameter classes that a law is fitted to: from the first with 50 drops, below which nothing is seen, to 8 mm.

    Raises `ValueError` when fewer than three are left.
    """
    counted = minutes.drops.sum(axis=0) >= _LEAST_OF_A_CLASS
    open_to_fit = (edges_mm[:-1] >= max(smallest_mm, SMALLEST_MM) - 1e-9) & (edges_mm[1:] <= LARGEST_MM + 1e-9)
    first = np.flatnonzero(counted & open_to_fit)
    last = np.flatnonzero(open_to_fit)
    if not first.size or last[-1] - first[0] < 2:
        raise ValueError(
            f"too few drops to fit: {minutes.drops.sum():,.0f} can be trusted; expected three diameter classes within "
            f"{max(smallest_mm, SMALLEST_MM):g}..{LARGEST_MM:g} mm, the first with {_LEAST_OF_A_CLASS} drops or more"
        )
    return slice(int(first[0]), int(last[-1]) + 1)


def fit_rows(
    minutes: Minutes, edges_mm: Float64[np.ndarray, " d_and_one"], classes: slice, options: FitOptions
) -> tuple[list[BinFit], list[str]]:
    """Fit a row for each bin with enough drops; for each other bin, a sentence that says why not."""
    generator = np.random.default_rng(options.seed)
    fits: list[BinFit] = []
    passed_over: list[str] = []
    for middle in sorted(set(options.intensities_mm_h)):
        picked = np.abs(minutes.rate_mm_h - middle) <= options.half_width * middle
        reason = _why_not(minutes, classes, picked)
        if not reason:
            fit = _fit_bin(minutes, edges_mm, classes, picked, middle, options.resamples, generator)
            if not fits or fit.row.intensity_mm_h > fits[-1].row.intensity_mm_h:
                fits.append(fit)
                continue
            reason = f"the same minutes as {fits[-1].middle_mm_h:g} mm/h"
        passed_over.append(f"{middle:g} mm/h: {reason}")
    return fits, passed_over


def _why_not(minutes: Minutes, classes: slice, picked: Bool[np.ndarray, " minutes"]) -> str:
    by_class = minutes.drops[picked, classes].sum(axis=0)
    count, drops = int(picked.sum()), int(by_class.sum())
    if drops < FEWEST_DROPS or (count < FEWEST_MINUTES and drops < ENOUGH_DROPS):
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
    resamples: int,
    generator: np.random.Generator,
) -> BinFit:
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
            density_m3=interval(_whole_density(densities, others, edges)),
            shape=interval(others.shape),
            scale_mm=interval(others.scale_mm),
        )
    return BinFit(
        middle_mm_h=middle_mm_h,
        row=CalibrationRow(
            intensity_mm_h=rounded(float(minutes.rate_mm_h[picked] @ seconds / seconds.sum())),
            density_m3=rounded(number[0]),
            shape=rounded(laws.shape[0]),
            scale_mm=rounded(laws.scale_mm[0]),
            confidence=confidence,
        ),
        picked=picked,
        records=int(minutes.records[picked].sum()),
        drops=int(minutes.drops[picked, classes].sum()),
        spectrum_m3_mm=density / np.diff(edges_mm),
        moments=fit_by_moments(density[None, classes], edges),
    )


def _whole_density(
    density: Float64[np.ndarray, "fits classes"], laws: GammaLaws, edges_mm: Float64[np.ndarray, " classes_and_one"]
) -> Float64[np.ndarray, " fits"]:
    """Drops a cubic metre from 0.1 to 8 mm: those in the fitted classes over the law's share there."""
    ends = class_shares(laws, np.array([SMALLEST_MM, LARGEST_MM]))[:, 0]
    return density.sum(axis=1) * ends / class_shares(laws, edges_mm).sum(axis=1)
