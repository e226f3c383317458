"""Labelled objects of a recorded view: the 3D boxes that people drew, projected into it."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float64

from gsrain_engine.datasets.capture import TrackedBox
from gsrain_engine.render.objects.box_outline import bounds, cut_at_edges, outline
from gsrain_engine.scene.box_corners import box_corners
from gsrain_engine.scene.camera import Camera

from .class_names import label_class
from .truth import LabelledObject


def truth_from_boxes(boxes: Sequence[TrackedBox], camera: Camera, time_s: float) -> tuple[LabelledObject, ...]:
    """Project boxes into a camera without distortion, both in the capture's world (metres); the nearest one first.

    A box is that of the projected 3D box cut at the picture's edges: a few percent larger than the thing itself, and
    not cut where something stands in front. Visibility is the share of the outline that no nearer box covers; what has
    no box, such as a wall, hides nothing.
    """
    found = [(pose, box) for box in boxes if (pose := box.track.pose(time_s)) is not None]
    placed = [(camera.world_to_camera @ pose, box) for pose, box in found]
    placed.sort(key=lambda each: _distance(each[0], each[1]))
    covered = np.zeros((camera.height, camera.width), bool)
    truths: list[LabelledObject] = []
    for to_camera, box in placed:
        within = cut_at_edges(outline(box_corners(to_camera, box.size_lwh), camera), camera)
        own = _filled(within, camera)
        if own.any():
            visibility = float((own & ~covered).sum() / own.sum())
            distance = _distance(to_camera, box)
            truths.append(LabelledObject(box.id, label_class(box.class_name), bounds(within), visibility, distance))
            covered |= own
    return tuple(truths)


def _distance(to_camera: Float64[np.ndarray, "4 4"], box: TrackedBox) -> float:
    return float(np.linalg.norm(to_camera[:3, 3] + to_camera[:3, 2] * (box.size_lwh[2] / 2)))


def _filled(polygon: Float64[np.ndarray, "c 2"], camera: Camera) -> Bool[np.ndarray, "h w"]:
    """Pixels within a convex polygon."""
    pixels = np.zeros((camera.height, camera.width), np.uint8)
    if len(polygon) >= 3:
        cv2.fillConvexPoly(pixels, np.floor(polygon).astype(np.int32), 1)
    return pixels > 0
