"""How much of a detector's performance is left in rain."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Robustness:
    """Performance under corruption (Michaelis et al. 2019, equations 1 and 2), rain being the one corruption."""

    mpc: float
    """Mean performance over the intensities, in the unit of the performance (mAP: 0..1)."""
    rpc: float
    """That over the performance without rain: 1 where rain does no harm; NaN where nothing was found without it."""


def robustness(clear: float, rainy: Sequence[float]) -> Robustness:
    """Compare one measure of performance without rain with its values in rain, one each intensity: mPC and rPC.

    mPC is the mean in rain, in the measure's own unit; rPC is mPC over the value without rain: 1 where rain costs
    nothing, 0 where nothing is left (Michaelis et al. 2019, eq. 1 and 2).
    Intensities count alike, as severities do there. Raises ValueError without an intensity.
    """
    if not rainy:
        raise ValueError("performance under rain needs at least one intensity above 0 mm/h")
    mean = float(np.mean(rainy))
    return Robustness(mean, mean / clear if clear > 0 else float("nan"))
