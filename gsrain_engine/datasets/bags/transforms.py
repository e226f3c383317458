"""Tree of frames: transforms over time (tf2), looked up at the times of images and lidar turns."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Int64

from ...scene.geometry import quaternions_from_matrices
from ...scene.scene import PoseTrack
from ..geometry import Pose
from .messages import Transform

_LATEST_S = 0.25
"""Maximum time from the first or last transform of a moving frame, at which it is held: tf2 does not extrapolate, but
recordings begin and end with single sensors."""

_LONGEST_CHAIN = 100


@dataclass(eq=False)
class _Edge:
    """Transforms of one frame to its parent."""

    parent: str
    times_ns: list[int] = field(default_factory=list[int])
    poses: list[Pose] = field(default_factory=list[Pose])
    is_static: bool = False

    @cached_property
    def _track(self) -> tuple[Int64[np.ndarray, " t"], PoseTrack]:
        """Times, rising, and the track over seconds from the first; of several poses at one time the last counts."""
        latest = dict(zip(self.times_ns, self.poses, strict=True))
        times = np.array(sorted(latest), np.int64)
        poses = np.stack([latest[time] for time in times.tolist()])
        turns = quaternions_from_matrices(poses[:, :3, :3])
        seconds = (times - times[0]).astype(np.float64) * 1e-9
        return times, PoseTrack(seconds, poses[:, :3, 3].copy(), turns, np.ones(len(times), np.bool_))

    @property
    def moves(self) -> bool:
        return not self.is_static and any(not np.array_equal(each, self.poses[0]) for each in self.poses)

    def at(self, time_ns: int) -> Pose | None:
        """Interpolate the pose; None if the time is too far from the recorded ones."""
        if self.is_static or len(self.poses) == 1:
            return self.poses[-1]
        times, track = self._track
        if not times[0] - 1e9 * _LATEST_S <= time_ns <= times[-1] + 1e9 * _LATEST_S:
            return None
        return track.pose(float(np.clip((time_ns - times[0]) * 1e-9, track.times[0], track.times[-1])))


class FrameTree:
    """Frames and their transforms. A frame has one parent: the first that is recorded."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}
        self.conflicts: dict[str, set[str]] = defaultdict(set)
        """Other parents of frames, which are ignored."""

    def add(self, transforms: Iterable[Transform], *, is_static: bool) -> None:
        for each in transforms:
            if not each.child or each.child == each.parent:
                continue
            edge = self._edges.setdefault(each.child, _Edge(each.parent))
            if edge.parent != each.parent:
                self.conflicts[each.child].add(each.parent)
                continue
            edge.is_static |= is_static
            edge.times_ns.append(each.time_ns)
            edge.poses.append(each.to_parent)

    def __contains__(self, frame: str) -> bool:
        return frame in self._edges or any(edge.parent == frame for edge in self._edges.values())

    def chain(self, frame: str) -> list[str]:
        """Frames from one up to the root of its tree. Raises ValueError if they go round in a circle."""
        found = [frame]
        while found[-1] in self._edges:
            found.append(self._edges[found[-1]].parent)
            if len(found) > _LONGEST_CHAIN or found[-1] in found[:-1]:
                raise ValueError(f"the frames above {frame!r} go round in a circle, by {found[-1]!r}")
        return found

    def moving_frame(self, frame: str) -> str | None:
        """Frame at or above a frame, nearest to it, that moves in its parent: the vehicle; None if nothing moves."""
        return next((each for each in self.chain(frame)[:-1] if self._edges[each].moves), None)

    def pose(self, frame: str, root: str, time_ns: int) -> Pose:
        """Pose of a frame in one above it. Raises ValueError without transforms at the time."""
        pose = np.eye(4)
        for each in self.chain(frame):
            if each == root:
                return pose
            edge = self._edges.get(each)
            if edge is None:
                break
            to_parent = edge.at(time_ns)
            if to_parent is None:
                raise ValueError(f"no transform from {each!r} to {edge.parent!r} is recorded at its time")
            pose = to_parent @ pose
        raise ValueError(f"no transform from {frame!r} to {root!r} is recorded")

    def times_ns(self, frame: str) -> Int64[np.ndarray, " t"]:
        """Times of a frame's own transforms, rising."""
        return np.unique(np.array(self._edges[frame].times_ns, np.int64))
