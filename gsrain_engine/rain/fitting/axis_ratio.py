"""Height over width of drops over their diameter (paper, eq. 4), where an instrument sees the shape of single ones."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from ..calibration import atlas_velocity
from ..disdrometer.reading import SingleDrops

_WIDTH_MM = 0.25
_SMALLEST_MM = 1.0
"""Eq. 4 holds from here; smaller drops are spheres."""
_FEWEST_DROPS = 20
_SPEED_BAND = 0.6
"""Drops this share off the speed of Atlas et al. (1973) are splashes and mismatched pairs of shadows."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AxisRatios:
    """Median axis ratio by diameter, and the line through it from 1 mm on: ratio = offset + slope D."""

    diameters_mm: Float64[np.ndarray, " classes"]
    medians: Float64[np.ndarray, " classes"]
    quartiles: Float64[np.ndarray, "2 classes"]
    drops: int
    offset: float
    slope_per_mm: float
    r2: float


def fit_axis_ratio(drops: SingleDrops) -> AxisRatios | None:
    """Fit a line through the medians of classes of 20 drops or more, weighted by these; None with fewer than three."""
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
