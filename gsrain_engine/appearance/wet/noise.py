"""Smooth noise that repeats, as a function of place: the same wherever it is seen from."""

from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, Float32

_SIZE = 512


class SmoothNoise:
    """Gaussian noise of mean 0 and variance 1 whose power falls with frequency f as f^-2 slope, with period 1."""

    def __init__(self, seed: int, slope: float = 1.6) -> None:
        self._values = _texture(seed, slope)

    def at(self, x: Float[np.ndarray, "h w"], y: Float[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
        """Values at places given in periods."""
        columns, rows = ((_SIZE * (each - np.floor(each))).astype(np.float32) for each in (x, y))
        return cv2.remap(self._values, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP).astype(np.float32)


@lru_cache(maxsize=8)
def _texture(seed: int, slope: float) -> Float32[np.ndarray, "n n"]:
    waves = np.fft.rfft2(np.random.default_rng(seed).standard_normal((_SIZE, _SIZE)))
    frequency = np.hypot(np.fft.fftfreq(_SIZE)[:, None], np.fft.rfftfreq(_SIZE)[None]) * _SIZE
    frequency[0, 0] = np.inf
    values = np.fft.irfft2(waves / frequency**slope, (_SIZE, _SIZE))
    return (values / values.std()).astype(np.float32)
