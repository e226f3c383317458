"""Labels of rendered frames as COCO's JSON: boxes, instance masks, and beyond COCO visibility and 3D boxes."""

from collections.abc import Sequence
from typing import Any

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.coco_classes import COCO_CATEGORIES, coco_class

from .run_lengths import packed
from .seen_objects import SeenObject

_FIRST_OWN = 1000
"""Category ids of classes that COCO lacks begin here."""


class CocoLabels:
    """Collects the frames of one camera; `document` is the file's content."""

    def __init__(self, scene: str) -> None:
        self._scene = scene
        self._images: list[dict[str, Any]] = []
        self._annotations: list[dict[str, Any]] = []
        self._own_classes: dict[str, int] = {}

    def add(self, number: int, time_s: float, camera: Camera, seen: Sequence[SeenObject], **files: str) -> None:
        """Add a frame; `files` are its files by kind, of which COCO knows `file_name`."""
        image_id = len(self._images) + 1
        self._images.append(
            {
                "id": image_id,
                "width": camera.width,
                "height": camera.height,
                **files,
                "frame": number,
                "time_s": time_s,
                "camera": camera.to_json(),
            }
        )
        for each in seen:
            self._annotations.append(self._annotation(len(self._annotations) + 1, image_id, each))

    @property
    def document(self) -> dict[str, Any]:
        """The whole file as plain values."""
        categories = COCO_CATEGORIES | self._own_classes
        return {
            "info": {
                "description": f"Rendered frames of {self._scene}: boxes and masks are those of visible pixels; "
                "rain does not change them. box_3d is in the camera's frame (x right, y down, z forward), metres.",
                "version": "1",
            },
            "licenses": [],
            "images": self._images,
            "annotations": self._annotations,
            "categories": [{"id": number, "name": name} for name, number in categories.items()],
        }

    def _annotation(self, number: int, image_id: int, seen: SeenObject) -> dict[str, Any]:
        left, top, right, bottom = seen.box_xyxy
        return {
            "id": number,
            "image_id": image_id,
            "category_id": self._category(seen.object.class_name),
            "bbox": [left, top, right - left, bottom - top],
            "area": int(seen.mask.sum()),
            "segmentation": packed(seen.mask),
            "iscrowd": 0,
            "object": seen.object.id,
            "visibility": round(seen.visibility, 4),
            "truncation": round(seen.truncation, 4),
            "distance_m": round(seen.distance_m, 3),
            "box_3d": {
                "size_lwh_m": [round(side, 4) for side in seen.size_lwh_m],
                "object_to_camera": seen.to_camera.round(6).tolist(),
            },
        }

    def _category(self, class_name: str) -> int:
        name = coco_class(class_name)
        if name in COCO_CATEGORIES:
            return COCO_CATEGORIES[name]
        return self._own_classes.setdefault(name, _FIRST_OWN + len(self._own_classes))
