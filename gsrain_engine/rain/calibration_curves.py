"""What a calibration says over all intensities and diameters: the curves that people compare."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float64

from .calibration import Calibration
from .drop_sizes import LARGEST_MM, SMALLEST_MM
from .rain import Rain
from .rain_state import rain_state

_INTENSITIES_MM_H = np.geomspace(0.1, 100, 61)
_DIAMETERS_MM = np.linspace(SMALLEST_MM, LARGEST_MM, 159)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CalibrationCurves:
    """Of the calibration's own table, before any closure."""

    intensities_mm_h: Float64[np.ndarray, " n"]
    density_m3: Float64[np.ndarray, " n"]
    mean_diameter_mm: Float64[np.ndarray, " n"]
    implied_share: Float64[np.ndarray, " n"]
    """Rate that the drops carry, over the intensity that they stand for."""
    diameters_mm: Float64[np.ndarray, " d"]
    fall_speed_m_s: Float64[np.ndarray, " d"]


@cache
def calibration_curves(calibration: Calibration) -> CalibrationCurves:
    """Evaluate a calibration from 0.1 to 100 mm/h and from 0.1 to 8 mm."""
    states = [rain_state(Rain(intensity_mm_h=float(each)), calibration) for each in _INTENSITIES_MM_H]
    return CalibrationCurves(
        intensities_mm_h=_INTENSITIES_MM_H,
        density_m3=np.array([each.table_density_m3 for each in states]),
        mean_diameter_mm=np.array([each.mean_diameter_mm for each in states]),
        implied_share=np.array([each.table_implied_mm_h for each in states]) / _INTENSITIES_MM_H,
        diameters_mm=_DIAMETERS_MM,
        fall_speed_m_s=calibration.velocity(_DIAMETERS_MM),
    )


@cache
def spectrum_at(calibration: Calibration, intensity_mm_h: float) -> Float64[np.ndarray, " d"]:
    """N(D) in 1/(m^3 mm) at the curves' diameters, of the table's own density."""
    state = rain_state(Rain(intensity_mm_h=intensity_mm_h), calibration)
    return state.table_density_m3 * state.sizes.probability_per_mm(_DIAMETERS_MM)
