"""One scene brought into another."""

from dataclasses import replace

import numpy as np

from gsrain_engine.scene.members import Layer
from gsrain_engine.scene.scene import Scene

from .actors import moved_actor
from .members import named, names, with_members
from .names import unique_name


def import_scene(scene: Scene, other: Scene) -> Scene:
    """Return the scene with all members of another one, placed so that world frames agree: metres, z up, one origin.

    Names are made unique, selection sets come along. A scene without members becomes the other.
    """
    if not scene.members:
        return other
    way = np.linalg.inv(scene.scene_to_world) @ other.scene_to_world
    if np.allclose(way, np.eye(4), rtol=0, atol=1e-12):
        way = np.eye(4)
    result, keys = scene, dict[str, str]()
    for member in other.members:
        added = named(member, unique_name(member.name, names(result, member)))
        keys[member.key] = added.key
        is_layer = isinstance(added, Layer)
        placed = replace(added, to_scene=way @ added.to_scene) if is_layer else moved_actor(added, way)
        result = with_members(result, (*result.members, placed))
    sets = dict(scene.selections)
    for name, masks in other.selections.items():
        sets[unique_name(name, sets)] = {keys[key]: mask for key, mask in masks.items() if key in keys}
    return replace(result, selections=sets)
