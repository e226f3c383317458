"""Noise of a real camera by place: strength and correlation, and the sensor that makes the same."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import msgspec
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8
from scipy.optimize import minimize

from gsrain_engine.render.camera_response import display_noise
from gsrain_engine.scene.sensor import Sensor

from .photograph import photographed
from .streaks import LIMIT_OF_NOISE_LEVELS, median_residuals

LUMA_LAGS = ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0), (0, 3), (3, 0), (0, 4), (4, 0))
CHROMA_LAGS = ((0, 1), (1, 0), (0, 2), (2, 0), (0, 3), (3, 0))
"""Distances (down, across) in px of the pixels whose correlation is compared."""

_LEVEL_EDGES = (2, 16, 32, 64, 96, 140, 190, 240)
_DEVIATION_EDGES = (0.4, 0.9, 1.3, 1.7, 2.2, 2.7, 3.2)
MIN_PIXELS = 2500
"""Smaller classes are left out."""
_CLIP_LEVELS, _CLIP_CHROMA = 10.0, 7.0  # rare changes are no noise
_SIMULATED = 2
_WEIGHTS = np.array([1.0, *[1.0] * 5, *[0.6] * 4, 1.0, 1.0, *[0.5] * 6])


@dataclass(frozen=True, slots=True, eq=False)
class NoiseClass:
    """Pixels with similar gray levels and similar typical deviation over time, and statistics of their noise."""

    pixels: Bool[np.ndarray, "h w"]
    levels: tuple[float, float]
    deviation: tuple[float, float]
    real: Float64[np.ndarray, " k"]
    """Logarithms of deviations and correlations, see `noise_statistics`."""


def noise_statistics(
    residuals: Float32[np.ndarray, "t h w 3"], pixels: Bool[np.ndarray, "h w"]
) -> Float64[np.ndarray, " k"]:
    """Return logarithms of deviations, and correlations, of residuals of luma, Cr and Cb.

    In this order: deviation of luma, its correlations at LUMA_LAGS, deviations of Cr and Cb, and correlations of Cr at
    CHROMA_LAGS.
    """
    y = np.clip(residuals[..., 0], -_CLIP_LEVELS, _CLIP_LEVELS)
    chroma = np.clip(residuals[..., 1:], -_CLIP_CHROMA, _CLIP_CHROMA)
    deviations = [
        0.5 * np.log((values[:, pixels] ** 2).mean() + 1e-6) for values in (y, chroma[..., 0], chroma[..., 1])
    ]
    luma = [_correlation(y, pixels, lag) for lag in LUMA_LAGS]
    return np.array(
        [deviations[0], *luma, *deviations[1:], *(_correlation(chroma[..., 0], pixels, lag) for lag in CHROMA_LAGS)]
    )


def _correlation(values: Float32[np.ndarray, "t h w"], pixels: Bool[np.ndarray, "h w"], lag: tuple[int, int]) -> float:
    """Correlation of pixels at a distance from one another, both of the class."""
    down, across = lag
    height, width = pixels.shape
    rows, columns = np.nonzero(pixels[: height - down, : width - across] & pixels[down:, across:])
    products = values[:, rows, columns] * values[:, rows + down, columns + across]
    return float(products.mean() / ((values[:, pixels] ** 2).mean() + 1e-6))


def _luma_and_chroma(colors: Sequence[UInt8[np.ndarray, "h w 3"]]) -> Float32[np.ndarray, "t h w 3"]:
    return np.stack([cv2.cvtColor(each, cv2.COLOR_RGB2YCrCb) for each in colors]).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class CameraNoise:
    """Noise of a static camera in frames without rain, by classes of pixels."""

    color: Float32[np.ndarray, "h w 3"]
    """Background, the median over time."""
    luma: Float32[np.ndarray, "h w 3"]
    """The same as luma, Cr and Cb."""
    classes: tuple[NoiseClass, ...]

    @classmethod
    def of(cls, colors: Sequence[UInt8[np.ndarray, "h w 3"]]) -> "CameraNoise":
        """Measure frames without rain (RGB); raises ValueError if hardly anything stands still."""
        found = median_residuals(np.stack([cv2.cvtColor(each, cv2.COLOR_RGB2GRAY) for each in colors]))
        values = _luma_and_chroma(colors)
        middle = np.median(values, axis=0)
        residuals = values - middle
        residuals[..., 0] -= np.median(residuals[..., 0].reshape(len(values), -1), axis=1)[:, None, None]
        square = np.clip(residuals[..., 0], -_CLIP_LEVELS, _CLIP_LEVELS) ** 2
        deviation = np.sqrt(cv2.blur(square.mean(axis=0), (7, 7)))
        still = cv2.erode(((deviation < LIMIT_OF_NOISE_LEVELS) & found.still).astype(np.uint8), np.ones((7, 7))) > 0
        level = cv2.blur(middle[..., 0], (7, 7))
        classes: list[NoiseClass] = []
        for low, high in pairwise(_LEVEL_EDGES):
            for least, largest in pairwise(_DEVIATION_EDGES):
                pixels = still & (level >= low) & (level < high) & (deviation >= least) & (deviation < largest)
                if np.count_nonzero(pixels) >= MIN_PIXELS:
                    real = noise_statistics(residuals, pixels)
                    classes.append(NoiseClass(pixels, (low, high), (least, largest), real))
        if not classes:
            raise ValueError("hardly any pixel stands still in these frames: choose others")
        return cls(np.median(colors, axis=0).astype(np.float32), middle, tuple(classes))

    def simulated(self, sensor: Sensor, native_height: int, frames: int = _SIMULATED) -> Float64[np.ndarray, "c k"]:
        """Return the statistics of each class for a sensor's noise before the same background."""
        random = np.random.default_rng(0)
        levels = np.clip(np.rint(self.luma[..., 0]), 0, 255).astype(np.uint8)
        noise = display_noise(sensor, native_height)[levels]
        still = np.zeros_like(self.color)
        made = [photographed(self.color, still, noise, sensor, random).color for _ in range(frames)]
        residuals = _luma_and_chroma(made) - self.luma
        return np.array([noise_statistics(residuals, each.pixels) for each in self.classes])

    def difference(self, sensor: Sensor, native_height: int) -> float:
        """Mean squared difference of the statistics, larger classes counting by the root of their pixels."""
        shares = np.sqrt([np.count_nonzero(each.pixels) for each in self.classes])
        apart = self.simulated(sensor, native_height) - np.array([each.real for each in self.classes])
        return float((shares[:, None] / shares.sum() * (_WEIGHTS * apart) ** 2).sum())


FITTED = (
    "gain", "read_noise_e", "demosaic_px", "noise_reduction", "noise_reduction_px", "sharpening", "chroma_noise",
    "chroma_blur_px",
)  # fmt: skip
"""Fields of a sensor that are fitted to its noise."""

FIT_TRIALS = 150
_LOW = np.array([1.0, 0.01, 0.01, 0.01, 0.3, 0.01, 0.1, 0.2, 0.2])
_HIGH = np.array([256.0, 1000.0, 4.0, 16.0, 8.0, 4.0, 8.0, 8.0, 8.0])
_STEP = 0.35  # of the logarithms: the first trials differ by a factor of 1.4


def fitted_sensor(
    noise: CameraNoise, sensor: Sensor, native_height: int, advance: Callable[[], object], trials: int
) -> Sensor:
    """Return the sensor with the FITTED fields whose noise is most like that of a real camera (Nelder and Mead 1965).

    The search begins with the fields of the given sensor. `advance` is called after each trial.
    """

    def of(logarithms: Float64[np.ndarray, " n"]) -> Sensor:
        values = [round(float(each), 3) for each in np.clip(np.exp(logarithms), _LOW, _HIGH)]
        fields = dict(zip(FITTED[:-1], values[:-2], strict=True))
        return msgspec.structs.replace(sensor, **fields, chroma_blur_px=(values[-2], values[-1]))

    def difference(logarithms: Float64[np.ndarray, " n"]) -> float:
        beyond = np.abs(logarithms - np.clip(logarithms, np.log(_LOW), np.log(_HIGH))).sum()
        value = noise.difference(of(logarithms), native_height) + float(beyond)
        advance()
        return value

    own = np.array([*(getattr(sensor, name) for name in FITTED[:-1]), *sensor.chroma_blur_px])
    start = np.log(np.clip(own, np.maximum(_LOW, 0.1), _HIGH))
    simplex = np.vstack([start, start + _STEP * np.eye(len(start))])
    options = {"maxfev": trials, "initial_simplex": simplex, "xatol": 0.01, "fatol": 1e-4}
    return of(minimize(difference, start, method="Nelder-Mead", options=options).x)
