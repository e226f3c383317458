"""Vehicle masks of a capture's views, and a color-guided filter that fills in unknown values."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from ..datasets.capture import CaptureFrame, TrackedBox
from ..datasets.masks import box_outline, pixel_rays
from ..scene.objects import is_vehicle
from ..scene.street.layout import Label

_MARGIN_M = 0.3
_WHEELS_M = 0.15  # height above a box's bottom below which pixels show the road as much as the vehicle


def vehicle_pixels(
    view: CaptureFrame, boxes: Sequence[TrackedBox], depth: Float32[np.ndarray, "h w"]
) -> Bool[np.ndarray, "h w"]:
    """Return a mask of vehicles, from labels (the street's classes) or else boxes; all False without either.

    Args:
        view: Frame without lens distortion.
        boxes: Boxes of the capture, in meters.
        depth: Along the view axis in meters, 0 where unknown; there the box's whole outline counts.
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


def _in_box(view: CaptureFrame, box: TrackedBox, depth: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Return a mask of pixels whose surface lies in a box at the view's time; True at unknown depth."""
    pose = box.track.pose(view.time_s)
    assert pose is not None  # it has an outline
    places = view.camera.position + depth[..., None] * pixel_rays(view.camera)
    local = (places - pose[:3, 3]) @ pose[:3, :3]
    length, width, height = box.size_lwh
    inside = (np.abs(local[..., :2]) <= np.array([length, width]) / 2 + _MARGIN_M).all(axis=-1)
    inside &= (local[..., 2] >= _WHEELS_M) & (local[..., 2] <= height + _MARGIN_M)
    return inside | (depth == 0)


# Guided filter (He, Sun and Tang 2013), over known values only


def color_guided_filter(
    values: Float32[np.ndarray, "h w"],
    guide: Float32[np.ndarray, "h w 3"],
    known: Bool[np.ndarray, "h w"],
    radius_px: int,
    spread: float,
) -> Float32[np.ndarray, "h w"]:
    """Fit values by a linear function of the guide's color in each window, and take the mean of the fits.

    Args:
        values: Values to smooth.
        guide: Display color, 0..1.
        known: Mask of valid values; other pixels are filled from their neighbors.
        radius_px: Window radius.
        spread: Standard deviation of color below which nothing counts as an edge.
    """
    side = (2 * radius_px + 1, 2 * radius_px + 1)

    def mean(each: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.blur(each, side, borderType=cv2.BORDER_REFLECT))

    weight = known.astype(np.float32)
    total = np.maximum(mean(weight), 1e-6)
    color = mean(guide * weight[..., None]) / total[..., None]
    value = mean(values * weight) / total
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    covariance = np.zeros((*values.shape, 3, 3), np.float32)
    for i, j in pairs:
        product = mean(guide[..., i] * guide[..., j] * weight) / total - color[..., i] * color[..., j]
        covariance[..., i, j] = covariance[..., j, i] = product
    covariance[..., range(3), range(3)] += np.float32(spread**2)
    with_value = mean(guide * (values * weight)[..., None]) / total[..., None] - color * value[..., None]
    slope = np.linalg.solve(covariance, with_value[..., None])[..., 0]
    offset = value - (slope * color).sum(axis=-1)
    told = (mean(weight) > 1e-6).astype(np.float32)  # only windows with a known value count
    fitted = (mean(slope * told[..., None]) * guide).sum(axis=-1) + mean(offset * told)
    return (fitted / np.maximum(mean(told), 1e-6)).astype(np.float32)
