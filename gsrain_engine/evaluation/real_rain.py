"""Real rain in frames of a static camera, and simulated rain in front of the same background, with the same noise."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import cv2
import msgspec
import numpy as np
from jaxtyping import Float32, UInt8
from msgspec import Meta

from ..datasets.rainsense import RainSequence
from ..presets import load_config
from ..rain.frame import SkyLight
from ..rain.settings import HEAVIEST_MM_H, RainSettings
from ..rain.simulation import RainSimulation
from ..render.camera_response import light_of_display, stored_jpeg, tone_curve
from ..render.cpu.renderer import CpuRenderer
from ..render.draw import RenderView, rain_camera
from ..scene.camera import Camera
from ..scene.scene import Scene
from ..scene.sensor import Sensor
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

Window = tuple[int, int, int, int]  # left, top, width, height of a part of an image, in pixels
_NO_SCENE = Scene("no scene", (), up=(0.0, 0.0, 1.0))


# Conditions of real sequences
# YAML files; docs/real_rain_method.md says how those of RainSense were estimated.


class SequenceConditions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Air and camera of one real sequence, as far as they differ from the defaults. The camera looks along +x, east."""

    # fmt: off
    intensity_mm_h: Annotated[float, Meta(
        ge=0, le=500, title="Intensity", extra={"unit": "mm/h"},
        description="Labeled intensity of the sequence that is meant.")]
    shutter_s: Annotated[float | None, Meta(
        title="Shutter", extra={"unit": "s", "none": "the sensor's", "ge": 1e-5, "le": 1.0},
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
    middle_frame: Annotated[int | None, Meta(
        title="Middle frame", extra={"none": "middle of the sequence", "ge": 0},
        description="Number of the frame around which frames are chosen.")] = None
    # fmt: on

    def __post_init__(self) -> None:
        if self.shutter_s is not None and not 1e-5 <= self.shutter_s <= 1:
            raise ValueError(f"shutter_s must be within 0.00001..1 s, got {self.shutter_s}")
        if self.middle_frame is not None and self.middle_frame < 0:
            raise ValueError(f"middle_frame must be 0 or more, got {self.middle_frame}")

    def rain(self, sensor: str) -> RainSettings:
        """Rain of that intensity in that air, in front of a sensor."""
        return RainSettings(
            intensity_mm_h=min(self.intensity_mm_h, HEAVIEST_MM_H), wind_speed_m_s=self.wind_speed_m_s,
            wind_from_deg=self.wind_from_deg, gust_m_s=self.gust_m_s, turbulence_m_s=self.turbulence_m_s,
            sensor=sensor,
        )  # fmt: skip


class RealRainConditions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Differences between the days of a data set, as far as they are known or estimated."""

    sequences: Annotated[tuple[SequenceConditions, ...], Meta(
        title="Sequences", description="Conditions of each sequence, found by its intensity.")]  # fmt: skip

    def of(self, intensity_mm_h: float) -> SequenceConditions:
        """Conditions of a sequence; the defaults if none are known."""
        found = (each for each in self.sequences if abs(each.intensity_mm_h - intensity_mm_h) < 1e-6)
        return next(found, SequenceConditions(intensity_mm_h=intensity_mm_h))


def load_conditions(name: str) -> RealRainConditions:
    """Load shipped conditions by name, or a file by path. Raises `ValueError` with file and field."""
    return load_config("real_rain", name, RealRainConditions, "conditions")


# Simulated rain in front of a photograph


def cropped_camera(camera: Camera, window: Window) -> Camera:
    """Return the camera of a window of this one's image."""
    x, y, width, height = window
    return replace(camera, cx=camera.cx - x, cy=camera.cy - y, width=width, height=height)


def rain_shares(
    camera: Camera, rainfall: RainSimulation, times_s: Sequence[float]
) -> Iterator[Float32[np.ndarray, "h w"]]:
    """Render the rain's share of each pixel at each time, as the renderer composites it: 0 without rain."""
    renderer = CpuRenderer()
    for time_s in times_s:
        shot = RenderView(camera, time_s=float(time_s))
        view = rain_camera(_NO_SCENE, rainfall, shot)
        renderer.draw([], camera, rainfall.frame(shot.time_s, view, SkyLight.uniform((1.0, 1.0, 1.0))))
        yield renderer.read().rgba[..., 3].copy()


@dataclass(frozen=True, slots=True, eq=False)
class CameraNoise:
    """Noise of a camera in gray levels: white noise, blurred by demosaicing and noise reduction to `correlation_px`."""

    sigma: Float32[np.ndarray, "h w"]
    correlation_px: float = 0.0
    """Standard deviation of the Gaussian blur; 0 is white."""

    def drawn(self, random: np.random.Generator) -> Float32[np.ndarray, "h w"]:
        """Draw the noise of a frame."""
        white = random.standard_normal(self.sigma.shape, np.float32)
        if self.correlation_px > 0:
            kernel = _blur_kernel(self.correlation_px)
            white = cv2.sepFilter2D(white, -1, kernel, kernel) / np.float32((kernel**2).sum())
        return self.sigma * white


def _blur_kernel(sigma_px: float) -> Float32[np.ndarray, "k 1"]:
    return cv2.getGaussianKernel(2 * int(np.ceil(3 * sigma_px)) + 1, sigma_px, cv2.CV_32F)


def photographed(
    backgrounds: Sequence[Float32[np.ndarray, "h w"]],
    shares: Sequence[Float32[np.ndarray, "h w"]],
    drop_levels: float,
    noise: CameraNoise,
    rain: RainSettings,
    sensor: Sensor | None,
) -> Iterator[UInt8[np.ndarray, "h w"]]:
    """Composite rain and photographed backgrounds (gray levels) as a camera stores them.

    `drop_levels` is a drop's display level (0-255). With W the rain's share of a pixel, B the background and S the
    drop's light: enc((1 - W) dec(B) + W S), with the tone curve of the sensor; or a mix of display values, as set in
    the rain. Then noise, seeded by the rain's seed, rounding to gray levels, and the sensor's JPEG.
    """
    curve = "srgb" if sensor is None else sensor.tone_curve
    levels = np.linspace(0, 1, 1 << 12)
    if rain.rain_light == "linear":
        behind = light_of_display(levels, curve).astype(np.float32)
        light = float(light_of_display(np.array([drop_levels / 255]), curve)[0])
        shown = (255 * tone_curve(np.linspace(0, 1, 1 << 15), curve)).astype(np.float32)
    else:
        behind, light = levels.astype(np.float32), drop_levels / 255
        shown = np.linspace(0, 255, 1 << 15, dtype=np.float32)
    random = np.random.default_rng(rain.seed)
    for background, share in zip(backgrounds, shares, strict=True):
        before = behind[np.rint(np.clip(background / 255, 0, 1) * (len(behind) - 1)).astype(np.int32)]
        after = before + share * (light - before)
        steps = [np.rint(np.clip(each, 0, 1) * (len(shown) - 1)).astype(np.int32) for each in (before, after)]
        levels_now = background + shown[steps[1]] - shown[steps[0]] + noise.drawn(random)
        gray = np.clip(np.rint(levels_now), 0, 255).astype(np.uint8)
        yield gray if sensor is None or sensor.jpeg_quality is None else stored_jpeg(gray, sensor.jpeg_quality)


def render_rain_frames(
    background: UInt8[np.ndarray, "h w"],
    noise_levels: Float32[np.ndarray, "h w"],
    camera: Camera,
    rainfall: RainSimulation,
    times_s: Sequence[float],
    drop_levels: float,
) -> Iterator[UInt8[np.ndarray, "h w"]]:
    """Render gray frames of a static camera (world: meters, z up) with a background behind all rain and white noise.

    See `photographed`; tone curve and JPEG are those of a sensor that the rain names.
    """
    behind, noise = background.astype(np.float32), CameraNoise(noise_levels)
    shares = list(rain_shares(camera, rainfall, times_s))
    yield from photographed([behind] * len(shares), shares, drop_levels, noise, rainfall.rain, rainfall.picture_sensor)


# Light and noise of real frames

_BLOCK_PX, _BLOCKS = 8, 11
_BRIGHT_LEVELS = 96  # before brighter backgrounds rain is hardly visible: what changes there is noise
_BLURS_PX = np.linspace(0.25, 2.0, 36)
_NOISE_PASSES, _NOISE_BLUR_PX = 2, 31
_LEAST_NOISE, _MOST_NOISE = 0.3, 2.0


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


def noise_correlation_px(found: MedianResiduals, slow: Float32[np.ndarray, "t h w"]) -> float:
    """Blur of the noise (standard deviation of a Gaussian in px), by the correlation of neighbors in a row.

    Measured before bright backgrounds; 0 where there are none.
    """
    usable = found.still & (found.median >= _BRIGHT_LEVELS)
    pairs = usable[:, 1:] & usable[:, :-1]
    if pairs.sum() < 100:
        return 0.0
    noise = np.clip((found.values - slow) / found.sigma, -3, 3)
    r = float((noise[:, :, 1:] * noise[:, :, :-1])[:, pairs].mean() / (noise[:, usable] ** 2).mean())
    kernels = [_blur_kernel(float(each)) for each in _BLURS_PX]
    correlations = [float((kernel[1:] * kernel[:-1]).sum() / (kernel**2).sum()) for kernel in kernels]
    return float(np.interp(r, [0.0, *correlations], [0.0, *_BLURS_PX]))


def simulated_frames(
    real: MedianResiduals, camera: Camera, rainfall: RainSimulation, times_s: Sequence[float], drop_levels: float
) -> UInt8[np.ndarray, "t h w"]:
    """Render rain over the background of real frames, with their slow changes of light and as much noise as they have.

    The noise is scaled so that noise and rain together deviate typically as in the real frames (`sigma`): how much of
    that is noise is unknown.
    """
    slow = slow_light(real.values)
    backgrounds = list(np.clip(real.median + slow, 0, 255))
    shares = list(rain_shares(camera, rainfall, times_s))
    correlation_px = noise_correlation_px(real, slow)
    square = (_NOISE_BLUR_PX,) * 2
    aim, sigma = cv2.blur(real.sigma, square), real.sigma
    rain, sensor = rainfall.rain, rainfall.picture_sensor

    def frames() -> UInt8[np.ndarray, "t h w"]:
        noise = CameraNoise(sigma, correlation_px)
        return np.stack(list(photographed(backgrounds, shares, drop_levels, noise, rain, sensor)))

    for _ in range(_NOISE_PASSES):
        excess = cv2.blur(median_residuals(frames()).sigma, square) ** 2 - aim**2
        low, high = ((factor * real.sigma) ** 2 for factor in (_LEAST_NOISE, _MOST_NOISE))
        sigma = np.sqrt(np.clip(sigma**2 - excess, low, high)).astype(np.float32)
    return frames()


# Comparison

_SKY_PERCENTILE = 90
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
        light: Float32[np.ndarray, "t h w"] | float = 0.0,
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
            frames=frames, found=found, streaks=bright, statistics=statistics, cloud_levels=clouds,
            deviation_levels=deviation,
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
) -> RealRainComparison:
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
    pictures = [sequence.gray_image(k) for k in numbers]
    frames = np.stack([picture[y : y + height, x : x + width] for picture in pictures])
    real = median_residuals(frames)
    horizon = above_horizon(sequence)[3]
    sky = float(np.median([np.percentile(picture[:horizon], _SKY_PERCENTILE) for picture in pictures]))
    times = [sequence.times_s[k] for k in numbers]
    light = slow_light(real.values)
    ours: list[MeasuredFrames] = []
    for exposure in exposures_s:
        falling = RainSimulation.start(msgspec.structs.replace(rain, exposure_s=exposure, haze="none"))
        lens = falling.lens(camera)  # of the whole image: the window has the same lens
        fixed = {"aperture_mm": 1e3 * lens.aperture_m, "focus_distance_m": lens.focus_m}
        falling = falling.changed(msgspec.structs.replace(falling.rain, **fixed), 0.0)
        rendered = simulated_frames(real, cropped_camera(camera, window), falling, times, sky)
        found = replace(median_residuals(rendered), still=real.still)
        ours.append(MeasuredFrames.of(rendered, found, sky, exposure, light))
    return RealRainComparison(
        sequence=sequence.name,
        labelled_mm_h=sequence.intensity_mm_h,
        rendered_mm_h=rain.intensity_mm_h,
        window=window,
        numbers=tuple(numbers),
        sky_levels=sky,
        real=MeasuredFrames.of(frames, real, sky, None),
        ours=tuple(ours),
    )
