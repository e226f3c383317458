"""Masks of the static scene for training, which exclude moving objects and the ego vehicle; pixel rays."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from ..scene.camera import Camera
from ..scene.geometry import before_camera, box_corners
from .capture import Capture, CaptureError, CaptureFrame, TrackedBox
from .io.images import opened_image

MOVING_M_S = 0.5
"""Minimum mean speed of a moving object."""

_MIN_TRAVEL_M = 0.4  # minimum travel of a moving object over the capture, because annotations jitter
_MOVERS = ("car", "truck", "van", "bus", "vehicle", "trailer", "tram", "train", "cycl", "bike", "motor", "rider")
_PEOPLE = ("person", "pedestrian", "human", "child", "adult", "animal", "sitting")


def can_move(box: TrackedBox) -> bool:
    """Return whether a box's class is a vehicle, a person or an animal, in any dataset's words."""
    name = box.class_name.lower()
    return any(word in name for word in _MOVERS + _PEOPLE)


def is_moving(box: TrackedBox) -> bool:
    """Return whether a box traveled far enough; an object seen only once counts as moving if it can move."""
    there = np.flatnonzero(box.track.valid) if len(box.track.times) > 1 else np.zeros(0, np.int64)
    if len(there) < 2:
        return can_move(box)
    places, times = box.track.positions[there], box.track.times[there]
    way = float(np.linalg.norm(places - places[0], axis=1).max())
    speed = float(np.linalg.norm(places[-1] - places[0])) / max(float(times[-1] - times[0]), 1e-6)
    return way > _MIN_TRAVEL_M and max(speed, way / max(float(np.ptp(times)), 1e-6)) >= MOVING_M_S


def moving_boxes(capture: Capture) -> tuple[TrackedBox, ...]:
    """Boxes of moving objects; all others are part of the static scene."""
    return tuple(box for box in capture.boxes if is_moving(box))


def points_in_box(
    points_m: Float64[np.ndarray, "p 3"], box: TrackedBox, time_s: float, margin_m: float = 0.0
) -> Bool[np.ndarray, " p"]:
    """Mask of points in the capture's world inside a box at a time; all False while the object is absent."""
    pose = box.track.pose(time_s)
    if pose is None:
        return np.zeros(len(points_m), np.bool_)
    local = (points_m - pose[:3, 3]) @ pose[:3, :3]
    half = np.array(box.size_lwh) / 2 + margin_m
    return np.asarray((np.abs(local - [0, 0, box.size_lwh[2] / 2]) <= half).all(axis=1))


_MARGIN_M = 0.3
_DILATION = 0.004  # of the image width


def static_mask(view: CaptureFrame, moving: Sequence[TrackedBox]) -> Bool[np.ndarray, "h w"]:
    """Pixels of the static scene: the view's own mask without the moving boxes at its time.

    Each box is enlarged on all sides (shadows, mirrors, lagging annotations), projected as the convex hull of its
    corners, and dilated.
    """
    camera = view.camera
    covered = np.zeros((camera.height, camera.width), np.uint8)
    for box in moving:
        hull = box_outline(view, box, _MARGIN_M)
        if len(hull) >= 3:
            cv2.fillConvexPoly(covered, np.round(hull).astype(np.int32), 1)
    radius = max(round(_DILATION * camera.width), 1)
    if covered.any():
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
        covered = cv2.dilate(covered, disc)
    own = view.mask
    return (covered == 0) if own is None else own & (covered == 0)


def box_outline(view: CaptureFrame, box: TrackedBox, margin_m: float = 0.0) -> Float64[np.ndarray, "c 2"]:
    """Convex outline of a box in pixels of a view without distortion; no corners if it is not visible."""
    pose = box.track.pose(view.time_s)
    if pose is None:
        return np.zeros((0, 2))
    size = np.array(box.size_lwh) + 2 * margin_m
    pose = pose.copy()
    pose[:3, 3] -= margin_m * pose[:3, 2]
    points = before_camera(box_corners(view.camera.world_to_camera @ pose, size))
    if not len(points):
        return np.zeros((0, 2))
    focal, middle = [view.camera.fx, view.camera.fy], [view.camera.cx, view.camera.cy]
    pixels = points[:, :2] / points[:, 2:] * focal + middle
    far = 8.0 * max(view.camera.width, view.camera.height)  # keeps the integers of the polygon filler in range
    hull = cv2.convexHull(np.clip(pixels, -far, far).astype(np.float32))[:, 0].astype(np.float64)
    low, high = hull.min(axis=0), hull.max(axis=0)
    is_beside = (high < 0).any() or low[0] > view.camera.width or low[1] > view.camera.height
    return np.zeros((0, 2)) if is_beside else hull


def read_camera_masks(folder: Path | str) -> dict[str, Bool[np.ndarray, "_ _"]]:
    """Read user-drawn masks, an image for each camera, named like the sensor; training uses white pixels only."""
    files = sorted(each for each in Path(folder).iterdir() if each.suffix.lower() in (".png", ".jpg", ".jpeg", ".bmp"))
    if not files:
        raise CaptureError(f"{folder}: no masks; expected a picture for each camera, named like it (CAM_BACK.png)")
    masks: dict[str, Bool[np.ndarray, "_ _"]] = {}
    for file in files:
        with opened_image(file, str(file)) as picture:
            masks[file.stem] = np.asarray(picture.convert("L")) >= 128
    return masks


def with_camera_masks(
    views: Iterable[CaptureFrame], masks: dict[str, Bool[np.ndarray, "_ _"]]
) -> tuple[CaptureFrame, ...]:
    """Combine each camera's mask, scaled to the image size, with the existing masks of its views.

    In a capture of one unnamed camera, a single mask applies to it.
    """
    views = tuple(views)
    only = next(iter(masks.values())) if len(masks) == 1 and {view.sensor for view in views} == {""} else None
    return tuple(
        view if (mask := masks.get(view.sensor, only)) is None else replace(view, mask_source=_both(view, mask))
        for view in views
    )


def _both(view: CaptureFrame, mask: Bool[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "h w"]:
    size = (view.camera.width, view.camera.height)
    scaled = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return scaled if view.mask is None else scaled & view.mask


# Pixel rays


def pixel_rays(camera: Camera) -> Float32[np.ndarray, "h w 3"]:
    """Directions through pixel centers in the world, with length 1 along the view axis: point = eye + depth * ray."""
    u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rotation = camera.world_to_camera[:3, :3]
    rays = u[None, :, None] * rotation[0] + v[:, None, None] * rotation[1] + rotation[2]
    return rays.astype(np.float32)


def elevations(camera: Camera, up: tuple[float, float, float]) -> Float32[np.ndarray, "h w"]:
    """Sine of the angle of each pixel's direction above the horizon."""
    rays = pixel_rays(camera)
    axis = np.array(up, np.float32) / np.linalg.norm(up)
    return ((rays @ axis) / np.linalg.norm(rays, axis=-1)).astype(np.float32)
