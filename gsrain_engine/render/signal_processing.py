"""Signal processing inside of a camera: demosaicing, noise reduction and sharpening."""

from typing import Any

import lazy_loader
import numpy as np
from jaxtyping import Float32

from ..scene.sensor import Sensor

cv2: Any = lazy_loader.load("cv2")  # only sensors with signal processing need it

_TO_YCC = np.array([[0.299, 0.587, 0.114], [0.5, -0.4187, -0.0813], [-0.1687, -0.3313, 0.5]], np.float32)
"""RGB to luma, Cr and Cb (JFIF)."""
_TO_RGB = np.linalg.inv(_TO_YCC.astype(np.float64)).astype(np.float32)
_LUMA_OF_NOISE = float(np.sqrt((_TO_YCC[0] ** 2).sum()))  # of three channels with independent noise of 1
_SHARPENING_PX = 1.0
_EVEN_CHROMA = 2.1  # color differences of even surfaces are blurred so many times as far as those of details


def processed(
    signal: Float32[np.ndarray, "h w 3"],
    noise_levels: Float32[np.ndarray, "h w"],
    sensor: Sensor,
    behind: Float32[np.ndarray, "h w 3"] | None = None,
) -> Float32[np.ndarray, "h w 3"]:
    """Return display colors (gray levels) as they leave the signal processing of a sensor.

    `noise_levels` is the standard deviation of the noise of each channel, independent from pixel to pixel, that the
    signal contains. Everything is blurred by demosaicing. Then luma is reduced to its local mean m where its local
    variance v is that of noise, s^2, and left where there is more detail: m + A (x - m), A = max(v - k s^2, 0) / v, k
    the strength (Lee 1980), and sharpened by an unsharp mask. Color differences are blurred. `behind` is a picture
    that has been through a camera: it adds to the details, but only the signal that lies over it is processed.
    """
    y, *chroma = cv2.split(cv2.transform(signal, _TO_YCC))
    spread = noise_levels * np.float32(_LUMA_OF_NOISE)
    if sensor.demosaic_px > 0:
        kernel = blur_kernel(sensor.demosaic_px)
        y = cv2.sepFilter2D(y, -1, kernel, kernel)
        spread = spread * np.float32((kernel**2).sum())
    details = np.ones_like(y)
    if sensor.noise_reduction > 0:
        total = y if behind is None else y + cv2.transform(behind, _TO_YCC[:1])
        details = _details(total, spread, sensor)
        y = _where_even(y, details, _blurred(y, *(sensor.noise_reduction_px,) * 2))
    if sensor.sharpening > 0:
        y = y + np.float32(sensor.sharpening) * (y - _blurred(y, _SHARPENING_PX, _SHARPENING_PX))
    across, down = sensor.chroma_blur_px
    if across > 0 and down > 0:
        even = [_blurred(each, _EVEN_CHROMA * across, _EVEN_CHROMA * down) for each in chroma]
        sharp = [_blurred(each, across, down) for each in chroma]
        chroma = [_where_even(one, details, other) for one, other in zip(sharp, even, strict=True)]
    made = cv2.transform(cv2.merge([y, *chroma]), _TO_RGB)
    return made if behind is None else behind + made


def with_chroma_noise(
    noise: Float32[np.ndarray, "h w 3"], factor: float | Float32[np.ndarray, "h w 1"]
) -> Float32[np.ndarray, "h w 3"]:
    """Return noise (RGB) whose color differences are amplified, at equal luma."""
    luma = cv2.transform(noise, _TO_YCC[:1])[..., None]
    return luma + np.asarray(factor, np.float32) * (noise - luma)


def _details(
    luma: Float32[np.ndarray, "h w"], spread: Float32[np.ndarray, "h w"], sensor: Sensor
) -> Float32[np.ndarray, "h w"]:
    """Share of detail in the local variance, 0 to 1."""
    radius = sensor.noise_reduction_px
    level = luma - np.float32(luma.mean())  # for the precision of the squares
    mean = _blurred(level, radius, radius)
    variance = np.maximum(_blurred(level * level, radius, radius) - mean * mean, np.float32(1e-3))
    return np.clip(1 - np.float32(sensor.noise_reduction) * spread * spread / variance, 0, 1)


def _where_even(
    values: Float32[np.ndarray, "h w"], details: Float32[np.ndarray, "h w"], smooth: Float32[np.ndarray, "h w"]
) -> Float32[np.ndarray, "h w"]:
    return smooth + details * (values - smooth)


def _blurred(values: Float32[np.ndarray, "h w"], across_px: float, down_px: float) -> Float32[np.ndarray, "h w"]:
    return cv2.sepFilter2D(values, -1, blur_kernel(across_px), blur_kernel(down_px))


def blur_kernel(sigma_px: float) -> Float32[np.ndarray, "k 1"]:
    """Gaussian of a standard deviation, to three of them."""
    return cv2.getGaussianKernel(2 * int(np.ceil(3 * sigma_px)) + 1, sigma_px, cv2.CV_32F)
