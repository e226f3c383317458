"""Classes of labels and of detectors: which word of a detector names a labelled object."""

from collections.abc import Collection
from functools import cache

from gsrain_engine.scene.coco_classes import coco_class

VEHICLE = "vehicle"
"""Class of data sets (Waymo Open) that tell no kinds of vehicles apart, and of detectors that don't."""
KINDS_OF_VEHICLES = frozenset({"car", "truck", "bus", "van", "trailer"})
"""Any of these is right for a vehicle; none of COCO's other classes is."""


@cache
def label_class(name: str) -> str:
    """Return the class of a data set's `name`: `coco_class`, but a vehicle of unknown kind stays a vehicle."""
    plain = name.strip().lower().rpartition(".")[2]
    return VEHICLE if plain.removeprefix("type_") == VEHICLE else coco_class(name)


@cache
def names_class(detected: str, labelled: str) -> bool:
    """Whether a detector's word is right for an object that is labelled so.

    Words of data sets stand for COCO's: Pedestrian is a person. A vehicle is any of `KINDS_OF_VEHICLES`, either way.
    """
    seen, label = label_class(detected), label_class(labelled)
    general = seen if label == VEHICLE else label if seen == VEHICLE else None
    return seen == label or general in KINDS_OF_VEHICLES


def can_name(classes: Collection[str], labelled: str) -> bool:
    """Whether a detector of these classes has a word for an object; one that lists none is taken to know all."""
    return not classes or any(names_class(each, labelled) for each in classes)
