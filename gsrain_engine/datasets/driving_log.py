"""Driving log in a dataset's own frames, and its conversion to a capture."""

from collections import Counter
from collections.abc import Generator, Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from math import isfinite

import numpy as np
from jaxtyping import Float, Float32, Float64

from ..scene.geometry import quaternions_from_matrices
from ..scene.scene import PoseTrack
from .capture import EGO_HEIGHT_M, Capture, CaptureError, CaptureFrame, LidarSource, LidarSweep
from .geometry import BoxSample, Pose, road_height, tracked_boxes, transform_points, translation_pose
from .io.arrays import what_is_wrong

MAX_POINTS = 24_000_000
"""Maximum number of lidar points of a capture (0.4 GB); longer drives keep every k-th point."""

_FARTHEST_M = 1e5
_ROAD_SCANS, _MAX_PROBLEMS = 8, 24
_FEWER = 0.9  # share of the images of the busiest camera, below which images are missing


@dataclass(frozen=True, slots=True, eq=False)
class LidarScan:
    """One sweep of a lidar, in the frame of the vehicle (x forward, y left, z up, meters)."""

    time_s: float
    vehicle_to_world: Pose
    points_m: Float[np.ndarray, "p 3"]
    origin_m: Float64[np.ndarray, "3"]
    intensities: Float32[np.ndarray, " p"] | None = None
    key: Hashable | None = None
    """File or position in the recording; None if it can't be written anew."""
    stored_to_vehicle: Pose | None = None
    """Stored points to the frame of the vehicle; None if they are in it."""

    def __post_init__(self) -> None:
        if not np.isfinite(self.time_s):
            raise ValueError("its time is not finite")
        if len(self.points_m) and not np.abs(self.points_m).max() < _FARTHEST_M:
            raise ValueError(f"holds points that are not finite, or farther than {_FARTHEST_M / 1000:g} km")

    @classmethod
    def placed(
        cls,
        time_s: float,
        vehicle_to_world: Pose,
        lidar_to_vehicle: Pose,
        points_m: Float[np.ndarray, "p 3"],
        intensities: Float32[np.ndarray, " p"] | None,
        key: Hashable | None = None,
        origin_m: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> "LidarScan":
        """Scan of points in the lidar's own frame, or in another one in which the lidar is at `origin_m`."""
        points = transform_points(lidar_to_vehicle, points_m)
        origin = transform_points(lidar_to_vehicle, np.array([origin_m], np.float64))[0]
        return cls(time_s, vehicle_to_world, points, origin, intensities, key, lidar_to_vehicle)


@dataclass(slots=True, eq=False)
class DrivingLog:
    """A drive in the dataset's own world (meters, z up) and clock (seconds), filled by a reader."""

    name: str
    road_m: float
    """Height of the road in the vehicle's frame according to the dataset."""
    views: list[CaptureFrame] = field(default_factory=list[CaptureFrame])
    """Views with times of the dataset's clock and cameras in its world."""
    stamps: list[tuple[float, Pose]] = field(default_factory=list[tuple[float, Pose]])
    """Poses of the vehicle: time, vehicle to world."""
    scans: Iterable[LidarScan] = ()
    scan_count: int = 0
    boxes: list[BoxSample] = field(default_factory=list[BoxSample])
    box_times_s: list[float] = field(default_factory=list[float])
    problems: list[str] = field(default_factory=list[str])

    @contextmanager
    def omitting(
        self, what: str, faults: type[Exception] | tuple[type[Exception], ...] = ValueError
    ) -> Generator[None]:
        """Turn an error of the block (by default `CaptureError` and ValueError) into the problem "`what` left out"."""
        try:
            yield
        except faults as error:
            self.problems.append(f"{what} left out: {what_is_wrong(error)}")

    def capture(self) -> Capture:
        """Move the origin to the ego's first position and time 0 to the first view; `CaptureError` without views."""
        self.problems.extend(f"{v.name} left out: its time is not finite" for v in self.views if not isfinite(v.time_s))
        self.views = [view for view in self.views if isfinite(view.time_s)]
        if not self.views:
            raise CaptureError(f"{self.name}: no picture that can be used" + _because(self.problems))
        stamps = sorted(dict(stamp for stamp in self.stamps if isfinite(stamp[0])).items(), key=lambda stamp: stamp[0])
        if not stamps:
            raise CaptureError(f"{self.name}: no place of the vehicle is known" + _because(self.problems))
        scans = iter(self.scans)
        first = [scan for _, scan in zip(range(_ROAD_SCANS), scans, strict=False)]
        road_m = road_height((scan.points_m for scan in first), self.road_m)
        above_road = translation_pose(np.array([0.0, 0.0, road_m + EGO_HEIGHT_M]))
        ego = np.stack([pose @ above_road for _, pose in stamps])
        shift = translation_pose(-ego[0, :3, 3])
        start = min(view.time_s for view in self.views)
        counted = Counter(view.sensor for view in self.views)
        most = max(counted.values())
        for sensor, count in counted.items():
            if count < _FEWER * most:
                self.problems.append(f"{sensor} has pictures of {count} moments, another camera of {most}")
        boxes = tracked_boxes(self.boxes, self.box_times_s or [box.time_s for box in self.boxes])
        sweeps = tuple(_sweeps(chain(first, scans), self._stride(first), shift, start))
        return Capture(
            self.name,
            tuple(replace(v, camera=v.camera.moved(shift), time_s=_since(start, v.time_s)) for v in self.views),
            sweeps=sweeps,
            boxes=tuple(replace(box, track=_moved(box.track, shift, start)) for box in boxes),
            ego=PoseTrack(
                np.array([_since(start, time) for time, _ in stamps]),
                (ego[:, :3, 3] + shift[:3, 3]),
                quaternions_from_matrices(ego[:, :3, :3]),
                np.ones(len(stamps), np.bool_),
            ),
            problems=_shortened_list(self.problems),
        )

    def _stride(self, first: Sequence[LidarScan]) -> int:
        each = float(np.mean([len(scan.points_m) for scan in first])) if first else 0.0
        stride = max(int(np.ceil(each * self.scan_count / MAX_POINTS)), 1)
        if stride > 1:
            self.problems.append(f"the lidar is too long a record for the memory: 1 of {stride} points is kept")
        return stride


def _sweeps(scans: Iterable[LidarScan], stride: int, shift: Pose, start_s: float) -> Iterator[LidarSweep]:
    for scan in scans:
        to_world = shift @ scan.vehicle_to_world
        points = transform_points(to_world, scan.points_m[::stride].astype(np.float64)).astype(np.float32)
        origin = transform_points(to_world, scan.origin_m[None])[0]
        intensities = None if scan.intensities is None else np.ascontiguousarray(scan.intensities[::stride])
        stored = to_world if scan.stored_to_vehicle is None else to_world @ scan.stored_to_vehicle
        source = None if scan.key is None else LidarSource(scan.key, stored)
        yield LidarSweep(_since(start_s, scan.time_s), points, origin, intensities, source)


def _moved(track: PoseTrack, shift: Pose, start_s: float) -> PoseTrack:
    moved = track.moved(shift)
    return replace(moved, times=np.round(moved.times - start_s, 6))


def _since(start_s: float, time_s: float) -> float:
    """Seconds since a time, rounded to remove the precision loss of large time stamps."""
    return round(time_s - start_s, 6)


def _shortened_list(problems: Sequence[str]) -> tuple[str, ...]:
    """First problems and the number of others: a download without images has one problem for each."""
    more = len(problems) - _MAX_PROBLEMS
    return (*problems[:_MAX_PROBLEMS], f"and {more} more problems like these") if more > 1 else tuple(problems)


def _because(problems: Sequence[str]) -> str:
    """Last reason in parentheses; the first ones are often unrelated notes."""
    more = f", and {len(problems) - 1} more problems" if len(problems) > 1 else ""
    return f" ({problems[-1]}{more})" if problems else ""
