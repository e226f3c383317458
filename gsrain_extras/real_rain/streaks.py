"""Rain streaks in frames of a static camera: detection, measurement and statistics.

The residual (frame minus temporal median) is averaged along short lines of twelve directions, the best direction is
compared with its noise, and significant pixels form connected components. Moments of each component in the residual
give the angle, and the length, width and rise of the box with the same moments.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cache

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from gsrain_engine.scene.geometry import srgb_to_linear

LINE_PX = 15  # length of the lines of the streak detector
FALL_BY_DIAMETER_S = 0.3e-3  # D/V of the drops that make visible streaks
LINE_DIRECTIONS = 12  # of the detector, from the vertical on
_ACROSS_SIGMA_PX = 1.0
_EDGE_Z, _PEAK_Z = 4.0, 7.0
"""Thresholds on the line response in standard deviations of its noise: for a component's pixels, and for its peak."""

_MIN_ELONGATION = 3.0
_MIN_LENGTH_PX = 6.0
_MARGIN_PX = 2
_CORE_SHARE = 0.3
MAD_TO_SIGMA = 1.4826  # of a normal law


@dataclass(frozen=True, slots=True, eq=False)
class StreakTable:
    """Streaks, one per row, without those cut off by the image edge. Levels are gray levels of 255."""

    frame: Int64[np.ndarray, " n"]
    center_px: Float64[np.ndarray, "n 2"]
    """x to the right, y down; the center of the first pixel is (0, 0)."""
    angle_deg: Float64[np.ndarray, " n"]
    """From the vertical, within -90..90; positive if the lower end is farther right."""
    length_px: Float64[np.ndarray, " n"]
    width_px: Float64[np.ndarray, " n"]
    rise_levels: Float64[np.ndarray, " n"]
    """Over the background, averaged over length and width."""
    background_levels: Float64[np.ndarray, " n"]
    coverage_px2: Float64[np.ndarray, " n"]
    """Integral of alpha over the streak for linear light: a drop's cross-section in the image."""

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, chosen: Bool[np.ndarray, " n"]) -> "StreakTable":
        return StreakTable(*(getattr(self, field.name)[chosen] for field in fields(self)))

    @property
    def opacity(self) -> Float64[np.ndarray, " n"]:
        """Coverage over length and width: the mean alpha of the streak."""
        return self.coverage_px2 / (self.length_px * self.width_px)

    @property
    def exposure_s(self) -> Float64[np.ndarray, " n"]:
        """Shutter time estimated from a single streak, independent of distance and blur.

        Its coverage C is pi/4 (f D/d)^2 and its length L is f V T/d, so T = (D/V) sqrt(pi L^2 / (4 C)). D/V, the time
        in which a drop falls its own diameter, hardly depends on D: 0.25-0.38 ms for 1-3 mm (Atlas et al., 1973). Blur
        adds equally to the squared length and the squared width and is subtracted.
        """
        squared = np.maximum(self.length_px**2 - self.width_px**2, 0)
        return FALL_BY_DIAMETER_S * np.sqrt(np.pi / 4 * squared / self.coverage_px2)


def find_streaks(found: "MedianResiduals", drop_levels: float, *, darker: bool = False) -> StreakTable:
    """Find and measure bright streaks; `drop_levels` is the display level of a drop's own light, about that of the sky.

    `darker` detects streaks below the background instead: rain causes none in front of dark backgrounds, so their
    number estimates the false positives among bright ones.
    """
    sign = -1.0 if darker else 1.0
    rows = [row for number in range(len(found.values)) for row in _in_frame(found, number, sign, drop_levels)]
    table = np.array(rows, np.float64).reshape(-1, 9)
    return StreakTable(
        table[:, 0].astype(np.int64), table[:, 1:3], *(np.ascontiguousarray(table[:, k]) for k in range(3, 9))
    )


def coverage(
    background_levels: Float32[np.ndarray, "*n"], rise_levels: Float32[np.ndarray, "*n"], drop_levels: float
) -> Float32[np.ndarray, "*n"]:
    """Alpha that raises a background by `rise_levels` in linear light: (dec(B + r) - dec(B)) / (dec(S) - dec(B))."""
    before = srgb_to_linear(background_levels / 255)
    light = float(srgb_to_linear(np.array([drop_levels / 255]))[0])
    after = srgb_to_linear((background_levels + rise_levels) / 255)
    return ((after - before) / np.maximum(light - before, 0.02)).astype(np.float32)


def _in_frame(found: "MedianResiduals", number: int, sign: float, drop_levels: float) -> Iterator[tuple[float, ...]]:
    values = np.where(found.still, np.float32(sign) * found.values[number], np.float32(0))
    z = line_responses(values / found.sigma, found.still)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats((z > _EDGE_Z).astype(np.uint8), connectivity=8)
    height, width = values.shape
    light = coverage(found.median.astype(np.float32), sign * values, drop_levels)
    for label in range(1, count):
        left, top, w, h = (int(v) for v in boxes[label, :4])
        if left == 0 or top == 0 or left + w == width or top + h == height:
            continue
        rows = slice(max(top - _MARGIN_PX, 0), top + h + _MARGIN_PX)
        columns = slice(max(left - _MARGIN_PX, 0), left + w + _MARGIN_PX)
        part = rows, columns
        own, others = labels[part] == label, ~np.isin(labels[part], (0, label))
        response = np.where(own, z[part], np.float32(0))
        if response.max() < _PEAK_Z:
            continue
        # The connected region around the peak: lines that cross a bright streak also respond.
        _, pieces = cv2.connectedComponents((response > _CORE_SHARE * response.max()).astype(np.uint8), connectivity=8)
        core = (pieces == pieces.flat[int(response.argmax())]).astype(np.uint8)
        margin = np.ones((2 * _MARGIN_PX + 1,) * 2, np.uint8)  # adds the flanks that the threshold cut off
        own = (cv2.dilate(core, margin) > 0) & ~others
        box, covered = box_with_moments(values[part], own), sign * float(light[part][own].sum())
        if box is None or covered <= 0:
            continue
        x, y, angle_deg, length_px, width_px, rise_levels = box
        if length_px >= max(_MIN_LENGTH_PX, _MIN_ELONGATION * width_px):
            background, place = float(np.median(found.median[part][own])), (x + columns.start, y + rows.start)
            yield (number, *place, angle_deg, length_px, width_px, rise_levels, background, covered)


def line_responses(
    normalized: Float32[np.ndarray, "h w"],
    still: Bool[np.ndarray, "h w"] | None = None,
    directions: Sequence[int] = tuple(range(LINE_DIRECTIONS)),
) -> Float32[np.ndarray, "h w"]:
    """Return the largest mean along a short line over directions, in deviations of those at the still pixels."""
    z, kernels = np.full(normalized.shape, -np.inf, np.float32), line_kernels()
    for direction in directions:
        np.maximum(z, cv2.filter2D(normalized, -1, kernels[direction]), out=z)
    quiet = z if still is None else z[still]
    middle = float(np.median(quiet))
    return (z - middle) / max(MAD_TO_SIGMA * float(np.median(np.abs(quiet - middle))), 1e-6)


@cache
def line_kernels() -> tuple[Float32[np.ndarray, "k k"], ...]:
    reach = LINE_PX // 2
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    kernels: list[Float32[np.ndarray, "k k"]] = []
    for angle in np.pi / LINE_DIRECTIONS * np.arange(LINE_DIRECTIONS):
        along, across = x * np.sin(angle) + y * np.cos(angle), x * np.cos(angle) - y * np.sin(angle)
        kernel = np.exp(-((across / _ACROSS_SIGMA_PX) ** 2) / 2) * (np.abs(along) <= reach)
        kernels.append((kernel / kernel.sum()).astype(np.float32))
    return tuple(kernels)


def box_with_moments(values: Float32[np.ndarray, "h w"], own: Bool[np.ndarray, "h w"]) -> tuple[float, ...] | None:
    """Center, angle, length, width (px) and rise of the box with the moments of some pixels; None for noise."""
    y, x = np.nonzero(own)
    weights = values[own].astype(np.float64)
    total = float(weights.sum())
    if total <= 0:
        return None
    cx, cy = float(weights @ x) / total, float(weights @ y) / total
    dx, dy = x - cx, y - cy
    xx, xy, yy = (float(weights @ each) / total for each in (dx * dx, dx * dy, dy * dy))
    half_difference, middle = np.hypot((xx - yy) / 2, xy), (xx + yy) / 2
    if middle - half_difference <= 0:
        return None
    # The long axis is (sin a, cos a) in x and y, so a is measured from the vertical.
    angle = np.degrees(np.arctan2(2 * xy, yy - xx) / 2)
    length, width = np.sqrt(12 * (middle + half_difference)), np.sqrt(12 * (middle - half_difference))
    return (cx, cy, float(angle), float(length), float(width), total / float(length * width))


# Temporal-median residuals

VISIBLE_LEVELS = 8  # a pixel counts as changed if it differs from its median by more gray levels than this
RESTLESS_LEVELS = 4.5  # larger typical deviations mean motion in most frames: leaves, water, people. Rain is in few
LIMIT_OF_NOISE_LEVELS = 4.0  # deviations up to this are noise of a camera in good light
_MIN_SIGMA = 0.5  # of a level: gray values are integers
_RESTLESS_MARGIN_PX = 3


@dataclass(frozen=True, slots=True, eq=False)
class MedianResiduals:
    """Gray levels (0-255) of a static camera."""

    median: UInt8[np.ndarray, "h w"]
    """Of each pixel over time."""
    values: Float32[np.ndarray, "t h w"]
    """Frame minus median, without the frame's common offset (automatic exposure)."""
    sigma: Float32[np.ndarray, "h w"]
    """Typical deviation around each pixel, 1.4826 times the median of |value|: noise, since rain is in few frames."""
    still: Bool[np.ndarray, "h w"]
    """Mask of pixels where only noise and rain change."""


def median_residuals(frames: UInt8[np.ndarray, "t h w"]) -> MedianResiduals:
    """Subtract the temporal median from gray frames; raises ValueError for fewer than 5, too few to remove rain."""
    if len(frames) < 5:
        raise ValueError(f"{len(frames)} frames: a temporal median free of rain takes at least 5")
    middle = len(frames) // 2
    median = np.partition(frames, middle, axis=0)[middle]
    values = frames.astype(np.float32) - median
    values -= np.median(values.reshape(len(values), -1), axis=1).astype(np.float32)[:, None, None]
    # Gray levels are integers: only averaging over neighbors resolves deviations better than 1.5 levels.
    sigma = cv2.blur(MAD_TO_SIGMA * np.partition(np.abs(values), middle, axis=0)[middle], (7, 7)).astype(np.float32)
    restless = (sigma > RESTLESS_LEVELS).astype(np.uint8)
    around = np.ones((2 * _RESTLESS_MARGIN_PX + 1,) * 2, np.uint8)
    still = cv2.dilate(restless, around) == 0
    return MedianResiduals(median, values, np.maximum(sigma, np.float32(_MIN_SIGMA)), still)


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualStatistics:
    """Statistics over all frames of the still pixels; shares refer to them, levels are gray levels of 255."""

    frames: int
    still_share: float
    """Of all pixels."""
    background_levels: float
    noise_levels: float
    """Median over the still pixels of their typical deviation."""
    std_levels: float
    share_above: float
    """More than VISIBLE_LEVELS above the median."""
    share_below: float
    """More than VISIBLE_LEVELS below the median: rain in front of a dark background never causes this."""


def residual_statistics(found: MedianResiduals) -> ResidualStatistics:
    """Summarize residuals; raises ValueError if no pixel is still."""
    if not found.still.any():
        raise ValueError("no pixel stands still in these frames: choose another window")
    values = found.values[:, found.still]
    return ResidualStatistics(
        frames=len(values),
        still_share=float(found.still.mean()),
        background_levels=float(np.median(found.median[found.still])),
        noise_levels=float(np.median(found.sigma[found.still])),
        std_levels=float(values.std()),
        share_above=float((values > VISIBLE_LEVELS).mean()),
        share_below=float((values < -VISIBLE_LEVELS).mean()),
    )


# Streak statistics

DARK_BAND = (32.0, 64.0)  # background levels for streak comparisons: dark, but above a camera's crushed blacks
BANDS = ((0.0, 16.0), (16.0, 32.0), DARK_BAND, (64.0, 96.0), (96.0, 140.0))
"""Background levels by brightness, to test how light adds."""

STEEP_DEG = 45.0  # lines with a larger angle are branches or ripples, not rain
LENGTH_EDGES_PX = (0, 10, 20, 30, 40, 60, 80, 120, 160, 240, 1e4)
ANGLE_EDGES_DEG = tuple(range(-45, 46, 5))
_MEASURES = ("angle_deg", "length_px", "width_px", "rise_levels", "opacity", "exposure_s")
_QUANTILES = (10, 50, 90)
Quantiles = tuple[float, float, float]  # the 10, 50 and 90 % quantiles; NaN without streaks


@dataclass(frozen=True, slots=True, kw_only=True)
class StreakStatistics:
    """Statistics of the streaks in front of one band of background levels, where nothing else moves."""

    band_levels: tuple[float, float]
    """Range of background levels, the end excluded."""
    streaks: int
    darker: int
    """Number of streaks below the background: an estimate of the false positives among `streaks`."""
    megapixels: float
    """Searched megapixels: pixels of the band times frames."""
    per_megapixel: float
    angle_deg: Quantiles
    length_px: Quantiles
    width_px: Quantiles
    rise_levels: Quantiles
    opacity: Quantiles
    exposure_s: Quantiles
    """Estimated from the streaks, see `StreakTable.exposure_s`."""
    length_histogram: tuple[int, ...]
    angle_histogram: tuple[int, ...]


def streak_statistics(
    bright: StreakTable, darker: StreakTable, found: MedianResiduals, band: tuple[float, float] = DARK_BAND
) -> StreakStatistics:
    """Summarize the output of `find_streaks` on residuals, bright and `darker`."""
    low, high = band
    chosen, control = streaks_within(bright, band), len(streaks_within(darker, band))
    pixels = int(np.count_nonzero(found.still & (found.median >= low) & (found.median < high)))
    searched = 1e-6 * pixels * len(found.values)
    return StreakStatistics(
        band_levels=band,
        streaks=len(chosen),
        darker=control,
        megapixels=searched,
        per_megapixel=len(chosen) / searched if searched else 0.0,
        **{name: _quantiles(getattr(chosen, name)) for name in _MEASURES},
        length_histogram=tuple(np.histogram(chosen.length_px, LENGTH_EDGES_PX)[0].tolist()),
        angle_histogram=tuple(np.histogram(chosen.angle_deg, ANGLE_EDGES_DEG)[0].tolist()),
    )


def streaks_within(table: StreakTable, band: tuple[float, float]) -> StreakTable:
    """Return the streaks near the vertical in front of a band of background levels."""
    background = table.background_levels
    return table[(background >= band[0]) & (background < band[1]) & (np.abs(table.angle_deg) <= STEEP_DEG)]


def _quantiles(values: Float64[np.ndarray, " n"]) -> Quantiles:
    if not len(values):
        return (np.nan, np.nan, np.nan)
    low, middle, high = np.percentile(values, _QUANTILES)
    return float(low), float(middle), float(high)
