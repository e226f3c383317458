"""What a fit gives: the calibration, and everything that a plot or a panel shows beside it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from ..calibration import Calibration, CalibrationRow, Interval
from .axis_ratio import AxisRatios
from .measured_file import RateCheck


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FittedRow:
    """One intensity bin: its spectrum, and the row fitted to it."""

    middle_mm_h: float
    """Of the bin, as asked for; the row's own intensity is the mean of its minutes."""
    row: CalibrationRow
    minutes: int
    records: int
    drops: int
    """Counted, in the classes that were fitted."""
    spectrum_m3_mm: Float64[np.ndarray, " diameters"]
    """Measured N(D) in 1/(m^3 mm), all classes."""
    moments_shape: float
    moments_scale_mm: float
    """The method of moments, as a cross-check."""
    implied_mm_h: float
    """Rate that density, size law and fitted fall speed carry together: 6e-4 pi N E[V D^3]."""
    moments_implied_mm_h: float
    """The same with the law by moments."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ClassSpeeds:
    """Fall speeds by diameter class."""

    drops: Float64[np.ndarray, " diameters"]
    mean_m_s: Float64[np.ndarray, " diameters"]
    """NaN without drops."""
    deviation_m_s: Float64[np.ndarray, " diameters"]
    """Standard deviation of single drops."""
    fitted: Bool[np.ndarray, " diameters"]
    """Which classes the quadratic goes through."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FittedCalibration:
    """A calibration with what it was fitted to."""

    calibration: Calibration
    rows: tuple[FittedRow, ...]
    passed_over: tuple[str, ...]
    """One sentence for each bin that gave no row."""
    diameter_edges_mm: Float64[np.ndarray, " diameters_and_one"]
    fitted_range_mm: Interval
    """Diameters that the size law was fitted to."""
    speeds: ClassSpeeds | None
    """None where the instrument measures no speed."""
    velocity_confidence: tuple[Interval, Interval, Interval] | None
    """Of the coefficients, 95 %."""
    axis_ratios: AxisRatios | None
    rate_check: RateCheck | None
    """None where the instrument gives no rate of its own."""
    records: int
    records_used: int
    """Those in the minutes of any row."""
    minute_rate_mm_h: Float64[np.ndarray, " minutes"]
    minute_reported_mm_h: Float64[np.ndarray, " minutes"]
