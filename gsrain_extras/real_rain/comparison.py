"""Real rain in frames of a static camera, and simulated rain in front of the same background, with the same noise."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import cv2
import msgspec
import numpy as np
from jaxtyping import Float32, Float64, UInt8
from msgspec import Meta

from gsrain_engine.datasets.rainsense import RainSequence
from gsrain_engine.presets import load_config
from gsrain_engine.rain.settings import HEAVIEST_MM_H, RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.camera_response import display_noise, light_of_display, tone_curve
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.sensor import load_sensor
from gsrain_engine.settings import Settings

from .drop_light import light_before
from .photograph import StoredPhoto, Window, cropped_camera, noise_of, photographed, rain_over, rain_shares
from .rain_free import below_black
from .streaks import (
    BANDS,
    MedianResiduals,
    ResidualStatistics,
    StreakStatistics,
    StreakTable,
    find_streaks,
    median_residuals,
    residual_statistics,
    streak_statistics,
)

# Conditions of real sequences
# YAML files; docs/real_rain_method.md says how those of RainSense were estimated.


class SequenceConditions(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Air and camera of one real sequence, as far as they differ from the defaults. The camera looks along +x, east."""

    # fmt: off
    intensity_mm_h: Annotated[float, Meta(
        ge=0, le=500, title="Intensity", extra={"unit": "mm/h"},
        description="Labeled intensity of the sequence that is meant.")]
    shutter_s: Annotated[Annotated[float, Meta(ge=1e-5, le=1)] | None, Meta(
        title="Shutter", extra={"unit": "s", "none": "the sensor's"},
        description="Exposure time, estimated from the length of streaks.")] = None
    wind_speed_m_s: Annotated[float, Meta(
        ge=0, le=60, title="Wind speed", extra={"unit": "m/s"}, description="Mean wind at 10 m.")] = 2.0
    wind_from_deg: Annotated[float, Meta(
        ge=0, le=360, title="Wind from", extra={"unit": "degrees"},
        description="90 is against the camera, 180 from its right.")] = 240.0
    gust_m_s: Annotated[float, Meta(
        ge=0, le=20, title="Gusts", extra={"unit": "m/s"}, description="As of the rain.")] = 0.4
    turbulence_m_s: Annotated[float, Meta(
        ge=0, le=5, title="Turbulence", extra={"unit": "m/s"}, description="As of the rain.")] = 0.6
    rate_mm_h: Annotated[Annotated[float, Meta(ge=0, le=500)] | None, Meta(
        title="Rate", extra={"unit": "mm/h", "none": "the labeled intensity"},
        description="Estimated rate in front of the camera during these seconds.")] = None
    calibration: Annotated[str, Meta(
        title="Calibration", description="Drop numbers and sizes, as of the rain.")] = "published"
    max_copies: Annotated[int, Meta(
        ge=1, le=16, title="Gaussians a streak", description="As of the rain.")] = 4
    middle_frame: Annotated[Annotated[int, Meta(ge=0)] | None, Meta(
        title="Middle frame", extra={"none": "middle of the sequence"},
        description="Number of the frame around which frames are chosen.")] = None
    # fmt: on

    def rain(self, sensor: str) -> RainSettings:
        """Rain of that rate in that air, in front of a sensor."""
        rate = self.intensity_mm_h if self.rate_mm_h is None else self.rate_mm_h
        return RainSettings(
            intensity_mm_h=min(rate, HEAVIEST_MM_H), calibration=self.calibration, max_copies=self.max_copies,
            wind_speed_m_s=self.wind_speed_m_s,
            wind_from_deg=self.wind_from_deg, gust_m_s=self.gust_m_s, turbulence_m_s=self.turbulence_m_s,
            sensor=sensor,
        )  # fmt: skip


class RealRainConditions(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Differences between the days of a data set, as far as they are known or estimated."""

    sequences: Annotated[tuple[SequenceConditions, ...], Meta(
        title="Sequences", description="Conditions of each sequence, found by its intensity.")]  # fmt: skip

    def of(self, intensity_mm_h: float) -> SequenceConditions:
        """Conditions of a sequence; the defaults if none are known."""
        found = (each for each in self.sequences if abs(each.intensity_mm_h - intensity_mm_h) < 1e-6)
        return next(found, SequenceConditions(intensity_mm_h=intensity_mm_h))


def load_conditions(name: str) -> RealRainConditions:
    """Load shipped conditions by name, or a file by path. Raises `ValueError` with file and field."""
    return load_config(Path(__file__).resolve().parent / "conditions", name, RealRainConditions, "conditions")


# Light and noise of real frames

_BLOCK_PX, _BLOCKS = 8, 11
_NOISE_PASSES, _NOISE_BLUR_PX, _FINE_PX = 2, 15, 15
_NOISE_GAIN = (0.4, 2.5)


def slow_light(values: Float32[np.ndarray, "t h w"]) -> Float32[np.ndarray, "t h w"]:
    """Large-scale part of residuals, by a median over 88 px, which removes streaks: daylight and exposure change."""
    height, width = values.shape[1:]
    small = (max(width // _BLOCK_PX, 1), max(height // _BLOCK_PX, 1))
    slow = np.empty_like(values)
    for k, frame in enumerate(values):
        means = cv2.resize(frame, small, interpolation=cv2.INTER_AREA)
        quarters = np.clip(np.rint(4 * means + 128), 0, 255).astype(np.uint8)
        smooth = (cv2.medianBlur(quarters, _BLOCKS).astype(np.float32) - 128) / 4
        slow[k] = cv2.resize(cv2.GaussianBlur(smooth, (0, 0), 2), (width, height), interpolation=cv2.INTER_LINEAR)
    return slow


def simulated_frames(
    real: MedianResiduals,
    colors: Sequence[UInt8[np.ndarray, "h w 3"]],
    shares: Sequence[Float32[np.ndarray, "h w"]],
    rainfall: RainSimulation,
    drop_levels: Float64[np.ndarray, "3"],
    native_height: int,
) -> list[StoredPhoto]:
    """Render rain over the background of real frames, with their slow changes of light and as much noise as they have.

    `shares` are those of `rain_shares`, `colors` the real frames (RGB), whose median is the background. The sensor's
    noise, and that of its color differences, is scaled from place to place so that noise and rain together deviate
    typically as in the real frames: how much of that is noise is unknown.
    """
    rain, sensor = rainfall.rain, rainfall.picture_sensor
    color = np.median(colors, axis=0).astype(np.float32)
    lit = list(np.clip(color + slow_light(real.values)[..., None], 0, 255))
    rises = [rain_over(*each, drop_levels, rain, sensor) for each in zip(lit, shares, strict=True)]
    black, below = color <= 0, below_black(colors)
    backgrounds = [np.where(black, below, each) for each in lit]
    plain = plain_noise(real, rainfall, native_height)

    def frames() -> list[StoredPhoto]:
        random, noise, factor = noise_of(rain), plain * gain, chroma[..., None]
        return [photographed(*each, noise, sensor, random, factor) for each in zip(backgrounds, rises, strict=True)]

    gain, chroma = np.ones_like(plain), np.ones_like(plain)
    aim, chroma_aim = _fine_deviation(real.values), _chroma_deviation(colors)
    for _ in range(_NOISE_PASSES):
        made = frames()
        luma_change = aim / _fine_deviation(median_residuals(np.stack([each.luma for each in made])).values)
        gain = np.clip(gain * luma_change, *_NOISE_GAIN)
        chroma_change = chroma_aim / _chroma_deviation([each.color for each in made])
        chroma = np.clip(chroma * chroma_change / luma_change, *_NOISE_GAIN)
    return frames()


def plain_noise(real: MedianResiduals, rainfall: RainSimulation, native_height: int) -> Float32[np.ndarray, "h w"]:
    """Deviation of the sensor's noise at the levels of real frames; that of the frames if it has no full well."""
    sensor = rainfall.picture_sensor
    if sensor is None or sensor.full_well_e is None:
        return real.sigma
    return display_noise(sensor, native_height)[real.median]


def _fine_deviation(values: Float32[np.ndarray, "t h w"]) -> Float32[np.ndarray, "h w"]:
    """Typical deviation around each pixel of residuals without what changes over more than some pixels, as daylight."""
    fine = np.stack([np.abs(frame - cv2.blur(frame, (_FINE_PX,) * 2)) for frame in values])
    middle = len(fine) // 2
    return np.maximum(cv2.blur(np.partition(fine, middle, axis=0)[middle], (_NOISE_BLUR_PX,) * 2), np.float32(0.05))


def _chroma_deviation(colors: Sequence[UInt8[np.ndarray, "h w 3"]]) -> Float32[np.ndarray, "h w"]:
    """Typical deviation around each pixel of the color differences: the larger of those of Cr and Cb."""
    values = np.stack([cv2.cvtColor(each, cv2.COLOR_RGB2YCrCb)[..., 1:] for each in colors]).astype(np.float32)
    values -= np.mean(values, axis=0)
    return np.maximum(_fine_deviation(values[..., 0]), _fine_deviation(values[..., 1]))


# Comparison

_SKY_PERCENTILE = 90
_FRAMES_OF_LIGHT = 9
DROP_SHARE = 0.88
"""Light of a drop as a share of that of the sky in the picture: a drop refracts light from up to 82 degrees around the
line of sight, half of it from within 26 degrees, and reflects some. Integrated over the drop with Fresnel's
transmittance, 8 degrees above the horizon, under the CIE's overcast sky over wet ground with 0.25 of its light."""
_MAX_SPACING_S = 0.2


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredFrames:
    """Frames of one sequence and everything measured in them."""

    frames: UInt8[np.ndarray, "t h w"]
    colors: tuple[UInt8[np.ndarray, "h w 3"], ...]
    """The frames in display color (RGB)."""
    found: MedianResiduals
    streaks: StreakTable
    statistics: FrameStatistics
    cloud_levels: Float32[np.ndarray, " t"]
    """Standard deviation of the large-scale part of each frame's residual over the still pixels."""
    deviation_levels: Float32[np.ndarray, " t"]
    """Standard deviation of each frame's residual over the still pixels."""

    @classmethod
    def of(
        cls, frames: UInt8[np.ndarray, "t h w"], found: MedianResiduals, drop_levels: float, exposure_s: float | None,
        light: Float32[np.ndarray, "t h w"] | float = 0.0, colors: Sequence[UInt8[np.ndarray, "h w 3"]] = (),
    ) -> "MeasuredFrames":  # fmt: skip
        """Measure; `light` is a slow change of light that is not rain's."""
        bright, darker = find_streaks(found, drop_levels), find_streaks(found, drop_levels, darker=True)
        statistics = FrameStatistics(
            exposure_s=exposure_s,
            residual=residual_statistics(found),
            streak=streak_statistics(bright, darker, found),
            by_background=tuple(streak_statistics(bright, darker, found, band) for band in BANDS),
        )
        clouds = slow_light((found.values - light).astype(np.float32))[:, found.still].std(axis=1)
        deviation = found.values[:, found.still].std(axis=1)
        return cls(
            frames=frames, colors=tuple(colors), found=found, streaks=bright, statistics=statistics,
            cloud_levels=clouds, deviation_levels=deviation,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RealRainComparison:
    """One real sequence, and simulated rain in front of its background."""

    sequence: str
    labelled_mm_h: float
    """Labeled rain rate of the real sequence."""
    rendered_mm_h: float
    window: Window
    numbers: tuple[int, ...]
    """Frames of the sequence."""
    sky_levels: float
    """Display level of the drops' light: the 90th percentile above the horizon."""
    real: MeasuredFrames
    ours: tuple[MeasuredFrames, ...]
    """One for each exposure."""


def above_horizon(sequence: RainSequence) -> Window:
    """Return the part above the horizon of a level camera's image, without moving reflections of a wet road."""
    camera = sequence.camera
    return 0, 0, camera.width, int(np.clip(camera.cy, 1, camera.height))


def evenly_chosen(sequence: RainSequence, count: int, middle: int | None = None) -> list[int]:
    """Choose frames around one or the middle of a sequence, at most 0.2 s apart: light and wind change slowly."""
    spacing = (sequence.times_s[-1] - sequence.times_s[0]) / max(len(sequence) - 1, 1)
    step = max(min(len(sequence) // count, int(_MAX_SPACING_S / spacing + 0.5)), 1) if spacing > 0 else 1
    number = min(count, len(sequence))
    first = (len(sequence) - (number - 1) * step - 1) // 2
    if middle is not None:
        first = int(np.clip(middle - (number - 1) * step // 2, 0, len(sequence) - (number - 1) * step - 1))
    return [first + k * step for k in range(number)]


def compare_with_real_rain(
    sequence: RainSequence, rain: RainSettings, exposures_s: Sequence[float], numbers: Sequence[int], window: Window
) -> RealRainComparison:  # fmt: skip
    """Measure frames of a sequence, and simulated rain at each exposure in front of their temporal median.

    The simulation uses the sequence's camera, times, background, slow changes of light and noise, without haze, since
    the distance of the background is unknown. Pixels that move in the real frames are excluded from both. Raises
    ValueError for a window outside the image, and as `median_residuals` does.
    """
    x, y, width, height = window
    camera = sequence.camera
    if min(x, y) < 0 or min(width, height) < 32 or x + width > camera.width or y + height > camera.height:
        raise ValueError(
            f"window {x},{y},{width},{height}: must be 32 px or more within {camera.width}x{camera.height}"
        )
    part = (slice(y, y + height), slice(x, x + width))
    pictures = [sequence.gray_image(k) for k in numbers]
    frames = np.stack([picture[part] for picture in pictures])
    colors = [np.ascontiguousarray(sequence.picture(k)[part]) for k in numbers]
    real = median_residuals(frames)
    horizon = above_horizon(sequence)[3]
    sky = sky_levels(picture[:horizon] for picture in pictures)
    drop = light_of_drops(_color_of_light(colors, frames, sky), rain.sensor)
    times = [sequence.times_s[k] for k in numbers]
    light = slow_light(real.values)
    ours: list[MeasuredFrames] = []
    for exposure in exposures_s:
        falling = rain_before(camera, rain, exposure)
        shares = list(rain_shares(cropped_camera(camera, window), falling, times))
        made = simulated_frames(real, colors, shares, falling, drop, camera.height)
        rendered = np.stack([each.luma for each in made])
        found = replace(median_residuals(rendered), still=real.still)
        ours.append(MeasuredFrames.of(rendered, found, sky, exposure, light, [each.color for each in made]))
    return RealRainComparison(
        sequence=sequence.name,
        labelled_mm_h=sequence.intensity_mm_h,
        rendered_mm_h=rain.intensity_mm_h,
        window=window,
        numbers=tuple(numbers),
        sky_levels=sky,
        real=MeasuredFrames.of(frames, real, sky, None, colors=colors),
        ours=tuple(ours),
    )


def light_of_drops(sky: Float64[np.ndarray, "3"], sensor: str | None) -> Float64[np.ndarray, "3"]:
    """Display color of a drop in an open place, from that of the sky in the picture: DROP_SHARE of its light."""
    curve = "srgb" if sensor is None else load_sensor(sensor).tone_curve
    return 255 * tone_curve(DROP_SHARE * light_of_display(sky / 255, curve), curve)


def rain_before(camera: Camera, rain: RainSettings, exposure_s: float | None) -> RainSimulation:
    """Start rain at an exposure, without haze, whose lens is that of a whole image: its windows have the same one."""
    falling = RainSimulation.start(msgspec.structs.replace(rain, exposure_s=exposure_s, haze="none"))
    lens = falling.lens(camera)
    fixed = {"aperture_mm": 1e3 * lens.aperture_m, "focus_distance_m": lens.focus_m}
    return falling.changed(msgspec.structs.replace(falling.rain, **fixed), 0.0)


def sky_levels(grays: Iterable[UInt8[np.ndarray, "h w"]]) -> float:
    """Gray level at which the brightest tenth above the horizon begins, the median of frames."""
    return float(np.median([np.percentile(gray, _SKY_PERCENTILE) for gray in grays]))


def drop_levels(
    sequence: RainSequence, numbers: Sequence[int], rain: RainSettings, window: Window
) -> Float32[np.ndarray, "h w 3"]:
    """Display color (gray levels) of drops before each pixel of a window: see `light_before`."""
    some = numbers[:: max(len(numbers) // _FRAMES_OF_LIGHT, 1)]
    pictures, horizon = [sequence.picture(k) for k in some], above_horizon(sequence)[3]
    grays = np.stack([sequence.gray_image(k)[:horizon] for k in some])
    sky = _color_of_light([each[:horizon] for each in pictures], grays, sky_levels(grays))
    median = np.median(pictures, axis=0).astype(np.float32)
    curve = "srgb" if rain.sensor is None else load_sensor(rain.sensor).tone_curve
    x, y, width, height = window
    return light_before(median, sky, sequence.camera, curve)[y : y + height, x : x + width]


def _color_of_light(
    colors: Sequence[UInt8[np.ndarray, "h w 3"]], lumas: UInt8[np.ndarray, "t h w"], levels: float
) -> Float64[np.ndarray, "3"]:
    """Return the median color of the pixels within 4 gray levels of a luma, moved to it; gray if there is none."""
    pairs = zip(colors, lumas.astype(np.float32), strict=True)
    found = np.concatenate([color[np.abs(luma - levels) < 4] for color, luma in pairs])
    if not len(found):
        return np.full(3, levels)
    color = np.median(found, axis=0)
    return np.clip(color + levels - color @ np.array([0.299, 0.587, 0.114]), 0, 255)
