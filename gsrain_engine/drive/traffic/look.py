"""What a road user looks like."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gsrain_engine.scene.gaussians import Gaussians


class UserLook(NamedTuple):
    """A model, and the size of what it shows."""

    gaussians: Gaussians
    """In the object frame (x forward, y left, z up, origin at the bottom centre), metres."""
    size_lwh_m: tuple[float, float, float]


def scaled(gaussians: Gaussians, times: float) -> Gaussians:
    """Return Gaussians so many times larger, around the origin of their frame."""
    if times == 1:
        return gaussians
    by = np.float32(times)
    return replace(gaussians, means=gaussians.means * by, scales=gaussians.scales * by)
