"""Which pixels of a capture's view show vehicles: from its labels, or from boxes and depth."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from gsrain_engine.datasets.capture import TrackedBox, View
from gsrain_engine.datasets.pixels.moving_masks import box_outline
from gsrain_engine.datasets.pixels.view_rays import pixel_rays
from gsrain_engine.scene.street.labels import Label
from gsrain_engine.scene.vehicle_classes import is_vehicle

_MARGIN_M = 0.3
_WHEELS_M = 0.15
"""Heights over a box's bottom where the road shows through as much as the vehicle."""


def vehicle_pixels(
    view: View, boxes: Sequence[TrackedBox], depth: Float32[np.ndarray, "h w"]
) -> Bool[np.ndarray, "h w"]:
    """Which pixels show vehicles; none where neither labels (the street's classes) nor boxes tell.

    Args:
        view: Without distortion.
        boxes: Of the capture, in metres.
        depth: Along the view axis in metres, 0 where unknown: there the box's outline counts whole.
    """
    labels = view.labels
    if labels is not None:
        return (labels == Label.CAR) | (labels == Label.TRUCK)
    shown = np.zeros(depth.shape, np.bool_)
    for box in boxes:
        outline = box_outline(view, box) if is_vehicle(box.class_name) else np.zeros((0, 2))
        if len(outline) >= 3:
            covered = np.zeros(depth.shape, np.uint8)
            cv2.fillConvexPoly(covered, np.round(outline).astype(np.int32), 1)
            shown |= (covered > 0) & _in_box(view, box, depth)
    return shown


def _in_box(view: View, box: TrackedBox, depth: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Which pixels' surfaces lie in a box at the view's time, or may lie in it."""
    pose = box.track.pose(view.time_s)
    assert pose is not None  # it has an outline
    places = view.camera.position + depth[..., None] * pixel_rays(view.camera)
    local = (places - pose[:3, 3]) @ pose[:3, :3]
    length, width, height = box.size_lwh
    inside = (np.abs(local[..., :2]) <= np.array([length, width]) / 2 + _MARGIN_M).all(axis=-1)
    inside &= (local[..., 2] >= _WHEELS_M) & (local[..., 2] <= height + _MARGIN_M)
    return inside | (depth == 0)
