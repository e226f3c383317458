"""Disdrometers that measure diameter and fall speed: classes, measuring area, and spectra from raw counts."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Shaped

from gsrain_engine.rain.disdrometer import parsivel_classes, thies_classes
from gsrain_engine.rain.disdrometer.class_order import Order, arrange
from gsrain_engine.rain.disdrometer.reading import Reading
from gsrain_engine.rain.disdrometer.records import Record
from gsrain_engine.rain.disdrometer.spectra import DropSpectra

logger = logging.getLogger("gsrain")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Instrument:
    """A disdrometer as its maker describes it."""

    name: str
    diameter_edges_mm: Float64[np.ndarray, " diameters_and_one"]
    velocity_edges_m_s: Float64[np.ndarray, " velocities_and_one"]
    area_m2: Float64[np.ndarray, " diameters"]

    @property
    def shape(self) -> tuple[int, int]:
        """Number of diameter and of fall-speed classes."""
        return len(self.diameter_edges_mm) - 1, len(self.velocity_edges_m_s) - 1

    def reading_of(self, path: Path, records: list[Record], written: Order, skipped: list[str]) -> Reading:
        """Spectra of records whose counts run in the maker's order, unless the rain rate says otherwise."""
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
    ) -> Reading:
        arranged, order = arrange(
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
        return Reading(spectra=spectra, skipped=tuple(skipped))


PARSIVEL = Instrument(
    name="OTT Parsivel",
    diameter_edges_mm=parsivel_classes.DIAMETER_EDGES_MM,
    velocity_edges_m_s=parsivel_classes.VELOCITY_EDGES_M_S,
    area_m2=parsivel_classes.AREA_M2,
)
THIES = Instrument(
    name="Thies LNM",
    diameter_edges_mm=thies_classes.DIAMETER_EDGES_MM,
    velocity_edges_m_s=thies_classes.VELOCITY_EDGES_M_S,
    area_m2=thies_classes.AREA_M2,
)
