"""Displacement of each class of drops, and its phases in the cell in plain NumPy: `drop_phases` must give the same."""

import numpy as np
from jaxtyping import Float64

from gsrain_engine.rain.drop_field import DropPhases
from gsrain_engine.rain.drop_motion import DropMotion


def displacement(motion: DropMotion, time_s: float) -> Float64[np.ndarray, "classes 3"]:
    """World displacement of each class in meters since t = 0."""
    fallen = motion.fallen(time_s)
    return np.column_stack([np.broadcast_to(motion.drift(time_s), (len(fallen), 2)), -fallen])


def phases_of(
    displacement_m: Float64[np.ndarray, "classes 3"],
    cell_center_m: Float64[np.ndarray, "3"],
    period_m: Float64[np.ndarray, "3"],
) -> DropPhases:
    """Split (displacement - cell center) / period + 1/2 into whole wraps and a 32-bit fraction."""
    periods = (displacement_m - cell_center_m) / period_m + 0.5
    whole = np.floor(periods)
    return DropPhases(whole.astype(np.int32), ((periods - whole) * 2.0**32).astype(np.uint64).astype(np.uint32))
