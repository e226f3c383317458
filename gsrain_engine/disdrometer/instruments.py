"""Disdrometers that measure diameter and fall speed: classes, measuring area, and spectra from raw counts."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64

from ..rain.calibration import atlas_velocity
from .spectra import DisdrometerReading, SpectrumRecords

logger = logging.getLogger("gsrain")


Order = Literal["diameters first", "velocities first"]
"""Slower index: `velocities first` stores all diameters of the lowest speed, then those of the next."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Instrument:
    """Classes and measuring area of a disdrometer by its maker's specification."""

    name: str
    diameter_edges_mm: Float64[np.ndarray, " diameters_and_one"]
    velocity_edges_m_s: Float64[np.ndarray, " velocities_and_one"]
    area_m2: Float64[np.ndarray, " diameters"]

    @property
    def shape(self) -> tuple[int, int]:
        """Number of diameter classes and of fall-speed classes."""
        return len(self.diameter_edges_mm) - 1, len(self.velocity_edges_m_s) - 1

    def reading(self, path: Path, records: SpectrumRecords, written: Order) -> DisdrometerReading:
        """Spectra of records whose counts are in the maker's order, unless `arranged` finds the other one."""
        counts, order = self.arranged(records.counts, written, records.seconds, records.reported_mm_h)
        if order != written:
            logger.warning("%s: its spectra run with %s, not as usual with %s", path, order, written)
        return records.reading(self.name, self.diameter_edges_mm, self.velocity_edges_m_s, counts, self.area_m2)

    def arranged(
        self,
        counts: Float64[np.ndarray, "records classes"],
        written: Order,
        seconds: Float64[np.ndarray, " records"],
        reported_mm_h: Float64[np.ndarray, " records"],
    ) -> tuple[Float64[np.ndarray, "records diameters velocities"], Order]:
        """Arrange counts in file order as spectra, and return the order found.

        The order whose rate is nearer to the reported one is chosen (the wrong one is off by a factor of a hundred). If
        no record reports 0.1 mm/h, or both orders are off by more than a factor of three (snow, insects, other classes:
        reported by `RateCheck`), the drops' speeds decide: the other order is chosen if its drops are twice as near to
        Atlas et al. (1973). With fewer than 50 drops `written` (the maker's order) is kept.
        """
        diameters = 0.5 * (self.diameter_edges_mm[:-1] + self.diameter_edges_mm[1:])
        velocities = 0.5 * (self.velocity_edges_m_s[:-1] + self.velocity_edges_m_s[1:])
        other: Order = "diameters first" if written == "velocities first" else "velocities first"
        by_order = {
            "diameters first": counts.reshape(-1, *self.shape),
            "velocities first": counts.reshape(-1, *self.shape[::-1]).transpose(0, 2, 1),
        }
        rainy = (reported_mm_h >= _LOWEST_RATE_MM_H) & (counts.sum(axis=1) >= _FEWEST_DROPS)
        if rainy.any():
            depth_mm = np.pi / 6 * diameters**3 / (1e6 * self.area_m2)
            reported_mm = reported_mm_h[rainy] * seconds[rainy] / 3600
            ratio = {
                order: float(np.median(spectra[rainy].sum(axis=2) @ depth_mm / reported_mm))
                for order, spectra in by_order.items()
            }
            off = {order: abs(np.log(max(each, 1e-12))) for order, each in ratio.items()}
            order = other if off[other] < off[written] else written
            if off[order] <= np.log(_WORST_RATIO):
                return by_order[order], order
        if counts.sum() < _ENOUGH_DROPS:
            return by_order[written], written
        far = np.abs(velocities - atlas_velocity(diameters)[:, None])
        wrong = {order: float((spectra.sum(axis=0) * far).sum()) for order, spectra in by_order.items()}
        order = other if wrong[other] < 0.5 * wrong[written] else written
        return by_order[order], order


_LOWEST_RATE_MM_H = 0.1
_FEWEST_DROPS = 10
_WORST_RATIO = 3.0
_ENOUGH_DROPS = 50


def _edges(*runs: tuple[int, float], start: float = 0.0) -> Float64[np.ndarray, " edges"]:
    """Bounds of adjacent classes, from runs of (number of classes, width)."""
    widths = np.repeat([width for _, width in runs], [classes for classes, _ in runs])
    return np.concatenate([[start], np.round(start + np.cumsum(widths), 6)])


CLASSES = 32
"""Diameter classes of a Parsivel, and as many of fall speed."""

_PARSIVEL_EDGES_MM = _edges((10, 0.125), (5, 0.25), (5, 0.5), (5, 1.0), (5, 2.0), (2, 3.0))
PARSIVEL = Instrument(
    name="OTT Parsivel",
    diameter_edges_mm=_PARSIVEL_EDGES_MM,
    velocity_edges_m_s=_edges((10, 0.1), (5, 0.2), (5, 0.4), (5, 0.8), (5, 1.6), (2, 3.2)),
    area_m2=180e-6 * (30 - 0.5 * (_PARSIVEL_EDGES_MM[:-1] + _PARSIVEL_EDGES_MM[1:]) / 2),
)
"""Classes of the Parsivel2 manual, appendix C.

The area measures a drop completely: the laser sheet of 180 x 30 mm less a margin of half a diameter, so 180 (30 - D/2)
mm^2 (Battaglia et al. 2010).
"""

THIES = Instrument(
    name="Thies LNM",
    diameter_edges_mm=_edges((3, 0.125), (6, 0.25), (13, 0.5), start=0.125),
    velocity_edges_m_s=_edges((5, 0.2), (6, 0.4), (7, 0.8), (1, 1.0), (1, 10.0)),
    area_m2=np.full(22, 0.228 * 0.020),
)
"""Laser precipitation monitor (instruction for use).

The last diameter class is open, from 8 mm; it gets the width of the one before. The last speed class ends at 20 m/s,
beyond which the instrument counts no particle.
"""

JOSS_WALDVOGEL = "Joss-Waldvogel"
JOSS_WALDVOGEL_AREA_M2 = 0.005
"""Area of the cone, 50 cm^2 (Joss and Waldvogel 1967)."""

RD80_EDGES_MM = np.array(
    [0.313, 0.405, 0.505, 0.596, 0.715, 0.827, 0.999, 1.232, 1.429, 1.582, 1.748]
    + [2.077, 2.441, 2.727, 3.011, 3.385, 3.704, 4.127, 4.573, 5.145, 5.6]
)
"""Bounds of the classes of a Joss-Waldvogel RD-80 (Distromet's instructions); the last is open and is closed here."""
