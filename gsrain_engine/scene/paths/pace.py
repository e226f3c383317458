"""Speed for paths whose keys have no times: the places of photos, which say nothing about how fast anybody went."""

from dataclasses import replace

import numpy as np

from .camera_path import CameraPath

WALKING_M_S = 1.4
"""Speed of a path without times: a person's comfortable walk (Bohannon 1997, Age and Ageing 26: 1.3 to 1.5 m/s)."""

_SHORTEST_S = 0.02
_TURN_DEG_S = 90.0
"""Between photos from one place the camera turns so fast."""


def paced(path: CameraPath, speed: float, *, is_timed: bool = False) -> CameraPath:
    """Give the keys moments at which the camera passes them at a speed, in the path's own unit a second.

    The first key stays at its moment. `is_timed` says whether these are times that somebody asked for. Raises
    ValueError for a speed that is not above 0.
    """
    if not 0 < speed < np.inf:
        raise ValueError(f"a speed of {speed:g}: must be above 0")
    if len(path.times_s) < 2:
        return replace(path, is_timed=is_timed)
    steps = np.linalg.norm(np.diff(path.positions, axis=0), axis=1) / speed
    alike = np.abs(np.einsum("ki,ki->k", path.quaternions_wxyz[:-1], path.quaternions_wxyz[1:]))
    turning = np.degrees(2 * np.arccos(np.clip(alike, 0, 1))) / _TURN_DEG_S
    steps = np.where(steps < _SHORTEST_S, np.maximum(turning, _SHORTEST_S), steps)
    times = path.times_s[0] + np.concatenate([[0.0], np.cumsum(steps)])
    return replace(path, times_s=times, is_timed=is_timed)
