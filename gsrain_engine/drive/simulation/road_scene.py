"""The scene with everybody where they are at a moment of a drive."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.members import Actor
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.track import Track

from ..traffic.models import UserLook, scaled
from ..traffic.road_user import RoadUser


class RoadScene:
    """A scene whose actors are the scenario's road users."""

    def __init__(self, scene: Scene, looks: dict[str, UserLook]) -> None:
        """Show road users by their looks; who has none is an actor of the scene."""
        self.scene = scene
        self._world_to_scene = np.linalg.inv(scene.scene_to_world)
        unit = 1 / scene.metres_per_unit
        self._gaussians = {id: scaled(look.gaussians, unit) for id, look in looks.items()}
        self._recorded = {actor.id: actor for actor in scene.actors}

    def at(self, rig_to_world: Float64[np.ndarray, "4 4"], users: tuple[RoadUser, ...]) -> Scene:
        """Return the scene with the ego vehicle's rig and road users in their places, at any time."""
        actors = tuple(self._actor(user) for user in users)
        return replace(self.scene, actors=actors, ego=Track.standing(self._world_to_scene @ rig_to_world))

    def _actor(self, user: RoadUser) -> Actor:
        track = Track.standing(self._world_to_scene @ user.pose)
        if user.id not in self._gaussians:
            return replace(self._recorded[user.id], track=track)
        unit = self.scene.metres_per_unit
        length, width, height = (side / unit for side in user.size_lwh)
        gaussians = self._gaussians[user.id]
        return Actor(user.id, user.class_name, (length, width, height), gaussians, track)
