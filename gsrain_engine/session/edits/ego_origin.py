"""Where the ego vehicle starts, and where the scene's own origin lies."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.track import Track

SENSOR_HEIGHT_M = 1.5
"""Of the ego frame's origin above the ground, where nothing else is known."""


def set_ego_start(scene: Scene, ground_point_m: Float64[np.ndarray, "3"], heading_rad: float) -> Scene:
    """Let the ego vehicle start over a point of the ground, in the world (metres, z up).

    A drive is moved as a whole and keeps its direction and its height over its own start's ground. Where there is
    none, an ego that stands there is made, at sensor height, with a heading from +x to +y.
    """
    world_to_scene = np.linalg.inv(scene.scene_to_world)
    place = ground_point_m + np.array([0.0, 0.0, SENSOR_HEIGHT_M])
    if scene.ego is not None and len(scene.ego.times):
        there = np.eye(4)
        there[:3, 3] = world_to_scene[:3, :3] @ place + world_to_scene[:3, 3] - scene.ego.positions[0]
        return replace(scene, ego=scene.ego.moved(there))
    c, s = float(np.cos(heading_rad)), float(np.sin(heading_rad))
    pose = np.array([[c, -s, 0, place[0]], [s, c, 0, place[1]], [0, 0, 1, place[2]], [0, 0, 0, 1.0]])
    standing = Track(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones(1, np.bool_))
    return replace(scene, ego=standing.moved(world_to_scene @ pose))


def set_origin(scene: Scene, point_m: Float64[np.ndarray, "3"]) -> Scene:
    """Move everything so that a point of the world becomes its origin: layers, actors, ego, camera path, ground.

    Layers that are locked move too: they all keep their places beside one another.
    """
    shift = np.eye(4)
    shift[:3, 3] = -np.linalg.inv(scene.scene_to_world)[:3, :3] @ point_m
    return replace(
        scene,
        layers=tuple(replace(each, to_scene=shift @ each.to_scene) for each in scene.layers),
        actors=tuple(replace(each, track=each.track.moved(shift)) for each in scene.actors),
        ego=None if scene.ego is None else scene.ego.moved(shift),
        path=None if scene.path is None else scene.path.moved(shift),
        ground_m=None if scene.ground_m is None else scene.ground_m - float(point_m[2]),
    )
