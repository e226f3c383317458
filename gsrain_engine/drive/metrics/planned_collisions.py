"""Whether what was planned would have hit something: the paper's rate by planned point, and HUGSIM's by frame."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from ..road.planar_box import PlanarBox
from ..rollouts.rollout import Rollout, RolloutStep
from ..rollouts.run_setting import planned_frames, run_setting
from ..vehicle.vehicle import Vehicle
from .logged_traffic import LoggedTraffic
from .planned_poses import PlanReading, ego_box, planned_poses


@runtime_checkable
class Touchable(Protocol):
    """What stands in the scene beside the road users, such as `OccupiedSpace`."""

    def touches(self, box: PlanarBox) -> bool:
        """Whether a box on the ground would hit it."""
        ...


class PlannedCollisions(NamedTuple):
    """c_ij of a run: frame by frame, whether each planned point hits something."""

    frames: tuple[tuple[bool, ...], ...]

    @property
    def points_per_frame(self) -> int:
        """N of the paper; the largest where plans differ in length, 0 without any."""
        return max((len(each) for each in self.frames), default=0)

    @property
    def point_rate(self) -> float | None:
        """C of the paper: the share of planned points that collide, over all frames and points, 0..1.

        C = 1/(F N) sum_i sum_j c_ij. None without a planned point.
        """
        points = [point for frame in self.frames for point in frame]
        return sum(points) / len(points) if points else None

    @property
    def frame_rate(self) -> float | None:
        """The share of frames with any point that collides, 0..1; 1 - mean(nc) of HUGSIM. None without a frame."""
        frames = [any(frame) for frame in self.frames if frame]
        return sum(frames) / len(frames) if frames else None


def planned_collisions(
    rollout: Rollout, occupied: Touchable | None = None, reading: PlanReading = "all"
) -> PlannedCollisions:
    """Put the vehicle's box at every planned point and see whether it touches anybody or anything.

    Point j of a frame is compared with where the road users really were (j + 1) times the plan's spacing later; beyond
    the end of the run with where they were last. `occupied` adds the background; without it only road users count.
    Sources: the paper's equation of C and its c_ij; futures after HUGSIM's `score_calculator`, see `future_times_s`.
    """
    vehicle, traffic = run_setting(rollout).vehicle, LoggedTraffic(rollout)
    frames: list[tuple[bool, ...]] = []
    for step in planned_frames(rollout):
        poses = planned_poses(step, reading)
        times = future_times_s(rollout, step, len(poses), reading)
        frames.append(tuple(pose_hits(vehicle, poses, times, traffic, occupied)))
    return PlannedCollisions(tuple(frames))


def future_times_s(rollout: Rollout, step: RolloutStep, count: int, reading: PlanReading) -> Float64[np.ndarray, " n"]:
    """Return the times of a plan's points, at which others are looked up.

    HUGSIM goes through the log in steps of the plan's spacing, and beyond its end uses the last that it has met: up to
    one spacing before the end of the run, where `all` uses the end itself.
    """
    times = step.time_s + rollout.spacing_s * np.arange(1, count + 1)
    if reading == "hugsim":
        left = rollout.steps[-1].time_s - step.time_s
        times = np.minimum(times, step.time_s + rollout.spacing_s * np.floor(left / rollout.spacing_s + 1e-6))
    return times


def pose_hits(
    vehicle: Vehicle,
    poses: Float64[np.ndarray, "n 3"],
    times_s: Sequence[float] | Float64[np.ndarray, " n"],
    traffic: LoggedTraffic,
    occupied: Touchable | None,
) -> Iterator[bool]:
    """Yield whether the vehicle would touch anybody, or the background, with its rear axle at each pose and time."""
    for pose, time_s in zip(poses, times_s, strict=True):
        box = ego_box(vehicle, pose)
        touched = any(box.touches(other) for other in traffic.at(float(time_s)))
        yield touched or (occupied is not None and occupied.touches(box))
