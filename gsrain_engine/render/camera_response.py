"""From a rendered picture to the one that a camera stores: gain, noise, tone curve and JPEG."""

import zlib
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, no_type_check

import lazy_loader
import numpy as np
from jaxtyping import Float32, Float64, UInt8
from scipy.special import ndtri

from ..kernels import kernel, range_of
from ..rain.pcg_hash import pcg4d_scalar
from ..scene.camera import Camera
from ..scene.geometry import LUMINANCE, linear_to_srgb, srgb_to_linear
from ..scene.sensor import Sensor
from .signal_processing import processed, with_chroma_noise

cv2: Any = lazy_loader.load("cv2")  # only pictures of a sensor with JPEG need it

MAX_GAIN = 4.0
"""Upper bound of the gain of automatic exposure, and its inverse the lower one."""

CRUSH, GLARE = 0.25, 0.006
"""Constants of the tone curve `crushed`: the display value at which it has fallen to about half, and the veiling glare,
light that the lens spreads over the picture, as a share of white, which is shown as black. Fitted to the rise of
RainSense's streaks before backgrounds of gray 0 to 16 and 32 to 64 (docs/real_rain_method.md)."""

_NORMALS, _TONES = 1 << 12, 1 << 14  # entries of the tables of normal deviates and of the tone curve


@dataclass(frozen=True, slots=True, eq=False)
class CameraResponse:
    """Response of a sensor at one time. The noise is a function of seed, time and camera: rain does not change it."""

    sensor: Sensor
    camera: Camera
    time_s: float
    seed: int = 0
    exposure_gain: float = 1.0
    """Gain of automatic exposure, see `metered_gain`."""

    def picture(self, image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
        """Return the picture that the camera stores of a rendered one (sRGB).

        Linear light of 1, white, is full well over gain in electrons; noise is that of shot and readout (Gaussian, with
        the variance of Poisson's law: Foi et al. 2008). A pixel of a smaller picture than the sensor's is the mean of
        several of the sensor's, each with its own noise. Then come exposure gain, clipping, tone curve, signal
        processing and JPEG. Pixels and channels have noise of their own; a color filter array is simulated by the blur
        of its interpolation.
        """
        sensor = self.sensor
        light = srgb_to_linear(np.arange(256) / 255)
        sigma = light_noise(light, sensor, image.shape[0])
        scale = self.exposure_gain * (_TONES - 1)
        made = np.empty_like(image)
        _expose(
            np.ascontiguousarray(image), (scale * light).astype(np.float32), (scale * sigma).astype(np.float32),
            _normal_deviates(), _tone_table(sensor.tone_curve), *self._key(), made,
        )  # fmt: skip
        if sensor.processes_signal:
            clean = _tone_table(sensor.tone_curve)[np.clip(scale * light + 0.5, 0, _TONES - 1).astype(int)][image]
            noise = with_chroma_noise(made.astype(np.float32) - clean, sensor.chroma_noise)
            levels = display_noise(sensor, image.shape[0], self.exposure_gain)[cv2.cvtColor(clean, cv2.COLOR_RGB2GRAY)]
            made = to_levels(processed(clean + noise, levels, sensor))
        return made if sensor.jpeg_quality is None else _compressed(made, sensor.jpeg_quality)

    def _key(self) -> tuple[np.uint32, np.uint32, np.uint32]:
        """Hash key of the noise: seed, time and camera."""
        moment = zlib.crc32(np.float64(self.time_s).tobytes())
        camera = zlib.crc32(np.ascontiguousarray(self.camera.world_to_camera, np.float64).tobytes())
        return np.uint32(self.seed & 0xFFFFFFFF), np.uint32(moment), np.uint32(camera)


def metered_gain(image: UInt8[np.ndarray, "h w 3"], sensor: Sensor) -> float:
    """Gain that leads the mean luminance of a picture without rain to the sensor's mean gray; 1 without one."""
    if sensor.mean_gray is None:
        return 1.0
    luminance = float(_linear_levels()[image].mean(axis=(0, 1)) @ LUMINANCE)
    target = float(srgb_to_linear(np.array(sensor.mean_gray / 255)))
    return float(np.clip(target / max(luminance, 1e-6), 1 / MAX_GAIN, MAX_GAIN))


def light_noise(light: Float64[np.ndarray, " n"], sensor: Sensor, height: int) -> Float64[np.ndarray, " n"]:
    """Standard deviation of the noise of linear light 0..1 in a picture with so many rows, before any gain."""
    if sensor.full_well_e is None:
        return np.zeros_like(light)
    white_e = sensor.full_well_e / sensor.gain
    glare = GLARE if sensor.tone_curve == "crushed" else 0.0
    binned = max(sensor.size_px[1] / height, 1.0)  # native pixels along each side of a pixel
    return np.sqrt((light + glare) * white_e + sensor.read_noise_e**2) / (binned * white_e)


def display_noise(sensor: Sensor, height: int, exposure_gain: float = 1.0) -> Float32[np.ndarray, "256"]:
    """Standard deviation, in gray levels, of the noise of each gray level before signal processing."""
    light = light_of_display(np.arange(256) / 255, sensor.tone_curve)
    sigma = exposure_gain * light_noise(light / exposure_gain, sensor, height)
    # The slope of the tone curve over the range that the noise fills.
    spread = np.maximum(sigma, 1e-6)
    brighter, darker = (tone_curve(np.clip(light + sign * spread, 0, 1), sensor.tone_curve) for sign in (1, -1))
    return (255 * sigma * (brighter - darker) / (2 * spread)).astype(np.float32)


def to_levels(picture: Float32[np.ndarray, "..."]) -> UInt8[np.ndarray, "..."]:
    """Round to gray levels."""
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def tone_curve(light: np.ndarray, name: str) -> np.ndarray:
    """Display value 0..1 of linear light L 0..1: y(L) by sRGB's curve.

    `crushed` adds veiling glare g = `GLARE` and subtracts its display value as black: e = (y(L + g (1 - L)) - y(g)) /
    (1 - y(g)). Its value is e^2 (1 + k) / (e + k), k = `CRUSH`.
    """
    if name == "srgb":
        return linear_to_srgb(light)
    black = float(linear_to_srgb(np.array([GLARE]))[0])
    display = (linear_to_srgb(light + GLARE * (1 - light)) - black) / (1 - black)
    return display**2 * (1 + CRUSH) / (display + CRUSH)


def light_of_display(display: Float64[np.ndarray, "*n"], name: str) -> Float64[np.ndarray, "*n"]:
    """Linear light 0..1 of display values 0..1 by the inverse of `tone_curve`."""
    light = srgb_to_linear(np.linspace(0, 1, 1 << 12))
    return np.interp(display, tone_curve(light, name), light)


@cache
def _linear_levels() -> Float32[np.ndarray, "256"]:
    return srgb_to_linear(np.arange(256) / 255).astype(np.float32)


@cache
def _normal_deviates() -> Float32[np.ndarray, " n"]:
    """Equally likely deviates of a normal law, with a variance of exactly 1."""
    deviates = ndtri((np.arange(_NORMALS) + 0.5) / _NORMALS)
    return (deviates / deviates.std()).astype(np.float32)


@lru_cache(maxsize=4)
def _tone_table(name: str) -> UInt8[np.ndarray, " n"]:
    return np.rint(255 * tone_curve(np.arange(_TONES) / (_TONES - 1), name)).astype(np.uint8)


@kernel(parallel=True)
@no_type_check
def _expose(portion, image, means, sigmas, normals, tones, seed, moment, camera, made):
    """Add noise to each channel, clip, and apply the tone curve; all tables are in units of the tone table's index."""
    height, width = image.shape[0], image.shape[1]
    top, shift = len(tones) - 1, np.uint32(20)
    for y in range_of(portion, height):
        for x in range(width):
            red, green, blue, _ = pcg4d_scalar(np.uint32(y * width + x), seed, moment, camera)
            for channel in range(3):
                bits = red if channel == 0 else green if channel == 1 else blue
                level = image[y, x, channel]
                value = means[level] + sigmas[level] * normals[bits >> shift]
                made[y, x, channel] = tones[min(max(int(value + np.float32(0.5)), 0), top)]


def _compressed(image: UInt8[np.ndarray, "h w 3"], quality: int) -> UInt8[np.ndarray, "h w 3"]:
    """Compress as JPEG with halved chroma, and decompress."""
    return np.ascontiguousarray(cv2.imdecode(jpeg_of(image, quality), cv2.IMREAD_COLOR)[..., ::-1])


def jpeg_of(image: UInt8[np.ndarray, "h w 3"], quality: int) -> UInt8[np.ndarray, " n"]:
    """Return a picture as the bytes of a JPEG file with halved chroma."""
    options = [
        cv2.IMWRITE_JPEG_QUALITY,
        quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
    ]
    return cv2.imencode(".jpg", image[..., ::-1], options)[1]


def stored_jpeg(gray: UInt8[np.ndarray, "h w"], quality: int) -> UInt8[np.ndarray, "h w"]:
    """Compress the luma of a picture as JPEG, and decompress."""
    _, data = cv2.imencode(".jpg", gray, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
