"""Comparison of simulated and real rain by streak and residual statistics over the same background."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from jaxtyping import UInt8

from ..datasets.rainsense import RainSequence
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from .streaks import (
    BANDS,
    MedianResiduals,
    ResidualStatistics,
    StreakStatistics,
    Window,
    cropped_camera,
    find_streaks,
    median_residuals,
    render_rain_frames,
    residual_statistics,
    streak_statistics,
)

_SKY_PERCENTILE = 90


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameStatistics:
    """Statistics of one sequence of frames."""

    exposure_s: float | None
    """Simulated shutter time; None for real frames, whose shutter time is unknown."""
    residual: ResidualStatistics
    streak: StreakStatistics
    """In front of the dark band of backgrounds."""
    by_background: tuple[StreakStatistics, ...]
    """In front of each band of BANDS."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RealRainComparison:
    """One real sequence, and simulated rain in front of its background."""

    sequence: str
    labelled_mm_h: float
    """Labeled rain rate of the real sequence."""
    rendered_mm_h: float
    """Rain rate of the simulation."""
    window: Window
    sky_levels: float
    """Display level of the drops' light: the 90th percentile above the horizon."""
    real: FrameStatistics
    ours: tuple[FrameStatistics, ...]
    """One for each exposure."""


def above_horizon(sequence: RainSequence) -> Window:
    """Return the part above the horizon of a level camera's image, without moving reflections of a wet road."""
    camera = sequence.camera
    return 0, 0, camera.width, int(np.clip(camera.cy, 1, camera.height))


def evenly_chosen(sequence: RainSequence, count: int, most_apart_s: float = 0.2) -> list[int]:
    """Choose frames around the middle of a sequence, at most `most_apart_s` apart: light and wind change slowly."""
    spacing = (sequence.times_s[-1] - sequence.times_s[0]) / max(len(sequence) - 1, 1)
    step = max(min(len(sequence) // count, int(most_apart_s / spacing + 0.5)), 1) if spacing > 0 else 1
    kept = min(count, len(sequence))
    first = (len(sequence) - (kept - 1) * step - 1) // 2
    return [first + k * step for k in range(kept)]


def compare_with_real_rain(
    sequence: RainSequence, rain: RainSettings, exposures_s: Sequence[float], numbers: Sequence[int], window: Window
) -> RealRainComparison:
    """Measure frames of a sequence, and simulated rain at each exposure in front of their temporal median.

    The simulation uses the sequence's camera, times, background and noise, without haze, since the distance of the
    background is unknown. Pixels that move in the real frames are excluded from both. Raises ValueError for a window
    outside the image, and as `median_residuals` does.
    """
    x, y, width, height = window
    camera = sequence.camera
    if min(x, y) < 0 or min(width, height) < 32 or x + width > camera.width or y + height > camera.height:
        raise ValueError(
            f"window {x},{y},{width},{height}: must be 32 px or more within {camera.width}x{camera.height}"
        )
    pictures = [sequence.gray_image(k) for k in numbers]
    real = median_residuals(np.stack([picture[y : y + height, x : x + width] for picture in pictures]))
    horizon = above_horizon(sequence)[3]
    sky = float(np.median([np.percentile(picture[:horizon], _SKY_PERCENTILE) for picture in pictures]))
    ours: list[FrameStatistics] = []
    for exposure in exposures_s:
        falling = RainSimulation.start(msgspec.structs.replace(rain, exposure_s=exposure, haze=False))
        times = [sequence.times_s[k] for k in numbers]
        made = _stacked(real, sequence, window, falling, times, sky)
        ours.append(_measured(replace(median_residuals(made), still=real.still), sky, exposure))
    return RealRainComparison(
        sequence=sequence.name,
        labelled_mm_h=sequence.intensity_mm_h,
        rendered_mm_h=rain.intensity_mm_h,
        window=window,
        sky_levels=sky,
        real=_measured(real, sky, None),
        ours=tuple(ours),
    )


def _stacked(
    real: MedianResiduals,
    sequence: RainSequence,
    window: Window,
    falling: RainSimulation,
    times_s: list[float],
    sky: float,
) -> UInt8[np.ndarray, "t h w"]:
    camera = cropped_camera(sequence.camera, window)
    return np.stack(list(render_rain_frames(real.median, real.sigma, camera, falling, times_s, sky)))


def _measured(found: MedianResiduals, sky: float, exposure_s: float | None) -> FrameStatistics:
    bright, darker = find_streaks(found, sky), find_streaks(found, sky, darker=True)
    return FrameStatistics(
        exposure_s=exposure_s,
        residual=residual_statistics(found),
        streak=streak_statistics(bright, darker, found),
        by_background=tuple(streak_statistics(bright, darker, found, band) for band in BANDS),
    )
