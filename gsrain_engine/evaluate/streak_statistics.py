"""Streaks in numbers: how many, and quantiles and histograms of their angle, length, width, rise and exposure."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from .residuals import Residuals
from .streaks import StreakTable

DARK_BAND = (32.0, 64.0)
"""Backgrounds before which single streaks are compared: above what a camera's tone curve crushes to black, and dark."""

BANDS = ((0.0, 16.0), (16.0, 32.0), DARK_BAND, (64.0, 96.0), (96.0, 140.0))
"""Backgrounds before which streaks are looked at by brightness, to see how light adds."""

STEEP_DEG = 45.0
"""Lines that lean more are branches or ripples, not rain."""

LENGTH_EDGES_PX = (0, 10, 20, 30, 40, 60, 80, 120, 160, 240, 1e4)
ANGLE_EDGES_DEG = tuple(range(-45, 46, 5))
_QUANTILES = (10, 50, 90)

Quantiles = tuple[float, float, float]
"""The values that 10, 50 and 90 % lie below; NaN where there is no streak."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StreakStatistics:
    """Over the streaks before backgrounds of one band of grey levels; where nothing else moves."""

    band_levels: tuple[float, float]
    """Backgrounds counted in, up to but without the second."""
    streaks: int
    darker: int
    """Found by the same search turned round, below the background: about as many of the streaks are not rain."""
    megapixels: float
    """Searched: pixels of the band times frames."""
    per_megapixel: float
    angle_deg: Quantiles
    length_px: Quantiles
    width_px: Quantiles
    rise_levels: Quantiles
    opacity: Quantiles
    exposure_s: Quantiles
    """That the streaks tell by themselves (see StreakTable)."""
    length_histogram: tuple[int, ...]
    """Counts between LENGTH_EDGES_PX."""
    angle_histogram: tuple[int, ...]
    """Counts between ANGLE_EDGES_DEG."""


def streak_statistics(
    bright: StreakTable, darker: StreakTable, found: Residuals, band: tuple[float, float] = DARK_BAND
) -> StreakStatistics:
    """Summarize what `find_streaks` found in residuals, once bright and once `darker`."""
    low, high = band
    chosen, control = _within(bright, band), len(_within(darker, band))
    pixels = int(np.count_nonzero(found.still & (found.median >= low) & (found.median < high)))
    searched = 1e-6 * pixels * len(found.values)
    return StreakStatistics(
        band_levels=band,
        streaks=len(chosen),
        darker=control,
        megapixels=searched,
        per_megapixel=len(chosen) / searched if searched else 0.0,
        angle_deg=_quantiles(chosen.angle_deg),
        length_px=_quantiles(chosen.length_px),
        width_px=_quantiles(chosen.width_px),
        rise_levels=_quantiles(chosen.rise_levels),
        opacity=_quantiles(chosen.opacity),
        exposure_s=_quantiles(chosen.exposure_s),
        length_histogram=tuple(int(n) for n in np.histogram(chosen.length_px, LENGTH_EDGES_PX)[0]),
        angle_histogram=tuple(int(n) for n in np.histogram(chosen.angle_deg, ANGLE_EDGES_DEG)[0]),
    )


def _within(table: StreakTable, band: tuple[float, float]) -> StreakTable:
    background = table.background_levels
    return table[(background >= band[0]) & (background < band[1]) & (np.abs(table.angle_deg) <= STEEP_DEG)]


def _quantiles(values: Float64[np.ndarray, " n"]) -> Quantiles:
    if not len(values):
        return (np.nan, np.nan, np.nan)
    low, middle, high = np.percentile(values, _QUANTILES)
    return float(low), float(middle), float(high)
