"""Tracks and camera paths as they stand in `scene.json`."""

import msgspec
import numpy as np
from jaxtyping import Float64

from ..rotations import normalized
from ..track import Track

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class TrackRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `Track`, one entry a sample in every list."""

    times: list[float]
    positions: list[Vector]
    quaternions_wxyz: list[Quaternion]
    valid: list[bool]


def track_record(track: Track) -> TrackRecord:
    return TrackRecord(
        times=track.times.tolist(),
        positions=[(float(x), float(y), float(z)) for x, y, z in track.positions],
        quaternions_wxyz=[(float(w), float(x), float(y), float(z)) for w, x, y, z in track.quaternions_wxyz],
        valid=track.valid.tolist(),
    )


def track_of(record: TrackRecord, where: str) -> Track:
    """Track of plain values.

    Raises:
        ValueError: Where they contradict one another; `where` tells in which field of the file they stand.
    """
    n = len(record.times)
    if not n == len(record.positions) == len(record.quaternions_wxyz) == len(record.valid):
        raise ValueError(f"times, positions, quaternions_wxyz and valid must be equally long - at {where}")
    times = np.array(record.times, np.float64)
    positions = np.array(record.positions, np.float64).reshape(n, 3)
    if (np.diff(times) <= 0).any():
        raise ValueError(f"times must rise - at {where}")
    return Track(times, positions, unit_quaternions(record.quaternions_wxyz, where), np.array(record.valid, np.bool_))


def unit_quaternions(values: list[Quaternion], where: str) -> Float64[np.ndarray, "n 4"]:
    """Rotations of any length but zero, as unit quaternions; what is unit already stays as it is, to the bit.

    Raises:
        ValueError: When one is 0 or not finite.
    """
    quaternions = np.array(values, np.float64).reshape(len(values), 4)
    lengths = np.linalg.norm(quaternions, axis=1)
    bad = np.flatnonzero(~((lengths > 1e-9) & (lengths < 1e9)))
    if len(bad):
        raise ValueError(f"quaternion {bad[0]} must be above 0 long and finite, not {lengths[bad[0]]:g} - at {where}")
    exact = np.abs(lengths - 1) < 1e-12
    return np.where(exact[:, None], quaternions, normalized(quaternions))
