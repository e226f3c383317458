"""Labelled objects out of a COCO file (annotations of instances), by the names of pictures."""

from pathlib import Path
from typing import Any

from gsrain_engine.untrusted.plain_values import json_values, read_whole
from gsrain_engine.untrusted.printable import printable

from .class_names import label_class
from .truth import LabelledObject

_MOST_BYTES = 1 << 30
"""COCO's own annotations of 118 000 pictures are 450 MB."""


def read_coco(file: Path) -> dict[str, tuple[LabelledObject, ...]]:
    """Read the objects of each picture by its `file_name`; pictures without any are there too.

    `visibility`, `distance_m` and `object`, which COCO lacks and `gsrain render --labels coco` writes, are read where
    they are; a crowd is ignored. Raises ValueError with the file and what is wrong with it.
    """
    try:
        document = json_values(read_whole(file, _MOST_BYTES))
        classes = {int(each["id"]): str(each["name"]) for each in document["categories"]}
        names = {int(each["id"]): str(each["file_name"]) for each in document["images"]}
        found: dict[str, list[LabelledObject]] = {name: [] for name in names.values()}
        for annotation in document["annotations"]:
            found[names[int(annotation["image_id"])]].append(_object(annotation, classes))
    except OSError as error:
        raise ValueError(f"{file}: can't be read ({error.strerror or error})") from None
    except KeyError as error:
        raise ValueError(f"{file}: a COCO file refers to {printable(repr(error.args[0]))}, which it lacks") from None
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f"{file}: not a COCO file of instances ({printable(error)})") from None
    return {name: tuple(objects) for name, objects in found.items()}


def _object(annotation: dict[str, Any], classes: dict[int, str]) -> LabelledObject:
    left, top, width, height = (float(each) for each in annotation["bbox"])
    distance = annotation.get("distance_m")
    return LabelledObject(
        id=str(annotation.get("object", annotation["id"])),
        class_name=label_class(classes[int(annotation["category_id"])]),
        box_xyxy=(left, top, left + width, top + height),
        visibility=float(annotation.get("visibility", 1.0)),
        distance_m=None if distance is None else float(distance),
        is_ignored=bool(annotation.get("iscrowd", 0)),
    )
