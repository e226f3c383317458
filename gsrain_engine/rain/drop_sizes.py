"""Drop diameters at one intensity: the gamma law (paper, eq. 8), cut to the sizes that raindrops have."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Float, Float64
from scipy import special

SMALLEST_MM = 0.1
LARGEST_MM = 8.0
"""Drops below are drizzle mist, drops above break up; the law is cut there and normalized again."""

CLASSES = 16384
"""Diameter classes of a drop field: class c is the quantile (c + 1/2) / CLASSES. A drop keeps its class as R moves."""


_PANELS, _NODES = 20, 20
"""Few nodes in each of many panels: the eigenvalues behind 400 nodes at once keep a busy machine for seconds."""


@cache
def _quadrature() -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Gauss-Legendre nodes in mm and their weights, in the square root of D: they crowd where small drops are."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    edges = np.linspace(np.sqrt(SMALLEST_MM), np.sqrt(LARGEST_MM), _PANELS + 1)[:, None]
    root = (edges[:-1] + 0.5 * (nodes + 1) * np.diff(edges, axis=0)).ravel()
    return root**2, np.tile(weights, _PANELS) * root


@dataclass(frozen=True)
class DropSizes:
    """Gamma law with shape mu and scale theta (mm), cut to [0.1, 8] mm."""

    shape: float
    scale_mm: float

    @cached_property
    def _limits(self) -> tuple[float, float]:
        low, high = special.gammainc(self.shape, np.array([SMALLEST_MM, LARGEST_MM]) / self.scale_mm)
        return float(low), float(high)

    def quantile(self, probability: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
        """Diameter in mm below which this share of the drops lies."""
        low, high = self._limits
        diameter = self.scale_mm * special.gammaincinv(self.shape, low + probability * (high - low))
        return np.clip(diameter, SMALLEST_MM, LARGEST_MM)

    def probability_per_mm(self, diameter_mm: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
        """Density of the law in 1/mm, for diameters within its bounds."""
        low, high = self._limits
        x = diameter_mm / self.scale_mm
        density = np.exp((self.shape - 1) * np.log(x) - x - special.gammaln(self.shape))
        return density / (self.scale_mm * (high - low))

    @cached_property
    def class_diameters_mm(self) -> Float64[np.ndarray, " classes"]:
        """Diameter of each class in mm, rising."""
        return self.quantile((np.arange(CLASSES) + 0.5) / CLASSES)

    def expectation(self, quantity: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]) -> float:
        """Mean of a quantity of the diameter (mm) over the drops, by Gauss-Legendre quadrature."""
        diameter, weight = _quadrature()
        log_density = (self.shape - 1) * np.log(diameter) - diameter / self.scale_mm
        mass = weight * np.exp(log_density - log_density.max())
        return float(np.sum(mass * quantity(diameter)) / np.sum(mass))

    @cached_property
    def mean_mm(self) -> float:
        """Mean diameter in mm."""
        return self.expectation(lambda diameter: diameter)
