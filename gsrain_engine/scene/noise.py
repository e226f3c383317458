"""Procedural noise on a lattice: the same everywhere, for any seed."""

from functools import reduce
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float, Float64, Int64


def lattice_noise(cells: Int64[np.ndarray, "n d"], seed: int) -> Float64[np.ndarray, " n"]:
    """Random number in [0, 1) for each integer cell (a multiplicative hash, finished as in splitmix64)."""
    primes = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
    mixed = np.full(len(cells), seed * 0xD6E8FEB86659FD93 % 2**64, np.uint64)
    for column, prime in zip(cells.T, primes, strict=False):
        mixed += column.astype(np.uint64) * prime
    for shift in (30, 27, 31):
        mixed ^= mixed >> np.uint64(shift)
        mixed *= np.uint64(0xBF58476D1CE4E5B9)
    return (mixed >> np.uint64(11)).astype(np.float64) / 2.0**53


def smooth_noise(points: Float[np.ndarray, "n d"], size: Any, seed: int) -> Float64[np.ndarray, " n"]:
    """Value noise in [0, 1): random values on a lattice of the given size (one number or one per axis), blended."""
    scaled = points.astype(np.float64) / np.asarray(size, np.float64)
    cells = np.floor(scaled).astype(np.int64)
    part = scaled - cells
    weight = part * part * (3 - 2 * part)
    weights = 1 - weight, weight
    total = np.zeros(len(points))
    for corner in product((0, 1), repeat=points.shape[1]):
        bits = corner[::-1]  # the first axis changes fastest
        share = reduce(np.multiply, (weights[bit][:, axis] for axis, bit in enumerate(bits)))
        total += share * lattice_noise(cells + np.array(bits), seed)
    return total


def layered_noise(
    points: Float[np.ndarray, "n d"], size: Any, seed: int, octaves: int = 3
) -> Float64[np.ndarray, " n"]:
    """Sum value noise of halving size and amplitude, in [0, 1)."""
    size = np.asarray(size, np.float64)
    strengths = 0.5 ** np.arange(octaves)
    layers = [s * smooth_noise(points, size * 0.5**k, seed + k) for k, s in enumerate(strengths)]
    return np.sum(layers, axis=0) / strengths.sum()
