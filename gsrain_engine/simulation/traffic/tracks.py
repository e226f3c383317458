"""Behaviors along given tracks: recorded actors, replays of roll-outs, and scripted tracks."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import scipy
from jaxtyping import Float64

from ...scene.scene import Actor, Scene
from ..geometry import wrap_angle
from ..rollout import Rollout
from ..rollout_io import read_any_rollout
from ..vehicle import vehicle_box
from ..vehicle_settings import EGO
from .base import Behavior, LanePosition, RoadUser, TrafficState
from .settings import Replay, ScriptedTrack, TrackPoint

_STEP_S = 0.05  # half the interval for speed estimates; tracks are linear between samples, mostly 100 ms apart


class RecordedTrack:
    """Follows an actor's track; the scenario begins at `start_s` of the scene's time."""

    def __init__(self, scene: Scene, actor: Actor, start_s: float) -> None:
        self._scene, self._actor, self._start_s = scene, actor, start_s

    def at(self, time_s: float) -> RoadUser | None:
        """Return the recorded state at a time since the scenario began; None if absent."""
        pose = self._pose(time_s)
        if pose is None:
            return None
        forward = pose[:2, 0] / np.linalg.norm(pose[:3, 0])
        unit = self._scene.metres_per_unit
        length, width, height = (unit * side for side in self._actor.size_lwh)
        yaw = float(np.arctan2(forward[1], forward[0]))
        x, y, z = (float(value) for value in pose[:3, 3])
        speed = max(self._speed(time_s, forward), 0.0)
        return RoadUser(self._actor.id, self._actor.class_name, (length, width, height), x, y, yaw, speed, z)

    def _speed(self, time_s: float, forward: Float64[np.ndarray, "2"]) -> float:
        """Return the speed along a direction by a central difference, one-sided at the ends of the track."""
        first, last = self._actor.track.times[[0, -1]] - self._start_s
        begin, end = max(time_s - _STEP_S, float(first)), min(time_s + _STEP_S, float(last))
        before, after = self._pose(begin), self._pose(end)
        if before is None:
            begin, before = time_s, self._pose(time_s)
        if after is None:
            end, after = time_s, self._pose(time_s)
        if before is None or after is None or end - begin < _STEP_S / 2:
            return 0.0
        return float((after[:2, 3] - before[:2, 3]) @ forward) / (end - begin)

    def _pose(self, time_s: float) -> Float64[np.ndarray, "4 4"] | None:
        pose = self._actor.pose_at(self._start_s + time_s)
        return None if pose is None else self._scene.scene_to_world @ pose


def replaying(settings: Replay) -> Behavior:
    """Create the behavior of one run; raises ValueError for a missing file or an unknown id."""
    path = Path(settings.rollout)
    if not path.is_file():
        raise ValueError(f"{path}: no such roll-out")
    moments = _moments(read_any_rollout(path), settings.user)
    if not len(moments):
        raise ValueError(f"{path}: nobody is called {settings.user!r} in this roll-out")
    return TimedBehavior(partial(_replayed, moments))


def _moments(rollout: Rollout, user: str) -> Float64[np.ndarray, "n 5"]:
    """Return time, x, y, heading and speed of a road user's center at each step; NaN while absent."""
    rows: list[tuple[float, ...]] = []
    absent = (float("nan"),) * 4
    vehicle = rollout.vehicle
    for step in rollout.steps:
        if user == EGO:
            box = vehicle_box(vehicle, step.ego.state)
            rows.append((step.time_s, box.x_m, box.y_m, box.yaw_rad, step.ego.speed_m_s))
            continue
        here = next((each for each in step.road_users if each.id == user), None)
        place = absent if here is None else (here.x_m, here.y_m, here.yaw_rad, here.speed_m_s)
        rows.append((step.time_s, *place))
    moments = np.array(rows)
    return moments if np.isfinite(moments).all(axis=1).any() else moments[:0]


class TimedBehavior(Behavior):
    """Behavior that depends on time alone."""

    def __init__(self, at: Callable[[RoadUser, float], RoadUser | None]) -> None:
        """Use `at(me, time_s)`, the state at a time since the scenario began; all else is as in `me`."""
        self._at = at

    def start(self, placed: RoadUser) -> RoadUser | None:
        return self._at(placed, 0.0)

    def next(self, me: RoadUser, around: TrafficState, dt_s: float) -> RoadUser | None:
        return self._at(me, around.time_s + dt_s)


def _replayed(moments: Float64[np.ndarray, "n 5"], me: RoadUser, time_s: float) -> RoadUser | None:
    """Return the state at a time; after the end of the roll-out it stands at the last place."""
    times = moments[:, 0]
    later = int(np.searchsorted(times, time_s - 1e-9))
    if later >= len(times):
        return _moved(me, moments[-1] * [1, 1, 1, 1, 0])
    earlier = max(later - 1, 0)
    span = times[later] - times[earlier]
    share = (time_s - times[earlier]) / span if span > 0 else 1.0
    first, last = moments[earlier], moments[later].copy()
    if share > 1 - 1e-9:
        return _moved(me, last)
    last[3] = first[3] + wrap_angle(float(last[3] - first[3]))
    return _moved(me, (1 - share) * first + share * last)


def _moved(me: RoadUser, moment: Float64[np.ndarray, "5"]) -> RoadUser | None:
    _, x, y, yaw, speed = (float(value) for value in moment)
    return replace(me, x_m=x, y_m=y, yaw_rad=yaw, speed_m_s=speed) if np.isfinite(moment).all() else None


# Scripted tracks


def on_track(settings: ScriptedTrack, scene: Scene, start_s: float) -> Behavior:
    """Create the behavior of one run; raises ValueError if the scene has no such actor."""
    if settings.actor is None:
        return _WaypointBehavior(settings.points)
    for actor in scene.actors:
        if actor.id == settings.actor:
            return TimedBehavior(partial(_on_track, RecordedTrack(scene, actor, start_s), settings.pace))
    known = ", ".join(each.id for each in scene.actors) or "none"
    raise ValueError(f"track of actor {settings.actor!r}: scene {scene.name!r} has only {known}")


def _on_track(track: RecordedTrack, pace: float, me: RoadUser, time_s: float) -> RoadUser | None:
    there = track.at(time_s * pace)
    if there is None:
        return None
    return replace(me, x_m=there.x_m, y_m=there.y_m, yaw_rad=there.yaw_rad, speed_m_s=there.speed_m_s * pace)


class _WaypointBehavior(Behavior):
    def __init__(self, points: tuple[TrackPoint, ...]) -> None:
        rows = [(0.0, 0.0, 0.0), *((point.time_s, point.ahead_m, point.left_m) for point in points)]
        times, ahead, left = np.array(rows).T
        self._end_s = float(times[-1])
        self._path = scipy.interpolate.PchipInterpolator(times, np.stack([ahead, left], axis=1))
        self._speed = self._path.derivative()
        self._from: LanePosition | None = None

    def next(self, me: RoadUser, around: TrafficState, dt_s: float) -> RoadUser:
        if self._from is None:
            self._from = LanePosition.of(around.route, me)
        time_s = min(around.time_s + dt_s, self._end_s)
        ahead, left = (float(value) for value in self._path(time_s))
        vx, vy = (float(value) for value in self._speed(time_s))
        x, y, heading = around.route.at(self._from.along_m + ahead, self._from.left_m + left)
        speed = float(np.hypot(vx, vy)) if around.time_s + dt_s < self._end_s else 0.0
        yaw = heading + float(np.arctan2(vy, vx)) if speed > 0.05 else me.yaw_rad
        return replace(me, x_m=x, y_m=y, yaw_rad=yaw, speed_m_s=speed)
