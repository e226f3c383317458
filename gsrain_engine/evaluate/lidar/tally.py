"""What a turn of a lidar lost in rain, and what it made up, by distance."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from .beams import Beams
from .sweep_in_rain import Fate, SweepInRain

RANGE_EDGES_M = (0.0, 2.0, 5.0, 10.0, 20.0, 30.0, 50.0, 80.0, 120.0, np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Tally:
    """Counts of returns in each bin of range; ranges are those in clear air, of false returns their own."""

    edges_m: Float64[np.ndarray, " k_and_one"]
    clear: Int64[np.ndarray, " k"]
    """Returns in clear air, less those that rain leaves alone."""
    kept: Int64[np.ndarray, " k"]
    dropped: Int64[np.ndarray, " k"]
    """Too weak in rain."""
    masked: Int64[np.ndarray, " k"]
    """A drop answered in their place."""
    false: Int64[np.ndarray, " k"]
    """Drops."""
    range_rmse_m: float
    """Root mean square of what rain adds to the ranges of kept returns; NaN without any."""
    untouched: int
    """Returns that rain leaves alone."""

    @classmethod
    def of(cls, beams: Beams, rainy: SweepInRain, edges_m: tuple[float, ...] = RANGE_EDGES_M) -> "Tally":
        edges = np.array(edges_m)

        def count(fate: Fate) -> Int64[np.ndarray, " k"]:
            return _binned(beams.ranges_m[(rainy.fates == fate) & beams.is_echo], edges)

        kept, dropped, masked = (count(fate) for fate in (Fate.KEPT, Fate.DROPPED, Fate.MASKED))
        true = ~rainy.is_false & ~beams.untouched[rainy.beams]
        away = rainy.sweep.points_m[true].astype(np.float64) - beams.origin_m
        added = np.linalg.norm(away, axis=1) - beams.ranges_m[rainy.beams[true]]
        return cls(
            edges_m=edges,
            clear=kept + dropped + masked,
            kept=kept,
            dropped=dropped,
            masked=masked,
            false=_binned(rainy.false_ranges_m, edges),
            range_rmse_m=float(np.sqrt(np.mean(added**2))) if len(added) else float("nan"),
            untouched=int(beams.untouched.sum()),
        )

    def kept_share(self) -> Float64[np.ndarray, " k"]:
        """Share of the clear returns that are kept, 0..1; NaN where there were none."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self.clear > 0, self.kept / self.clear, np.nan)


def _binned(
    ranges_m: Float64[np.ndarray, " n"], edges_m: Float64[np.ndarray, " k"]
) -> Int64[np.ndarray, " k_less_one"]:
    counts, _ = np.histogram(ranges_m, np.where(np.isinf(edges_m), 1e9, edges_m))
    return counts.astype(np.int64)
