"""Semantic classes of what a scene shows, as Cityscapes' training ids: what HUGSIM and most drivers speak."""

import numpy as np
from jaxtyping import UInt8

from gsrain_engine.scene.coco_classes import coco_class
from gsrain_engine.scene.members import Actor
from gsrain_engine.scene.scene import Scene

UNKNOWN = 255

_OF_CLASS = {
    "person": 11, "rider": 12, "cyclist": 12, "car": 13, "truck": 14, "bus": 15, "train": 16, "motorcycle": 17,
    "bicycle": 18, "traffic light": 6, "stop sign": 7,
}  # fmt: skip
_OF_LAYER = {
    "road": 0, "ground": 0, "pavements": 1, "sidewalk": 1, "houses": 2, "buildings": 2, "surroundings": 2,
    "furniture": 5, "trees": 8, "vegetation": 8, "sky": 10, "parked cars": 13, "parked trucks": 14,
}  # fmt: skip
"""Names of layers that say what they show; those of the built-in street among them."""


def semantic_ids(scene: Scene) -> UInt8[np.ndarray, " members_and_nothing"]:
    """Return the semantic id of each label of `draw_labels`; the first, for pixels that show nothing, is sky."""
    ids = [_OF_LAYER["sky"]]
    for member in scene.members:
        if isinstance(member, Actor):
            ids.append(_OF_CLASS.get(coco_class(member.class_name), UNKNOWN))
        else:
            ids.append(_OF_LAYER["sky"] if member.kind == "sky" else _OF_LAYER.get(member.name, UNKNOWN))
    return np.array(ids, np.uint8)
