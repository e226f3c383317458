"""Counts of drops by diameter and fall speed: what every disdrometer measures, real or virtual."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Shaped


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DropSpectra:
    """One spectrum a record, in order of time."""

    instrument: str
    """As a person would call it: OTT Parsivel."""
    times: Shaped[np.ndarray, " records"]
    """When each record ended, in UTC, datetime64[ms]; NaT where the file doesn't say."""
    seconds: Float64[np.ndarray, " records"]
    """How long each record was measured."""
    diameter_edges_mm: Float64[np.ndarray, " diameters_and_one"]
    """Bounds of the diameter classes, rising; of the sphere that holds the drop's water."""
    velocity_edges_m_s: Float64[np.ndarray, " velocities_and_one"] | None
    """Bounds of the fall-speed classes, rising; none where the instrument measures no speed."""
    counts: Float64[np.ndarray, "records diameters velocities"]
    """Drops; one velocity class where the instrument measures no speed."""
    area_m2: Float64[np.ndarray, " diameters"]
    """Horizontal area in which a drop of each class is counted."""
    reported_mm_h: Float64[np.ndarray, " records"]
    """The instrument's own rain rate; NaN where it gives none."""

    def __post_init__(self) -> None:
        if self.velocity_edges_m_s is None and self.counts.shape[2] != 1:
            raise ValueError(f"counts of {self.counts.shape[2]} velocity classes without their bounds")

    def __len__(self) -> int:
        return len(self.counts)

    def __getitem__(self, records: slice | Bool[np.ndarray, " picked"]) -> "DropSpectra":
        """Some of the records."""
        return replace(
            self,
            times=self.times[records],
            seconds=self.seconds[records],
            counts=self.counts[records],
            reported_mm_h=self.reported_mm_h[records],
        )

    @property
    def diameters_mm(self) -> Float64[np.ndarray, " diameters"]:
        """Middle of each diameter class."""
        return 0.5 * (self.diameter_edges_mm[:-1] + self.diameter_edges_mm[1:])

    @property
    def velocities_m_s(self) -> Float64[np.ndarray, " velocities"] | None:
        """Middle of each fall-speed class, where speed is measured."""
        edges = self.velocity_edges_m_s
        return None if edges is None else 0.5 * (edges[:-1] + edges[1:])

    @property
    def rate_mm_h(self) -> Float64[np.ndarray, " records"]:
        """Rain rate of each record from its drops: their volume, pi D^3 / 6, over area and time."""
        volume_mm3 = np.pi / 6 * self.diameters_mm**3
        by_diameter = self.counts.sum(axis=2) @ (volume_mm3 / (1e6 * self.area_m2))  # mm
        return 3600 * by_diameter / self.seconds

    @staticmethod
    def concatenate(parts: "list[DropSpectra]") -> "DropSpectra":
        """Join records of one instrument: same classes, same area. Raises `ValueError` when they differ."""
        first = parts[0]
        for other in parts[1:]:
            for name in ("diameter_edges_mm", "velocity_edges_m_s", "area_m2"):
                mine, its = getattr(first, name), getattr(other, name)
                if (mine is None) != (its is None) or (mine is not None and not np.array_equal(mine, its)):
                    raise ValueError(f"{first.instrument} and {other.instrument} differ in {name}")
        joined = {
            name: np.concatenate([getattr(each, name) for each in parts])
            for name in ("times", "seconds", "counts", "reported_mm_h")
        }
        return replace(first, **joined)
