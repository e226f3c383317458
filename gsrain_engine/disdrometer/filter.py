"""Quality control of drop spectra: masks of drops that can't be rain, and a report of what they removed."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool

from ..rain.calibration import atlas_velocity
from .spectra import DropSpectra

LARGEST_MARGIN_FALLER_MM = 8.0
"""Larger drops break up in the air, so a larger and too fast one was not cut by the margin."""

LARGEST_SPLASH_MM = 2.0
"""Splashes from the housing are small; larger slow particles are melting snow or drops tilted by strong wind."""

_NO_SPEED = "no fall speed is measured"


@dataclass(frozen=True, slots=True, kw_only=True)
class MaskReport:
    """Drops and records that one mask removed after the masks before it."""

    name: str
    rule: str
    """Removal criterion with its threshold."""
    drops: float
    """Fractional if the counts come from densities."""
    records: int
    not_applied: str = ""
    """Reason why the mask was skipped; empty if it was applied."""


@dataclass(frozen=True, slots=True, kw_only=True)
class QualityControlReport:
    """Drops and records that quality control kept and removed; they add up."""

    drops: float
    drops_kept: float
    records: int
    records_kept: int
    masks: tuple[MaskReport, ...]

    @property
    def lines(self) -> list[str]:
        drops = f"{self.drops_kept:.0f} of {self.drops:.0f} drops"
        records = f"{self.records_kept} of {self.records} records"
        lines = [f"{drops} and {records} are kept"]
        for mask in self.masks:
            removed = f"{mask.drops:.0f} drops, {mask.records} records removed"
            result = f"not applied, {mask.not_applied}" if mask.not_applied else removed
            lines.append(f"{mask.name} ({mask.rule}): {result}")
        return lines


_Mask = tuple[str, str, Bool[np.ndarray, "diameters velocities"] | None]
"""Name, rule, and classes that are not trusted; None if the mask needs fall speeds and none are measured."""


def apply_quality_control(
    spectra: DropSpectra,
    *,
    smallest_mm: float = 0.25,
    speed_tolerance: float = 0.6,
    fewest_drops: float = 10,
) -> tuple[DropSpectra, QualityControlReport]:
    """Remove drops that can't be completely measured rain, then records with too few drops left.

    In this order: drops below `smallest_mm`; margin fallers, cut by the rim of the light sheet so that they appear too
    small for their speed; splashes from the housing, small and slow; all other drops whose speed differs from Atlas et
    al. (1973) by more than the fraction `speed_tolerance` (0.6 as in Jaffrain and Berne 2011); records of fewer than
    `fewest_drops`. A class is judged by its center. Without measured speeds the speed masks are skipped and reported as
    such.
    """
    counts = spectra.counts.sum(axis=0)
    trusted = np.ones(counts.shape, bool)
    reports: list[MaskReport] = []
    for name, rule, mask in _masks(spectra, smallest_mm, speed_tolerance):
        if mask is None:
            reports.append(MaskReport(name=name, rule=rule, drops=0.0, records=0, not_applied=_NO_SPEED))
        else:
            removed = float(counts[trusted & mask].sum())
            reports.append(MaskReport(name=name, rule=rule, drops=removed, records=0))
            trusted &= ~mask

    kept = replace(spectra, counts=spectra.counts * trusted)
    by_record = kept.counts.sum(axis=(1, 2))
    enough = by_record >= fewest_drops
    too_few = MaskReport(
        name="few drops",
        rule=f"fewer than {fewest_drops:g} drops left in a record",
        drops=float(by_record[~enough].sum()),
        records=int((~enough).sum()),
    )
    report = QualityControlReport(
        drops=float(counts.sum()),
        drops_kept=float(by_record[enough].sum()),
        records=len(spectra),
        records_kept=int(enough.sum()),
        masks=(*reports, too_few),
    )
    return kept[enough], report


def _masks(spectra: DropSpectra, smallest_mm: float, tolerance: float) -> Iterator[_Mask]:
    diameters = np.broadcast_to(spectra.diameters_mm[:, None], spectra.counts.shape[1:])
    yield "small drops", f"D < {smallest_mm:g} mm", diameters < smallest_mm
    speeds, off = spectra.velocities_m_s, None
    if speeds is not None:  # relative deviation from the expected speed
        off = speeds / np.maximum(atlas_velocity(spectra.diameters_mm), 1e-6)[:, None] - 1
    margin = f"D < {LARGEST_MARGIN_FALLER_MM:g} mm, faster than {1 + tolerance:.3g} of the expected fall speed"
    splash = f"D < {LARGEST_SPLASH_MM:g} mm, slower than {max(1 - tolerance, 0):.3g} of it"
    speed = f"other drops more than {100 * tolerance:.3g} % off the expected fall speed"
    is_margin = None if off is None else (off > tolerance) & (diameters < LARGEST_MARGIN_FALLER_MM)
    is_splash = None if off is None else (off < -tolerance) & (diameters < LARGEST_SPLASH_MM)
    yield "margin fallers", margin, is_margin
    yield "splashes", splash, is_splash
    yield "fall speed", speed, None if off is None else np.abs(off) > tolerance
