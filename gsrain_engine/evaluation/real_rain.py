"""Our rain beside real rain: the same statistics of real frames and of our rain before their background."""

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
    """What was measured in one run of frames."""

    exposure_s: float | None
    """Shutter time that was rendered with; none for real frames, which don't tell it."""
    residual: ResidualStatistics
    streak: StreakStatistics
    """Before the dark band of backgrounds."""
    by_background: tuple[StreakStatistics, ...]
    """Before each band of BANDS."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RealRainComparison:
    """One real sequence, and our rain before its background."""

    sequence: str
    labelled_mm_h: float
    """Of the real rain, as the data set says."""
    rendered_mm_h: float
    """Of ours."""
    window: Window
    sky_levels: float
    """Display level of the drops' light: the brightest tenth of what is above the horizon begins there."""
    real: FrameStatistics
    ours: tuple[FrameStatistics, ...]
    """One for each exposure."""


def above_horizon(sequence: RainSequence) -> Window:
    """Return the part of a level camera's picture where no wet road moves."""
    camera = sequence.camera
    return 0, 0, camera.width, int(np.clip(camera.cy, 1, camera.height))


def evenly_chosen(sequence: RainSequence, count: int, most_apart_s: float = 0.2) -> list[int]:
    """Choose frames around the middle of a sequence, as far apart as they may be: light and wind change slowly."""
    spacing = (sequence.times_s[-1] - sequence.times_s[0]) / max(len(sequence) - 1, 1)
    step = max(min(len(sequence) // count, int(most_apart_s / spacing + 0.5)), 1) if spacing > 0 else 1
    kept = min(count, len(sequence))
    first = (len(sequence) - (kept - 1) * step - 1) // 2
    return [first + k * step for k in range(kept)]


def compare_with_real_rain(
    sequence: RainSequence, rain: RainSettings, exposures_s: Sequence[float], numbers: Sequence[int], window: Window
) -> RealRainComparison:
    """Measure some frames of a sequence, and our rain at each exposure in front of their temporal median.

    Ours has the sequence's camera, moments, background and noise; its haze is left out, for how far the background is
    nobody measured. Pixels that move in the real frames count in neither. Raises ValueError for a window that leaves
    the picture, and as `residuals` does.
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
