"""Procedural noise by world position, the same in all views."""

from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64

from ..base import Image, Plane

_SIZE = 512


def smooth_noise_at(x: Float[np.ndarray, "h w"], y: Float[np.ndarray, "h w"], seed: int, slope: float = 1.6) -> Plane:
    """Gaussian noise of mean 0, variance 1, a power spectrum of f^-(2 slope) and period 1; x and y are in periods."""
    columns, rows = ((_SIZE * (each - np.floor(each))).astype(np.float32) for each in (x, y))
    values = _texture(seed, slope)
    return cv2.remap(values, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP).astype(np.float32)


@lru_cache(maxsize=8)
def _texture(seed: int, slope: float) -> Float32[np.ndarray, "n n"]:
    waves = np.fft.rfft2(np.random.default_rng(seed).standard_normal((_SIZE, _SIZE)))
    frequency = np.hypot(np.fft.fftfreq(_SIZE)[:, None], np.fft.rfftfreq(_SIZE)[None]) * _SIZE
    frequency[0, 0] = np.inf
    values = np.fft.irfft2(waves / frequency**slope, (_SIZE, _SIZE))
    return (values / values.std()).astype(np.float32)


# Ground bumps by world position. Meters.

_TEXTURE = 512  # bumps per side until they repeat
_BLENDED = 0.85  # standard deviation of independent random heights after cubic interpolation


def lattice_noise_at(points_m: Float[np.ndarray, "h w 3"], size_m: float, turn: float, seed: int) -> Plane:
    """Smooth noise of mean 0 and variance 1 on a rotated lattice with a pitch of `size_m`."""
    c, s = np.cos(turn) / size_m, np.sin(turn) / size_m
    x, y = points_m[..., 0], points_m[..., 1]
    across, along = c * x + s * y, c * y - s * x
    columns, rows = (np.mod(each, _TEXTURE - 4).astype(np.float32) + 1 for each in (across, along))
    return cv2.remap(_bump_texture(seed), columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP)


@lru_cache(maxsize=32)
def _bump_texture(seed: int) -> Float32[np.ndarray, "n n"]:
    """Periodic random heights, scaled to make up for the variance lost by interpolation."""
    side = _TEXTURE - 4
    values = np.random.default_rng(seed).standard_normal((side, side)).astype(np.float32)
    return np.pad(values / np.float32(_BLENDED), (1, 3), mode="wrap")


# Water slopes large enough for the image resolution, which give reflections ragged edges

_SIZES_M = (0.45, 0.17, 0.07)
_VISIBLE_SHARE = 0.5  # largest pixel length that still resolves a bump, as a share of the bump's size


def water_slopes(points_m: Float64[np.ndarray, "h w 3"], footprint_m: Plane, seed: int) -> Float32[np.ndarray, "h w 2"]:
    """Random slopes along the world's x and y, with a standard deviation of 1.

    `footprint_m` is a pixel's length on the ground; bumps smaller than it are left out.
    """
    slopes = np.zeros((*footprint_m.shape, 2), np.float32)
    for k, size in enumerate(_SIZES_M):
        coarseness = np.minimum(footprint_m / (_VISIBLE_SHARE * size), 1e3)
        share = np.float32(len(_SIZES_M) ** -0.5) / (1 + np.square(coarseness))
        for axis in range(2):
            bumps = lattice_noise_at(points_m, size, 1.3 * k + axis, 977 * (seed + 1) + 2 * k + axis)
            slopes[..., axis] += share * bumps
    return slopes


def tilt_normals(normals: Image, slopes: Float32[np.ndarray, "h w 2"], by: float) -> Image:
    """Tilt upward unit normals by slopes times a number."""
    tilts = np.concatenate([np.float32(by) * slopes, np.zeros_like(slopes[..., :1])], axis=-1)
    return (normals + tilts) / np.sqrt(1 + np.sum(tilts * tilts, axis=-1, keepdims=True))
