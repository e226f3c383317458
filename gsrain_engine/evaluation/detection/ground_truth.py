"""Ground truth of object detection: labels from 3D boxes, rendered scenes and COCO files, and class matching."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64

from ...datasets.capture import TrackedBox
from ...render.object_labels import bounding_rectangle, convex_outline, cut_at_edges, visible_objects
from ...render.renderer import Renderer
from ...safe_io.text_files import json_values, printable_line, read_whole
from ...scene.camera import Camera
from ...scene.geometry import box_corners
from ...scene.objects import SceneObject, coco_class
from ...scene.scene import Scene

BoxXYXY = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels; the left edge of the first column is 0."""

MIN_VISIBILITY = 0.25
MIN_HEIGHT_PX = 16.0  # smaller or less visible objects are ignored: neither misses nor false detections


@dataclass(frozen=True, slots=True)
class LabeledObject:
    """One object in one image."""

    id: str
    """The same in every frame of a drive."""
    class_name: str
    """COCO name where one exists; see `label_class`."""
    box_xyxy: BoxXYXY
    """Bounding box clipped at the image edges; of the visible part for rendered objects."""
    visibility: float = 1.0
    """Visible area over the unoccluded area; 0..1."""
    distance_m: float | None = None
    """From the camera to its center; None if unknown."""
    is_ignored: bool = False
    """Such as a crowd: counts neither as a miss nor as a false detection."""

    @property
    def height_px(self) -> float:
        return self.box_xyxy[3] - self.box_xyxy[1]

    @property
    def counts(self) -> bool:
        """True if it is large and visible enough to be evaluated."""
        return not self.is_ignored and self.visibility >= MIN_VISIBILITY and self.height_px >= MIN_HEIGHT_PX


# Labels from 3D boxes


def ground_truth_from_boxes(boxes: Sequence[TrackedBox], camera: Camera, time_s: float) -> tuple[LabeledObject, ...]:
    """Project boxes into an undistorted camera, both in the capture's world (meters); the nearest one first.

    Labels bound the projected 3D box clipped at the image edges: a few percent larger than the object, and not reduced
    by occlusion. Visibility is the share of the outline that no nearer box covers; objects without boxes, such as
    walls, occlude nothing.
    """
    found = [(pose, box) for box in boxes if (pose := box.track.pose(time_s)) is not None]
    placed = [(camera.world_to_camera @ pose, box) for pose, box in found]
    placed.sort(key=lambda each: _distance(each[0], each[1]))
    covered = np.zeros((camera.height, camera.width), bool)
    truths: list[LabeledObject] = []
    for to_camera, box in placed:
        within = cut_at_edges(convex_outline(box_corners(to_camera, box.size_lwh), camera), camera)
        pixels = np.zeros(covered.shape, np.uint8)
        if len(within) >= 3:
            cv2.fillConvexPoly(pixels, np.floor(within).astype(np.int32), 1)
        own = pixels > 0
        if own.any():
            name, visibility = label_class(box.class_name), float((own & ~covered).sum() / own.sum())
            distance = _distance(to_camera, box)
            truths.append(LabeledObject(box.id, name, bounding_rectangle(within), visibility, distance))
            covered |= own
    return tuple(truths)


def _distance(to_camera: Float64[np.ndarray, "4 4"], box: TrackedBox) -> float:
    return float(np.linalg.norm(to_camera[:3, 3] + to_camera[:3, 2] * (box.size_lwh[2] / 2)))


# Labels from a rendered scene


def ground_truth_from_scene(
    renderer: Renderer, scene: Scene, objects: Sequence[SceneObject], camera: Camera, time_s: float
) -> tuple[LabeledObject, ...]:
    """Boxes of the pixels that objects show a camera in the world (meters), without rain; the nearest object first."""
    found = visible_objects(renderer, scene, objects, camera, time_s)
    names = [label_class(each.object.class_name) for each in found]
    return tuple(
        LabeledObject(each.object.id, name, each.box_xyxy, each.visibility, each.distance_m)
        for each, name in zip(found, names, strict=True)
    )


# Labels from a COCO file

_MAX_BYTES = 1 << 30  # COCO's own annotations of 118 000 images are 450 MB


def read_coco(file: Path) -> dict[str, tuple[LabeledObject, ...]]:
    """Read the objects of each image by its `file_name`, including images without objects.

    `visibility`, `distance_m` and `object`, extensions that `gsrain render --labels coco` writes, are read if present;
    crowds are ignored. Raises ValueError with the file and the problem.
    """
    try:
        document = json_values(read_whole(file, _MAX_BYTES))
        for name in ("categories", "images", "annotations"):
            rows = document.get(name, []) if isinstance(document, dict) else None
            if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
                raise ValueError(f"it has no {name}, a list of objects")
        classes = {int(each["id"]): str(each["name"]) for each in document["categories"]}
        names = {int(each["id"]): str(each["file_name"]).replace("\\", "/") for each in document["images"]}
        found: dict[str, list[LabeledObject]] = {name: [] for name in names.values()}
        for each in document["annotations"]:
            left, top, width, height = (float(number) for number in each["bbox"])
            distance = each.get("distance_m")
            found[names[int(each["image_id"])]].append(
                LabeledObject(
                    id=str(each.get("object", each["id"])),
                    class_name=label_class(classes[int(each["category_id"])]),
                    box_xyxy=(left, top, left + width, top + height),
                    visibility=float(each.get("visibility", 1.0)),
                    distance_m=None if distance is None else float(distance),
                    is_ignored=bool(each.get("iscrowd", 0)),
                )
            )
    except OSError as error:
        raise ValueError(f"{file}: can't be read ({error.strerror or error})") from None
    except KeyError as error:
        raise ValueError(
            f"{file}: a COCO file refers to {printable_line(repr(error.args[0]))}, which it lacks"
        ) from None
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f"{file}: not a COCO file of instances ({printable_line(error)})") from None
    return {name: tuple(objects) for name, objects in found.items()}


# Class matching

VEHICLE = "vehicle"  # class of datasets (Waymo Open) and detectors that do not distinguish kinds of vehicles
KINDS_OF_VEHICLES = frozenset({"car", "truck", "bus", "van", "trailer"})  # COCO classes that match a vehicle


@cache
def label_class(name: str) -> str:
    """Return the class of a dataset's `name`: `coco_class`, except that vehicles of unknown kind stay vehicles."""
    plain = name.strip().lower().rpartition(".")[2]
    return VEHICLE if plain.removeprefix("type_") == VEHICLE else coco_class(name)


@cache
def is_same_class(detected: str, labelled: str) -> bool:
    """True if classes are the same by `label_class`, or one is a vehicle and the other of `KINDS_OF_VEHICLES`."""
    detection, label = label_class(detected), label_class(labelled)
    general = detection if label == VEHICLE else label if detection == VEHICLE else None
    return detection == label or general in KINDS_OF_VEHICLES


def can_detect_class(classes: Collection[str], labelled: str) -> bool:
    """Return whether a detector with these classes can name an object; without a list of classes it can name all."""
    return not classes or any(is_same_class(each, labelled) for each in classes)
