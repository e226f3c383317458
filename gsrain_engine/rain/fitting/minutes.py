"""Drop spectra summed over minutes: the unit that intensities are judged by, and that the bootstrap draws."""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float64, Int64

from ..calibration import atlas_velocity
from ..disdrometer.spectra import DropSpectra

MINUTE_MS = 60_000


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Minutes:
    """Sums over the records of each minute. A record of unknown time is a minute of its own."""

    seconds: Float64[np.ndarray, " minutes"]
    records: Float64[np.ndarray, " minutes"]
    rate_mm_h: Float64[np.ndarray, " minutes"]
    """From the drops."""
    reported_mm_h: Float64[np.ndarray, " minutes"]
    """The instrument's own; NaN where it gives none."""
    drops: Float64[np.ndarray, "minutes diameters"]
    density_seconds: Float64[np.ndarray, "minutes diameters"]
    """Drops in a cubic metre of air, times seconds: a drop counts 1 / (area x its speed)."""
    speed_sum: Float64[np.ndarray, "minutes diameters"]
    """Of the counted drops, m/s."""
    squared_speed_sum: Float64[np.ndarray, "minutes diameters"]

    def __len__(self) -> int:
        return len(self.seconds)

    @staticmethod
    def concatenate(parts: "list[Minutes]") -> "Minutes":
        names = [field.name for field in fields(Minutes)]
        return Minutes(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def sum_minutes(spectra: DropSpectra) -> Minutes:
    """Sum records by the UTC minute in which their middle lies.

    Speeds are the middles of their classes; where none is measured, Atlas et al. (1973) at the middle of the diameter.
    """
    minute, count = _minute_of_record(spectra)

    def summed(values: Float64[np.ndarray, " records *rest"]) -> Float64[np.ndarray, " minutes *rest"]:
        total = np.zeros((count, *values.shape[1:]))
        np.add.at(total, minute, values)
        return total

    speed = spectra.velocities_m_s
    if speed is None:
        speeds = atlas_velocity(spectra.diameters_mm)[:, None]
    else:
        speeds = np.broadcast_to(speed, (len(spectra.diameters_mm), len(speed)))
    slowness = np.divide(1, speeds, out=np.zeros_like(speeds), where=speeds > 0)
    seconds = summed(spectra.seconds)
    by_class = summed(spectra.counts)
    return Minutes(
        seconds=seconds,
        records=summed(np.ones(len(spectra))),
        rate_mm_h=summed(spectra.rate_mm_h * spectra.seconds) / seconds,
        reported_mm_h=summed(spectra.reported_mm_h * spectra.seconds) / seconds,
        drops=by_class.sum(axis=2),
        density_seconds=np.einsum("mdv,dv->md", by_class, slowness) / spectra.area_m2,
        speed_sum=np.einsum("mdv,dv->md", by_class, speeds),
        squared_speed_sum=np.einsum("mdv,dv->md", by_class, speeds**2),
    )


def _minute_of_record(spectra: DropSpectra) -> tuple[Int64[np.ndarray, " records"], int]:
    """Index of each record's minute, and how many there are."""
    ends = spectra.times.astype("datetime64[ms]")
    middles = ends.astype(np.int64) - np.rint(500 * spectra.seconds).astype(np.int64)
    known = ~np.isnat(ends)
    keys = np.where(known, np.floor_divide(middles, MINUTE_MS), 0)
    keys[~known] = keys.max(initial=0) + 1 + np.arange(np.count_nonzero(~known))
    distinct, minute = np.unique(keys, return_inverse=True)
    return minute.astype(np.int64), len(distinct)
