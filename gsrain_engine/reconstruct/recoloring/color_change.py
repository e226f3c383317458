"""What happens to colours on average, by kind of surface: the guess for Gaussians that no view shows well."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Float64

from gsrain_engine.scene.gaussians import SH_C0

SURFACES = ("sky", "ground", "other")
"""Kinds of surface, each with a change of its own."""

_FEWEST_PIXELS = 200.0


@dataclass(frozen=True, slots=True, eq=False)
class ColorChange:
    """An affine map of display colour a kind of surface: new = matrix @ old + offset."""

    matrices: Float64[np.ndarray, "3 3 3"]
    offsets: Float64[np.ndarray, "3 3"]

    def of_sh(
        self, sh: Float32[np.ndarray, "n k 3"], shares: Float32[np.ndarray, "n 3"]
    ) -> Float32[np.ndarray, "n k 3"]:
        """Change harmonics; `shares` (sky, ground, other; sum 1) says what each Gaussian is."""
        changed = np.zeros_like(sh)
        for surface in range(len(SURFACES)):
            matrix, offset = self.matrices[surface].astype(np.float32), self.offsets[surface]
            moved = sh @ matrix.T
            # Colour is 0.5 + C0 sh[0] + ...: the 0.5 goes through the map as well.
            moved[:, 0] += ((matrix.sum(axis=1) * 0.5 + offset - 0.5) / SH_C0).astype(np.float32)
            changed += shares[:, surface, None, None] * moved
        return changed

    def of_colors(
        self, colors: Float32[np.ndarray, "p 3"], shares: Float32[np.ndarray, "p 3"]
    ) -> Float32[np.ndarray, "p 3"]:
        """Change display colours; `shares` (sky, ground, other) need not add up to 1."""
        changed = np.zeros_like(colors)
        total = np.maximum(shares.sum(axis=1), np.float32(1e-6))
        for surface in range(len(SURFACES)):
            moved = colors @ self.matrices[surface].T.astype(np.float32) + self.offsets[surface].astype(np.float32)
            changed += (shares[:, surface] / total)[:, None] * moved
        return changed


def fit_color_change(
    clear: Sequence[Float32[np.ndarray, "_ 3"]],
    changed: Sequence[Float32[np.ndarray, "_ 3"]],
    shares: Sequence[Float32[np.ndarray, "_ 3"]],
) -> ColorChange:
    """Fit the maps to pixels (display colours, one entry a view) by least squares, weighted by the pixels' `shares`.

    A kind of surface with too few pixels gets the map of all pixels together.
    """
    x = np.concatenate([np.concatenate(list(clear)), np.ones((sum(map(len, clear)), 1), np.float32)], axis=1)
    y = np.concatenate(list(changed))
    weights = np.concatenate(list(shares))
    everything = _fit(x, y, weights.sum(axis=1))
    maps = [
        _fit(x, y, weights[:, surface]) if weights[:, surface].sum() >= _FEWEST_PIXELS else everything
        for surface in range(len(SURFACES))
    ]
    return ColorChange(np.stack([each[:3].T for each in maps]), np.stack([each[3] for each in maps]))


def _fit(
    x: Float32[np.ndarray, "p 4"], y: Float32[np.ndarray, "p 3"], weights: Float[np.ndarray, " p"]
) -> Float64[np.ndarray, "4 3"]:
    """Weighted ridge regression towards darker grey, so that one-coloured surfaces give a tame map."""
    weighted = x.astype(np.float64) * weights[:, None]
    total = max(float(weights.sum()), 1e-9)
    tame = np.vstack([0.7 * np.eye(3), np.zeros(3)])
    ridge = 1e-3 * total * np.diag([1, 1, 1, 1e-3]) + 1e-12 * np.eye(4)
    return np.linalg.solve(weighted.T @ x + ridge, weighted.T @ y + ridge @ tame)
