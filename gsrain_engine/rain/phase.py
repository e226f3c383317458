"""Phase functions of rain and fog: light that drops scatter, by angle (Mie 1908)."""

from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64

TABLE = Path(__file__).with_name("phase_functions.npy")
"""Rain at `RATES_MM_H`, then fog, at `ANGLES` equal steps from 0 to 180 degrees; made by
benchmarks/phase_functions.py."""
ANGLES = 721
RATES_MM_H = (1.0, 4.0, 16.0, 64.0)
NARROW_DEG = 0.75
"""Angle within which the forward peak of rain is left out: drops diffract half of the light, most of it by hundredths
of a degree, so that it stays in the picture of the lamp."""


def rain_phase(intensity_mm_h: float) -> Float64[np.ndarray, " angles"]:
    """Phase function of rain without its narrow forward peak, at the table's angles; 4 pi is the integral with it."""
    at = np.interp(np.log(max(intensity_mm_h, 1e-3)), np.log(RATES_MM_H), np.arange(len(RATES_MM_H)))
    low = min(int(at), len(RATES_MM_H) - 2)
    table = phase_table()
    row = (low + 1 - at) * table[low] + (at - low) * table[low + 1]
    narrow = round(NARROW_DEG / 180 * (ANGLES - 1))
    row[:narrow] = row[narrow]
    return row


def fog_phase() -> Float64[np.ndarray, " angles"]:
    """Phase function of fog at the table's angles; its integral over the sphere is 4 pi."""
    return phase_table()[-1].copy()


@lru_cache(1)
def phase_table() -> Float64[np.ndarray, "rows angles"]:
    """Rows of the table, read once."""
    return np.load(TABLE).astype(np.float64)


def phase_sums(row: Float64[np.ndarray, " angles"]) -> Float32[np.ndarray, " angles"]:
    """Integral of a phase function over the angle (radians), from 0 to each of the table's angles."""
    step = np.pi / (ANGLES - 1)
    return np.concatenate([[0.0], np.cumsum(0.5 * step * (row[1:] + row[:-1]))]).astype(np.float32)


def sphere_weights() -> Float64[np.ndarray, " angles"]:
    """Solid angle of each of the table's angles: the integral over the sphere of a function that is linear between."""
    step = np.pi / (ANGLES - 1)
    weights = 4 * np.pi * np.sin(np.arange(ANGLES) * step) * (1 - np.cos(step)) / step
    weights[[0, -1]] = 2 * np.pi * (1 - np.sin(step) / step)
    return weights


def asymmetry(row: Float64[np.ndarray, " angles"]) -> float:
    """Mean cosine of the scattering angle."""
    return float(sphere_weights() @ (row * np.cos(np.linspace(0, np.pi, ANGLES)))) / (4 * np.pi)
