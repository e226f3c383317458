"""A road user that does again what was recorded: an actor of the scene on its own track."""

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.members import Actor
from gsrain_engine.scene.scene import Scene

from .behaviour import Surroundings
from .road_user import RoadUser

_STEP_S = 0.05
"""Half the time over which a speed is taken: tracks are linear between samples, mostly 100 ms apart."""


class RecordedTrack:
    """Follows an actor's track; the scenario begins at `start_s` of the scene's time."""

    def __init__(self, scene: Scene, actor: Actor, start_s: float) -> None:
        self._scene, self._actor, self._start_s = scene, actor, start_s

    def start(self, placed: RoadUser) -> RoadUser | None:
        """Return where it was recorded at the beginning, wherever it is placed."""
        return self.at(0.0)

    def next(self, me: RoadUser | None, around: Surroundings, dt_s: float) -> RoadUser | None:
        return self.at(around.time_s + dt_s)

    def at(self, time_s: float) -> RoadUser | None:
        """Return where it was recorded, so long after the scenario began; None while it was not there."""
        pose = self._pose(time_s)
        if pose is None:
            return None
        forward = pose[:2, 0] / np.linalg.norm(pose[:3, 0])
        speed = self._speed(time_s, forward)
        unit = self._scene.metres_per_unit
        length, width, height = (unit * side for side in self._actor.size_lwh)
        yaw = float(np.arctan2(forward[1], forward[0]))
        x, y, z = (float(value) for value in pose[:3, 3])
        return RoadUser(self._actor.id, self._actor.class_name, (length, width, height), x, y, yaw, max(speed, 0.0), z)

    def _speed(self, time_s: float, forward: Float64[np.ndarray, "2"]) -> float:
        """Speed along a direction: between places shortly before and after, as far as the track reaches."""
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
        way = self._actor.way(self._start_s + time_s)
        return None if way is None else self._scene.scene_to_world @ way
