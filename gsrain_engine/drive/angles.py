"""Angles that differ by whole turns, as one."""

from typing import TypeVar

import numpy as np
from jaxtyping import Float64

_Angle = TypeVar("_Angle", float, Float64[np.ndarray, " n"])


def wrapped(angle_rad: _Angle) -> _Angle:
    """Return the same angle, or angles, within [-pi, pi): of a difference, the shorter way round."""
    return (angle_rad + np.pi) % (2 * np.pi) - np.pi


def wrapped_deg(angle_deg: float) -> float:
    """Return the same angle within [-180, 180) degrees."""
    return (angle_deg + 180.0) % 360.0 - 180.0
