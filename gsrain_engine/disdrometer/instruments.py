"""Disdrometers that measure diameter and fall speed: classes, measuring area, and spectra from raw counts."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64, Shaped

from ..rain.calibration import atlas_velocity
from .spectra import DisdrometerReading, DropSpectra, SpectrumRecord

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

    def reading_of(
        self, path: Path, records: list[SpectrumRecord], written: Order, skipped: list[str]
    ) -> DisdrometerReading:
        """Spectra of records whose counts are in the maker's order, unless the rain rate indicates the other one."""
        return self.reading(
            path,
            np.stack([record.counts for record in records]),
            written,
            np.array([record.time for record in records]),
            np.array([record.seconds for record in records]),
            np.array([record.reported_mm_h for record in records]),
            skipped,
        )

    def reading(
        self,
        path: Path,
        counts: Float64[np.ndarray, "records classes"],
        written: Order,
        times: Shaped[np.ndarray, " records"],
        seconds: Float64[np.ndarray, " records"],
        reported_mm_h: Float64[np.ndarray, " records"],
        skipped: list[str],
    ) -> DisdrometerReading:
        arranged, order = arrange_spectrum(
            counts,
            written,
            diameter_edges_mm=self.diameter_edges_mm,
            velocity_edges_m_s=self.velocity_edges_m_s,
            area_m2=self.area_m2,
            seconds=seconds,
            reported_mm_h=reported_mm_h,
        )
        if order != written:
            logger.warning("%s: its spectra run with %s, not as usual with %s", path, order, written)
        spectra = DropSpectra(
            instrument=self.name,
            times=times,
            seconds=seconds,
            diameter_edges_mm=self.diameter_edges_mm,
            velocity_edges_m_s=self.velocity_edges_m_s,
            counts=arranged,
            area_m2=self.area_m2,
            reported_mm_h=reported_mm_h,
        )
        return DisdrometerReading(spectra=spectra, skipped=tuple(skipped))


# OTT Parsivel (Parsivel2 manual, appendix C)


def _edges(*runs: tuple[int, float]) -> Float64[np.ndarray, " edges"]:
    """Bounds from 0 on, from runs of (number of classes, width)."""
    widths = np.repeat([width for _, width in runs], [classes for classes, _ in runs])
    return np.concatenate([[0.0], np.round(np.cumsum(widths), 6)])


PARSIVEL_DIAMETER_EDGES_MM = _edges((10, 0.125), (5, 0.25), (5, 0.5), (5, 1.0), (5, 2.0), (2, 3.0))
PARSIVEL_VELOCITY_EDGES_M_S = _edges((10, 0.1), (5, 0.2), (5, 0.4), (5, 0.8), (5, 1.6), (2, 3.2))


def effective_area_m2(diameters_mm: Float64[np.ndarray, " diameters"]) -> Float64[np.ndarray, " diameters"]:
    """Area that measures a drop completely: the laser sheet of 180 x 30 mm less a margin of half a diameter.

    Source: Battaglia et al. (2010), as 180 (30 - D/2) mm^2.
    """
    return 180e-6 * (30 - diameters_mm / 2)


PARSIVEL_AREA_M2 = effective_area_m2(0.5 * (PARSIVEL_DIAMETER_EDGES_MM[:-1] + PARSIVEL_DIAMETER_EDGES_MM[1:]))

# Thies laser precipitation monitor (instruction for use)
# The last diameter class is open, from 8 mm; it gets the width of the one before. The last speed class ends at 20 m/s,
# beyond which the instrument counts no particle.

THIES_DIAMETER_EDGES_MM = np.concatenate([[0.125, 0.25, 0.375, 0.5], np.arange(0.75, 2, 0.25), np.arange(2, 8.6, 0.5)])

THIES_VELOCITY_EDGES_M_S = np.round(
    np.concatenate([0.2 * np.arange(5), 1 + 0.4 * np.arange(6), 3.4 + 0.8 * np.arange(8), [10.0, 20.0]]), 6
)

THIES_AREA_M2 = np.full(len(THIES_DIAMETER_EDGES_MM) - 1, 0.228 * 0.020)
_LOWEST_RATE_MM_H = 0.1
_FEWEST_DROPS = 10
_WORST_RATIO = 3.0
_ENOUGH_DROPS = 50


def arrange_spectrum(
    counts: Float64[np.ndarray, "records classes"],
    written: Order,
    *,
    diameter_edges_mm: Float64[np.ndarray, " diameters_and_one"],
    velocity_edges_m_s: Float64[np.ndarray, " velocities_and_one"],
    area_m2: Float64[np.ndarray, " diameters"],
    seconds: Float64[np.ndarray, " records"],
    reported_mm_h: Float64[np.ndarray, " records"],
) -> tuple[Float64[np.ndarray, "records diameters velocities"], Order]:
    """Arrange counts in file order as spectra, and return the order found.

    The order whose rate is nearer to the reported one is chosen (the wrong one is off by a factor of a hundred). If no
    record reports 0.1 mm/h, or both orders are off by more than a factor of three (snow, insects, other classes:
    reported by `RateCheck`), the drops' speeds decide: the other order is chosen if its drops are twice as near to
    Atlas et al. (1973). With fewer than 50 drops `written` (the maker's order) is kept.
    """
    diameters = 0.5 * (diameter_edges_mm[:-1] + diameter_edges_mm[1:])
    velocities = 0.5 * (velocity_edges_m_s[:-1] + velocity_edges_m_s[1:])
    other: Order = "diameters first" if written == "velocities first" else "velocities first"
    arranged = {order: _arranged(counts, order, len(diameters), len(velocities)) for order in (written, other)}

    rainy = (reported_mm_h >= _LOWEST_RATE_MM_H) & (counts.sum(axis=1) >= _FEWEST_DROPS)
    if rainy.any():
        depth_mm = np.pi / 6 * diameters**3 / (1e6 * area_m2)
        reported_mm = reported_mm_h[rainy] * seconds[rainy] / 3600
        ratio = {
            order: float(np.median(spectra[rainy].sum(axis=2) @ depth_mm / reported_mm))
            for order, spectra in arranged.items()
        }
        off = {order: abs(np.log(max(each, 1e-12))) for order, each in ratio.items()}
        order = other if off[other] < off[written] else written
        if off[order] <= np.log(_WORST_RATIO):
            return arranged[order], order
    if counts.sum() < _ENOUGH_DROPS:
        return arranged[written], written
    far = np.abs(velocities - atlas_velocity(diameters)[:, None])
    wrong = {order: float((spectra.sum(axis=0) * far).sum()) for order, spectra in arranged.items()}
    order = other if wrong[other] < 0.5 * wrong[written] else written
    return arranged[order], order


def _arranged(
    counts: Float64[np.ndarray, "records classes"], order: Order, diameters: int, velocities: int
) -> Float64[np.ndarray, "records diameters velocities"]:
    if order == "diameters first":
        return counts.reshape(-1, diameters, velocities)
    return counts.reshape(-1, velocities, diameters).transpose(0, 2, 1)


PARSIVEL = Instrument(
    name="OTT Parsivel",
    diameter_edges_mm=PARSIVEL_DIAMETER_EDGES_MM,
    velocity_edges_m_s=PARSIVEL_VELOCITY_EDGES_M_S,
    area_m2=PARSIVEL_AREA_M2,
)

THIES = Instrument(
    name="Thies LNM",
    diameter_edges_mm=THIES_DIAMETER_EDGES_MM,
    velocity_edges_m_s=THIES_VELOCITY_EDGES_M_S,
    area_m2=THIES_AREA_M2,
)

CLASSES = 32
