"""Annotated boxes of single times put together into boxes over time."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.rotations import quaternions_from_matrices
from gsrain_engine.scene.track import Track

from ..capture import TrackedBox

_Pose = Float64[np.ndarray, "4 4"]
_LONGEST_M = 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class BoxSample:
    """One annotation: a box at one time."""

    id: str
    class_name: str
    time_s: float
    size_lwh: tuple[float, float, float]
    """Metres."""
    center_to_world: Float64[np.ndarray, "4 4"]
    """Box (x forward, y left, z up, origin at its centre) to world."""

    def __post_init__(self) -> None:
        if not all(0 < side < _LONGEST_M for side in self.size_lwh):
            raise ValueError(f"box {self.id!r} has sides {self.size_lwh}, expected 0 to {_LONGEST_M:g} m")
        if not (np.isfinite(self.center_to_world).all() and np.isfinite(self.time_s)):
            raise ValueError(f"box {self.id!r} has a pose or a time that is not finite")

    @property
    def bottom_to_world(self) -> _Pose:
        """Same axes, origin at the bottom centre."""
        matrix = self.center_to_world.copy()
        matrix[:3, 3] -= matrix[:3, 2] * (self.size_lwh[2] / 2)
        return matrix


def tracked_boxes(samples: Iterable[BoxSample], times_s: Sequence[float]) -> tuple[TrackedBox, ...]:
    """Join the annotations of each thing; `times_s` are all times that were annotated, with or without boxes.

    A thing is there from half-way after the last time without it to half-way before the next one; in these halves, and
    as far outside the annotated times, it moves on as it did, for cameras fire between lidar sweeps. Its size is the
    median.
    """
    stamps = np.unique([time for time in times_s if np.isfinite(time)])
    by_id: dict[str, dict[int, BoxSample]] = defaultdict(dict)
    for sample in samples:
        by_id[sample.id][int(np.argmin(np.abs(stamps - sample.time_s)))] = sample
    return tuple(_tracked(found, stamps) for found in by_id.values())


def _tracked(found: dict[int, BoxSample], stamps: Float64[np.ndarray, " t"]) -> TrackedBox:
    rows: list[tuple[float, _Pose, bool]] = []
    for run in _runs(sorted(found)):
        poses = [found[index].bottom_to_world for index in run]
        before, after = _half_gap(stamps, run[0], -1), _half_gap(stamps, run[-1], +1)
        if not rows and run[0] > 0:
            rows.append((float(stamps[run[0] - 1]), poses[0], False))
        times = [float(stamps[index]) for index in run]
        if before:
            rows.append((times[0] - before, _moved_on(poses[0], poses[1:2], times[:2], -before), True))
        rows += [(time, pose, True) for time, pose in zip(times, poses, strict=True)]
        if after:
            ended = run[-1] < len(stamps) - 1
            rows.append((times[-1] + after, _moved_on(poses[-1], poses[-2:-1], times[-2:], after), not ended))
    matrices = np.stack([pose for _, pose, _ in rows])
    quaternions = quaternions_from_matrices(matrices[:, :3, :3])
    valid = np.array([present for _, _, present in rows])
    track = Track(np.array([time for time, _, _ in rows]), matrices[:, :3, 3].copy(), quaternions, valid)
    length, width, height = np.median([each.size_lwh for each in found.values()], axis=0).tolist()
    first = next(iter(found.values()))
    return TrackedBox(first.id, first.class_name, (length, width, height), track)


def _runs(indices: Sequence[int]) -> list[list[int]]:
    """Split rising numbers where one is left out."""
    runs: list[list[int]] = []
    for index in indices:
        if runs and index == runs[-1][-1] + 1:
            runs[-1].append(index)
        else:
            runs.append([index])
    return runs


def _half_gap(stamps: Float64[np.ndarray, " t"], index: int, side: int) -> float:
    """Half the time to the neighbour on one side; at an end of the drive, that on the other side."""
    other = index + side if 0 <= index + side < len(stamps) else index - side
    return float(abs(stamps[other] - stamps[index]) / 2) if 0 <= other < len(stamps) else 0.0


def _moved_on(pose: _Pose, neighbours: Sequence[_Pose], times: Sequence[float], by_s: float) -> _Pose:
    """Move a pose on in time, as fast as between it and its neighbour."""
    matrix = pose.copy()
    if neighbours:
        step = pose[:3, 3] - neighbours[0][:3, 3]
        matrix[:3, 3] += step / abs(times[1] - times[0]) * abs(by_s)
    return matrix
