"""A camera that goes with an actor and keeps its offset to it, while a person still looks around."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.members import Actor
from gsrain_engine.scene.scene import Scene

from .navigation import Navigation


@dataclass(slots=True)
class Following:
    """Which actor is followed, and where it was when it was last looked at. World frame, metres."""

    key: str = ""
    """Of the actor; "" follows none."""
    velocity_m_s: Float64[np.ndarray, "3"] | None = None
    """Of the ride; None while nothing is followed or time stands."""
    _pose: Float64[np.ndarray, "4 4"] | None = None
    _time_s: float = 0.0

    def follow(self, key: str) -> None:
        """Go with an actor from where the camera is now; "" lets go."""
        self.key, self._pose, self.velocity_m_s = key, None, None

    def ride(self, scene: Scene, time_s: float, navigation: Navigation) -> None:
        """Carry the camera to where the actor has gone since the last call, and turn it as the actor has turned.

        While the actor is not in the scene the camera stays; a leap in time is a leap of the camera.
        """
        actor = next((each for each in scene.actors if each.key == self.key), None)
        pose = _level_pose(scene, actor, time_s) if actor is not None else None
        before, self.velocity_m_s = self._pose, None
        if actor is None:
            self.key = ""
        if pose is not None and before is not None and not np.array_equal(pose, before):
            step = pose @ np.linalg.inv(before)
            moved = step[:3, :3] @ navigation.position + step[:3, 3]
            if time_s > self._time_s:
                self.velocity_m_s = (moved - navigation.position) / (time_s - self._time_s)
            navigation.turn(float(np.arctan2(step[1, 0], step[0, 0])), 0.0)
            navigation.position = moved
        if pose is not None or actor is None:
            self._pose = pose
        self._time_s = time_s


def _level_pose(scene: Scene, actor: Actor, time_s: float) -> Float64[np.ndarray, "4 4"] | None:
    """Where an actor is and which way it heads: it may pitch and roll, the camera does not."""
    way = actor.way(time_s)
    if way is None:
        return None
    pose = scene.scene_to_world @ way
    heading = float(np.arctan2(pose[1, 0], pose[0, 0]))
    c, s = np.cos(heading), np.sin(heading)
    level = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    level[:3, 3] = pose[:3, 3]
    return level
