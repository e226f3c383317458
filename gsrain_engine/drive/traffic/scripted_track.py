"""A road user on a track: an actor's of the scene, or places and times that the scenario lists."""

from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

import msgspec
import numpy as np
import scipy
from msgspec import Meta

from .behaviour import Behaviour, Surroundings
from .by_the_clock import ByTheClock
from .in_lane import InLane
from .recorded_track import RecordedTrack
from .road_user import RoadUser

if TYPE_CHECKING:
    from gsrain_engine.scene.scene import Scene


class TrackPoint(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A place at a time, from where the road user begins."""

    time_s: Annotated[
        float, Meta(gt=0, le=1e6, title="Time", description="Since the scenario began.", extra={"unit": "s"})
    ]
    ahead_m: Annotated[float, Meta(ge=-1e5, le=1e5, title="Ahead", description="Along the route.", extra={"unit": "m"})]
    left_m: Annotated[
        float, Meta(ge=-1e5, le=1e5, title="Left", description="Across it, seen in its direction.", extra={"unit": "m"})
    ] = 0.0


class OnTrack(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="track"):
    """Follows a track: of an actor, where and when it was recorded; or through points, smoothly, and then stands.

    Between points positions are monotone cubics of time (PCHIP: Fritsch and Butland 1984), so nothing overshoots.
    """

    actor: Annotated[str | None, Meta(title="Actor", description="Id of the scene's actor whose track it is.")] = None
    pace: Annotated[
        float, Meta(gt=0, le=10, title="Pace", description="Of an actor: 0.5 takes twice the recorded time.")
    ] = 1.0
    points: tuple[TrackPoint, ...] = ()

    def __post_init__(self) -> None:
        if (self.actor is None) != bool(self.points):
            raise ValueError("a track is either that of an `actor` or through `points`")
        times = [0.0, *(point.time_s for point in self.points)]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError("`points` must be in the order of their times, which are later than 0 s")

    def begin(self, scene: "Scene", start_s: float) -> Behaviour:
        """Make the rule for one run; raises ValueError where the scene has no such actor."""
        if self.actor is None:
            return _ThroughPoints(self.points)
        for actor in scene.actors:
            if actor.id == self.actor:
                return _LikeActor(RecordedTrack(scene, actor, start_s), self.pace)
        known = ", ".join(each.id for each in scene.actors) or "none"
        raise ValueError(f"track of actor {self.actor!r}: scene {scene.name!r} has only {known}")


class _LikeActor(ByTheClock):
    def __init__(self, track: RecordedTrack, pace: float) -> None:
        self._track, self._pace = track, pace

    def _at(self, me: RoadUser, time_s: float) -> RoadUser | None:
        there = self._track.at(time_s * self._pace)
        if there is None:
            return None
        speed = there.speed_m_s * self._pace
        return me.moved(x_m=there.x_m, y_m=there.y_m, yaw_rad=there.yaw_rad, speed_m_s=speed)


class _ThroughPoints:
    def __init__(self, points: tuple[TrackPoint, ...]) -> None:
        rows = [(0.0, 0.0, 0.0), *((point.time_s, point.ahead_m, point.left_m) for point in points)]
        times, ahead, left = np.array(rows).T
        self._end_s = float(times[-1])
        self._way = scipy.interpolate.PchipInterpolator(times, np.stack([ahead, left], axis=1))
        self._speed = self._way.derivative()
        self._from: InLane | None = None

    def start(self, placed: RoadUser) -> RoadUser | None:
        return placed

    def next(self, me: RoadUser | None, around: Surroundings, dt_s: float) -> RoadUser | None:
        if me is None:
            return None
        if self._from is None:
            self._from = InLane.of(around.route, me)
        time_s = min(around.time_s + dt_s, self._end_s)
        ahead, left = (float(value) for value in self._way(time_s))
        vx, vy = (float(value) for value in self._speed(time_s))
        x, y, heading = around.route.at(self._from.along_m + ahead, self._from.left_m + left)
        speed = float(np.hypot(vx, vy)) if around.time_s + dt_s < self._end_s else 0.0
        yaw = heading + float(np.arctan2(vy, vx)) if speed > 0.05 else me.yaw_rad
        return me.moved(x_m=x, y_m=y, yaw_rad=yaw, speed_m_s=speed)
