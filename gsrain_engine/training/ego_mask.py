"""Detection of the ego vehicle's own body in the images of a drive: pixels that stay fixed while the world moves."""

import logging
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from ..datasets.capture import CaptureFrame
from ..datasets.geometry import scaled_camera
from ..datasets.masks import pixel_rays, with_camera_masks
from ..scene.camera import Camera

logger = logging.getLogger("gsrain")
_WIDTH = 240  # images are searched at this width
_FRAMES, _OTHERS = 8, 8
"""Number of images examined per camera, and number of nearest images in time that each is compared with."""

_MIN_FRAMES = 3
_CLIP = 0.1  # largest color difference (0..1) that counts as evidence for a pixel
_PRIOR = 0.02  # evidence per pixel below which it counts as part of the world
_EDGE, _SLOPE, _STEEPEST = 20.0, 0.15, 4
"""Weights of a static edge under the contour and of the contour's slope; largest slope in pixels per column."""

_LOWEST_PART = 0.55
"""Share of the height above the search region: only the lower part of an image shows nearby, moving road."""

_MIN_GAIN = 0.01  # mean color evidence above the prior that the region must have
_PROPORTIONS = 0.05
"""Images whose aspect ratio differs by more than this share from the camera's median were rotated or cropped and are
excluded."""


class _SmallImage:
    """A downscaled image with its colors, edges and the world positions of its pixels."""

    def __init__(self, view: CaptureFrame, depth: Float32[np.ndarray, "h w"], size: tuple[int, int]) -> None:
        width, height = size
        self.camera: Camera = scaled_camera(view.camera, width, height)
        self.time_s, self.sensor = view.time_s, view.sensor
        color = cv2.resize(view.image, (width, height), interpolation=cv2.INTER_AREA)
        color = cv2.GaussianBlur(color.astype(np.float32) / 255, (0, 0), 0.7)
        gray = color.mean(axis=2)
        edges = [cv2.Sobel(gray, cv2.CV_32F, 1, 0) / 8, cv2.Sobel(gray, cv2.CV_32F, 0, 1) / 8]
        self.channels = np.dstack([color, *edges])
        """Red, green, blue; brightness gradient per pixel, horizontally and vertically."""
        self.depth = cv2.resize(depth, (width, height), interpolation=cv2.INTER_NEAREST)
        self.places = self.camera.position + self.depth[..., None] * pixel_rays(self.camera)

    def difference_to(self, other: "_SmallImage") -> Float32[np.ndarray, "h w 2"]:
        """Difference to another image at this one's pixels in world space, see `_difference`; inf if not visible."""
        local = self.places @ other.camera.world_to_camera[:3, :3].T + other.camera.world_to_camera[:3, 3]
        z = np.where((local[..., 2] > 0.3) & (self.depth > 0), local[..., 2], np.inf)
        u = local[..., 0] / z * other.camera.fx + other.camera.cx - 0.5
        v = local[..., 1] / z * other.camera.fy + other.camera.cy - 0.5
        inside = np.isfinite(z) & (u >= 0) & (v >= 0) & (u <= other.camera.width - 1) & (v <= other.camera.height - 1)
        planes = cv2.split(other.channels)
        sampled = np.dstack(
            [cv2.remap(p, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR) for p in planes]
        )
        return np.where(inside[..., None], _difference(sampled, self.channels), np.inf).astype(np.float32)


def _difference(one: Float32[np.ndarray, "h w 5"], other: Float32[np.ndarray, "h w 5"]) -> Float32[np.ndarray, "h w 2"]:
    """Color difference (mean of three channels) and edge difference (length)."""
    apart = np.abs(one - other)
    return np.stack([apart[..., :3].mean(axis=2), np.hypot(apart[..., 3], apart[..., 4])], axis=-1)


def ego_masks(
    views: Sequence[CaptureFrame], depths: Sequence[Float32[np.ndarray, "_ _"]]
) -> dict[str, Bool[np.ndarray, "_ _"]]:
    """Masks of the pixels that show the world, by sensor, for cameras with part of the ego's body at the lower edge.

    Two explanations of each pixel compete: it belongs to the ego, so all images of the camera are alike there, or it
    belongs to the surface at the given depth, so all images of that place are alike. Dynamic programming over the
    columns finds the contour along static edges that best separates both. Cameras without clear evidence, and cameras
    that did not move, get no mask.

    Views are undistorted. Their sizes may differ by a few pixels, as after per-image undistortion; images with an
    unusual aspect ratio for their sensor are ignored. Depths are those of the static scene, completed down to the lower
    edge (`completed_depth`).
    """
    found: dict[str, Bool[np.ndarray, "_ _"]] = {}
    for sensor in dict.fromkeys(view.sensor for view in views):
        rows = _alike(views, sensor)
        if len(rows) < _MIN_FRAMES:
            continue
        camera = views[rows[0]].camera
        width = min(_WIDTH, *(views[row].camera.width for row in rows))
        size = width, max(round(camera.height * width / camera.width), 1)
        own = [_SmallImage(views[row], depths[row], size) for row in rows]
        contour = _contour(_evidence(own))
        if contour is not None:  # with a margin of one of the small image's pixels
            scale = camera.width / size[0]
            columns = (np.arange(camera.width) + 0.5) / scale - 0.5
            rows_above = np.where(contour < size[1], contour - 1, size[1])
            first = np.interp(columns, np.arange(len(contour)), rows_above) * scale
            found[sensor] = np.arange(camera.height)[:, None] < first[None, :]
    return found


def mask_ego_vehicle(
    views: Sequence[CaptureFrame], depths: Sequence[Float32[np.ndarray, "_ _"]]
) -> tuple[list[CaptureFrame], dict[str, float]]:
    """Exclude the ego's body (`ego_masks`) from the views' masks; returns them, and the covered shares by sensor."""
    masks = ego_masks(views, depths)
    shares = {sensor: 1 - float(mask.mean()) for sensor, mask in masks.items()}
    for sensor, share in shares.items():
        logger.info(
            "%s shows the ego's own body in %.0f %% of its picture: left out", sensor or "the camera", 100 * share
        )
    alike = {row for sensor in masks for row in _alike(views, sensor)}
    ready = [with_camera_masks([view], masks)[0] if row in alike else view for row, view in enumerate(views)]
    return ready, shares


def _alike(views: Sequence[CaptureFrame], sensor: str) -> list[int]:
    """Indices of a sensor's views whose aspect ratio is close to the sensor's median."""
    rows = [row for row, view in enumerate(views) if view.sensor == sensor]
    ratios = [views[row].camera.height / views[row].camera.width for row in rows]
    middle = sorted(ratios)[len(ratios) // 2]
    return [row for row, ratio in zip(rows, ratios, strict=True) if abs(ratio / middle - 1) <= _PROPORTIONS]


def _evidence(own: Sequence[_SmallImage]) -> Float32[np.ndarray, "h w 2"]:
    """Excess error of the world explanation over the ego explanation, for color and edges; 0 where neither is better.

    The lower quartile over other images is used, since the ego may occlude the place in some of them.
    """
    middle = np.median([each.channels for each in own], axis=0).astype(np.float32)
    total = np.zeros((*own[0].depth.shape, 2), np.float32)
    count = np.zeros((*own[0].depth.shape, 1), np.float32)
    for each in [own[int(k)] for k in np.linspace(0, len(own) - 1, min(_FRAMES, len(own)))]:
        others = sorted((o for o in own if o is not each), key=lambda o: abs(o.time_s - each.time_s))[:_OTHERS]
        errors = np.sort([each.difference_to(other) for other in others], axis=0)
        visible = np.isfinite(errors).sum(axis=0)
        as_world = np.take_along_axis(errors, (visible[None] - 1) // 4, axis=0)[0]  # the lower quartile
        known = visible[..., :1] > 0
        worse = np.where(known, as_world, 0) - _difference(each.channels, middle)
        total += np.where(known, np.clip(worse, -_CLIP, _CLIP), 0)
        count += known
    return total / np.maximum(count, 1)


def _contour(evidence: Float32[np.ndarray, "h w 2"]) -> Float64[np.ndarray, " w"] | None:
    """First row of the ego in each column (the height where it is absent); None without enough evidence."""
    color, edges = evidence[..., 0], np.maximum(evidence[..., 1], 0)
    height, width = color.shape
    gain = np.zeros((height + 1, width))
    gain[:height] = np.cumsum((color - _PRIOR)[::-1], axis=0)[::-1] + _EDGE * edges
    gain[: round(_LOWEST_PART * height)] = -np.inf
    best, back = gain[:, 0].copy(), np.zeros((height + 1, width), np.int64)
    steps = np.arange(-_STEEPEST, _STEEPEST + 1)
    for column in range(1, width):
        source = np.arange(height + 1)[:, None] + steps
        values = np.where((source >= 0) & (source <= height), best[np.clip(source, 0, height)], -np.inf)
        values = values - _SLOPE * np.abs(steps)
        choice = values.argmax(axis=1)
        back[:, column] = np.clip(np.arange(height + 1) + steps[choice], 0, height)
        best = values[np.arange(height + 1), choice] + gain[:, column]
    rows = np.full(width, height)
    rows[-1] = int(best.argmax())
    for column in range(width - 1, 0, -1):
        rows[column - 1] = back[rows[column], column]
    region = np.arange(height)[:, None] >= rows[None, :]
    if not region.any() or float(color[region].mean()) < _PRIOR + _MIN_GAIN:
        return None
    return rows.astype(np.float64)
