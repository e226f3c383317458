"""Time series of a roll-out for plots."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from ..simulation.metrics.collisions import gaps_m, times_to_collision_s
from ..simulation.rollout import Rollout


@dataclass(frozen=True, slots=True, eq=False)
class RolloutCurves:
    """Values per step of a roll-out. Times are seconds since the scenario began."""

    times_s: Float64[np.ndarray, " n"]
    speed_m_s: Float64[np.ndarray, " n"]
    acceleration_m_s2: Float64[np.ndarray, " n"]
    """Mean over the previous step."""
    ttc_s: Float64[np.ndarray, " n"]
    """Time to collision, 0..10 (paper's TTC, bumper to bumper)."""
    gap_m: Float64[np.ndarray, " n"]
    """Gap to the nearest vehicle ahead in the lane; NaN if there is none."""

    @property
    def min_ttc_time_s(self) -> float:
        """Time at which the time to collision was smallest."""
        return float(self.times_s[int(self.ttc_s.argmin())])

    def ttc_at(self, time_s: float) -> float:
        """Time to collision at a time, interpolated between steps."""
        return float(np.interp(time_s, self.times_s, self.ttc_s))


def rollout_curves(rollout: Rollout) -> RolloutCurves:
    """Compute the curves of a roll-out; raises ValueError if its vehicle can't be read."""
    gaps = gaps_m(rollout)
    return RolloutCurves(
        np.array([each.time_s for each in rollout.steps]),
        np.array([each.ego.speed_m_s for each in rollout.steps]),
        np.array([each.ego.acceleration_m_s2 for each in rollout.steps]),
        times_to_collision_s(rollout),
        np.where(np.isfinite(gaps), gaps, np.nan),
    )
