"""Diameter and fall speed of each class over the intensity, tabulated: drops grow and speed up little by little."""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import msgspec
import numpy as np
from jaxtyping import Float64

from .calibration import Calibration
from .rain import Rain
from .rain_state import fall_speed, rain_state

LOWEST_MM_H = 0.02
"""Fainter rain has the drops of this."""

_RATIO = 1.2
"""From node to node. Straight lines between them miss a diameter by 0.04 % outside the calibration; between
the paper's rows at 8.5 and 12 mm/h, whose laws differ most, the median class by 0.4 % and the smallest drops by 3 %.
"""

_KEPT = 96
"""Nodes that are kept, 256 kB each; from 0.02 to 100 mm/h are 48."""


@dataclass(frozen=True, eq=False)
class ClassTable:
    """Classes at some intensities; what lies between two of them is a mean of both."""

    nodes_mm_h: Float64[np.ndarray, " nodes"]
    """Rising."""
    diameters_mm: tuple[Float64[np.ndarray, " classes"], ...]
    fall_speed_m_s: tuple[Float64[np.ndarray, " classes"], ...]

    @classmethod
    def between(cls, lowest_mm_h: float, highest_mm_h: float, rain: Rain, calibration: Calibration) -> "ClassTable":
        """Tabulate a range of intensities; one alone is exact."""
        if lowest_mm_h == highest_mm_h:
            nodes = np.array([lowest_mm_h])
        else:
            first = int(np.floor(_steps(lowest_mm_h)))
            last = max(first + 1, int(np.ceil(_steps(highest_mm_h))))
            grid = LOWEST_MM_H * _RATIO ** np.arange(first, last + 1)
            # The law has corners at the calibration's rows.
            rows = np.array([row.intensity_mm_h for row in calibration.rows])
            low = [0.0] if lowest_mm_h < LOWEST_MM_H else []
            nodes = np.unique(np.concatenate([low, grid, rows[(rows > grid[0]) & (rows < grid[-1])]]))
        laws = msgspec.structs.replace(Rain(), velocity=rain.velocity)
        rates = np.maximum(nodes, LOWEST_MM_H).tolist()
        diameters, speeds = zip(*(_classes_at(rate, laws, calibration) for rate in rates), strict=True)
        return cls(nodes, diameters, speeds)

    def interval(self, intensity_mm_h: float) -> int:
        """Number of the node below an intensity that is not the last one."""
        node = int(np.searchsorted(self.nodes_mm_h, intensity_mm_h, side="right")) - 1
        return min(max(node, 0), max(len(self.nodes_mm_h) - 2, 0))

    def at(
        self, of: tuple[Float64[np.ndarray, " classes"], ...], intensity_mm_h: float
    ) -> Float64[np.ndarray, " classes"]:
        """Diameters or speeds at an intensity within the nodes: hat functions over them."""
        if len(of) == 1:
            return of[0]
        j = self.interval(intensity_mm_h)
        low, high = self.nodes_mm_h[j], self.nodes_mm_h[j + 1]
        share = min(max((intensity_mm_h - low) / (high - low), 0.0), 1.0)
        return (1 - share) * of[j] + share * of[j + 1]

    def mean_shares(
        self, start_mm_h: Float64[np.ndarray, " n"], end_mm_h: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n nodes"]:
        """How much each node counts on average while the intensity goes evenly from one value to another. Exact."""
        if len(self.nodes_mm_h) == 1:
            return np.ones((len(start_mm_h), 1))
        change = end_mm_h - start_mm_h
        share = np.zeros((len(change), len(self.nodes_mm_h)))
        still = change == 0
        divisor = np.where(still, 1.0, change)
        last = float(self.nodes_mm_h[-1])
        for j, (low, high) in enumerate(pairwise(self.nodes_mm_h.tolist())):
            a, b = np.clip(start_mm_h, low, high), np.clip(end_mm_h, low, high)
            inside = np.where(still, (start_mm_h >= low) & ((start_mm_h < high) | (high == last)), (b - a) / divisor)
            rising = ((a - low) + (b - low)) / (2 * (high - low))
            share[:, j] += inside * (1 - rising)
            share[:, j + 1] += inside * rising
        return share

    def mix(
        self, of: tuple[Float64[np.ndarray, " classes"], ...], shares: Float64[np.ndarray, " nodes"]
    ) -> Float64[np.ndarray, " classes"]:
        """Add up nodes by their shares, in their order: the same numbers on every machine."""
        total = np.zeros(len(of[0]))
        for j in np.flatnonzero(shares):
            total += shares[j] * of[j]
        return total


def _steps(intensity_mm_h: float) -> float:
    return float(np.log(max(intensity_mm_h, LOWEST_MM_H) / LOWEST_MM_H) / np.log(_RATIO))


@lru_cache(maxsize=_KEPT)
def _classes_at(
    intensity_mm_h: float, laws: Rain, calibration: Calibration
) -> tuple[Float64[np.ndarray, " classes"], Float64[np.ndarray, " classes"]]:
    rain = msgspec.structs.replace(laws, intensity_mm_h=intensity_mm_h)
    diameters = rain_state(rain, calibration).sizes.class_diameters_mm
    return diameters, fall_speed(rain, calibration)(diameters)
