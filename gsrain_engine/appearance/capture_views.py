"""Clear views of a capture: undistorted images with depth, normals, sky and vehicle masks."""

from collections.abc import Sequence
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from ..datasets import depth_maps
from ..datasets.capture import EGO_HEIGHT_M, Capture, CaptureFrame, LidarSweep, TrackedBox
from ..datasets.geometry import lidar_depth
from ..datasets.masks import box_outline, pixel_rays
from ..datasets.sky_masks import certain_sky
from ..datasets.undistort import undistort_frame
from ..render.guided_filter import color_guided_filter
from ..scene.labels import Label
from ..scene.objects import is_vehicle
from ..scene.scene import rotation_to_z_up
from .base import ClearView, Plane
from .normals import normals_from_depth
from .scene_views import CachedViews

Flags = Bool[np.ndarray, "h w"]


class CaptureViews(CachedViews):
    """Views of a capture in the world (meters, z up), computed on access; the most recent ones are cached.

    Depth comes from the capture's depth maps, or densified from its lidar or points; the sky from its masks, or from
    colors and measurements; vehicles from labels or boxes. Unknown values are 0.
    """

    def __init__(self, capture: Capture, width_px: int) -> None:
        """Take a capture, which is read lazily. Images wider than `width_px` are downscaled."""
        super().__init__(len(capture), self._view)
        self._capture = capture
        self._undistorted = [undistort_frame(view, min(width_px, view.camera.width)) for view in capture]
        self._surfaces = CaptureSurfaces(capture)
        self._has_poses = capture.has_poses and not _has_placeholder_poses(capture)

    @property
    def to_world(self) -> Float64[np.ndarray, "4 4"]:
        """Similarity from the capture's unit and axes to the world."""
        matrix = np.eye(4)
        matrix[:3, :3] = self._surfaces.metres_per_unit * rotation_to_z_up(self._capture.up)
        return matrix

    def mask(self, name: str) -> Flags | None:
        """Mask of a view's pixels that are valid for training; None means all."""
        return next(view.mask for view in self._undistorted if view.name == name)

    def _view(self, index: int) -> ClearView:
        view, to_world = self._undistorted[index], self.to_world
        scale = np.float32(self._surfaces.metres_per_unit)
        sky = self._surfaces.sky(view)
        depth = self._surfaces.depth(view, sky > 0.5)
        camera = view.camera.moved(to_world)
        depth_m = (scale * depth).astype(np.float32)
        if (own := view.normals) is None:
            normals = normals_from_depth(depth_m, camera)
        else:
            normals = (own @ (to_world[:3, :3] / scale).T).astype(np.float32)
        return ClearView(
            view.name, camera, view.time_s, view.image.astype(np.float32) / np.float32(255), depth_m, normals, sky,
            vehicle_pixels(view, self._capture.boxes, depth).astype(np.float32), view.sensor, self._has_poses,
            self._surfaces.known_share(view, sky > 0.5) if depth.any() else 0.0,
        )  # fmt: skip


def _has_placeholder_poses(capture: Capture) -> bool:
    """True if all poses are identical and no measurement suggests a camera at rest."""
    is_measured = (
        capture.sweeps or capture.points_m is not None or any(view.depth_source is not None for view in capture)
    )
    first = capture[0].camera.world_to_camera
    return len(capture) > 1 and not is_measured and all(
        np.allclose(view.camera.world_to_camera, first, rtol=0, atol=1e-9) for view in capture
    )  # fmt: skip


# Surfaces and sky

_FEATHER, _SKY_SPREAD = 0.02, 0.03
"""Search radius for the sky's edge, as a share of the image width, and color deviation of the sky there."""
_TWIGS, _TWIG_NOISE, _TWIG_DARKNESS = 0.012, 0.04, 0.6
"""Half width of thin objects as a share of the image width, the least amount by which they are darker, and the share
of the surrounding light by which they are darker if they hide the sky completely."""
_GUESS, _GUESS_SPREAD = 0.04, 0.1  # radius and color deviation for depth that was not measured nearby
_BEAMS, _AT_BEAM = 0.012, 0.006
"""Distances to a measured pixel, as shares of the image width: depth is interpolated within the first, estimated
beyond; no pixel within the second is sky."""


class CaptureSurfaces:
    """Depth and sky of one capture's views, view by view."""

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self._last: tuple[CaptureFrame, Plane] | None = None

    @property
    def metres_per_unit(self) -> float:
        """Length of the capture's unit; if unknown, the one that puts its cameras at the height of a car's."""
        return 1.0 if self._capture.is_metric or self._drop is None else EGO_HEIGHT_M / self._drop

    def sky(self, view: CaptureFrame) -> Plane:
        """Share of sky in each pixel of an undistorted view: the capture's mask, else pixels that are certainly sky.

        The edge of the `certain_sky` mask is feathered along the image's own edges, so that it follows leaves and
        wires. Pixels near a lidar return are never sky.
        """
        if (own := view.sky) is not None:
            return own.astype(np.float32)
        sure = certain_sky(view.image).pixels
        if self._capture.sweeps:
            sure = sure & ~near_measured(self._measured(view))
        return _feathered(sure, view.image)

    def known_share(self, view: CaptureFrame, sky: Flags) -> float:
        """Share of a view below its sky that was measured or lies near a measurement; other depth is estimated."""
        if view.depth_source is not None:
            return 1.0
        return float(_near(self._measured(view), _BEAMS)[~sky].mean()) if not sky.all() else 0.0

    def depth(self, view: CaptureFrame, sky: Flags) -> Plane:
        """Depth along the view axis in the capture's unit; 0 in the sky, and in views without measurements.

        Lidar and points are densified, see `completed_depth`; estimates far from them follow the image's edges. Without
        measurements no depth is estimated, since an image alone doesn't separate the road from cars on it.
        """
        if (own := view.depth) is not None:
            return np.where(sky, np.float32(0), own)
        measured = self._measured(view)
        if not measured.any():
            return measured
        road = None if self._drop is None else depth_maps.road_depth(view.camera, self._drop, self._capture.up)
        return _along_edges(depth_maps.completed_depth(measured, sky, road), measured, view.image)

    def _measured(self, view: CaptureFrame) -> Plane:
        """Sparse depth, cached for the last view: the static scene of all times, and moving objects of its own time."""
        if self._last is not None and self._last[0] is view:
            return self._last[1]
        found = depth_maps.measured_depths(self._capture, [view], self._static)[0]
        if self._capture.sweeps and view.depth_source is None:
            now = lidar_depth(view, [min(self._capture.sweeps, key=lambda sweep: abs(sweep.time_s - view.time_s))])
            found = np.where((now > 0) & ((found == 0) | (now < found)), now, found)
        self._last = (view, found)
        return found

    @cached_property
    def _static(self) -> tuple[LidarSweep, ...]:
        return depth_maps.static_sweeps(self._capture)

    @cached_property
    def _drop(self) -> float | None:
        """Height of the cameras above the road, if only triangulated points are known."""
        points = self._capture.points_m
        if self._capture.sweeps or points is None or not len(points):
            return None
        return depth_maps.camera_height_above_road(points, self._capture.views, self._capture.up)


def near_measured(depth: Plane) -> Flags:
    """Pixels so near to a measured one that they are no sky; `depth` is 0 without a measurement."""
    return _near(depth, _AT_BEAM)


def _near(depth: Plane, share: float) -> Flags:
    """Pixels within a share of the image width of a measured one: lidar beams are several pixels apart."""
    reach = 2 * max(round(share * depth.shape[1]), 1) + 1
    return cv2.dilate((depth > 0).astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0


def _feathered(sky: Flags, image: UInt8[np.ndarray, "h w 3"]) -> Plane:
    """Share of sky: the mask, but fitted to the image's colors near its edge and reduced between twigs."""
    radius = max(round(_FEATHER * sky.shape[1]), 2)
    window = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    flags = sky.astype(np.uint8)
    edge = cv2.dilate(flags, window) > cv2.erode(flags, window)
    guide = image.astype(np.float32) / np.float32(255)
    share = color_guided_filter(sky.astype(np.float32), guide, radius, _SKY_SPREAD)
    # Thin objects are darker than their surroundings; the sky's light passes around them, also in clouds.
    light = guide.mean(axis=2)
    size = 2 * max(round(_TWIGS * image.shape[1]), 1) + 1
    open_light = cv2.morphologyEx(light, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    darker = np.clip(open_light - light - _TWIG_NOISE, 0, 1) / np.maximum(_TWIG_DARKNESS * open_light, 1e-3)
    passing = np.clip(1 - darker, 0, 1).astype(np.float32)
    # The fit has too little contrast: stretch its middle part to the whole range.
    return (np.where(edge, np.clip((share - 0.1) / 0.8, 0, 1), sky) * passing).astype(np.float32)


def _along_edges(depth: Plane, measured: Plane, image: UInt8[np.ndarray, "h w 3"]) -> Plane:
    """Let depth far from all measurements follow the image's edges; 0 stays 0."""
    guessed = ~_near(measured, _BEAMS) & (depth > 0)
    if not guessed.any():
        return depth
    inverse = np.where(depth > 0, 1 / np.where(depth > 0, depth, 1), 0).astype(np.float32)
    guide = image.astype(np.float32) / np.float32(255)
    radius = max(round(_GUESS * depth.shape[1]), 2)
    smooth = color_guided_filter(inverse, guide, radius, _GUESS_SPREAD, depth > 0)
    bounded = np.clip(smooth, inverse[depth > 0].min(), inverse.max())
    return np.where(guessed, 1 / np.where(guessed, bounded, 1), depth).astype(np.float32)


# Vehicle masks

_MARGIN_M = 0.3
_WHEELS_M = 0.15  # height above a box's bottom below which pixels show the road as much as the vehicle


def vehicle_pixels(view: CaptureFrame, boxes: Sequence[TrackedBox], depth: Plane) -> Flags:
    """Return a mask of vehicles, from labels (the street's classes) or else boxes in meters; all False without either.

    `view` has no lens distortion; `depth` is along its axis in meters. Where it is 0, unknown, a box's whole outline
    counts.
    """
    if (labels := view.labels) is not None:
        return (labels == Label.CAR) | (labels == Label.TRUCK)
    found = np.zeros(depth.shape, np.bool_)
    for box in boxes:
        outline = box_outline(view, box) if is_vehicle(box.class_name) else np.zeros((0, 2))
        if len(outline) >= 3:
            covered = np.zeros(depth.shape, np.uint8)
            cv2.fillConvexPoly(covered, np.round(outline).astype(np.int32), 1)
            found |= (covered > 0) & _in_box(view, box, depth)
    return found


def _in_box(view: CaptureFrame, box: TrackedBox, depth: Plane) -> Flags:
    """Return a mask of pixels whose surface lies in a box at the view's time; True at unknown depth."""
    pose = box.track.pose(view.time_s)
    assert pose is not None  # it has an outline
    places = view.camera.position + depth[..., None] * pixel_rays(view.camera)
    local = (places - pose[:3, 3]) @ pose[:3, :3]
    length, width, height = box.size_lwh
    inside = (np.abs(local[..., :2]) <= np.array([length, width]) / 2 + _MARGIN_M).all(axis=-1)
    inside &= (local[..., 2] >= _WHEELS_M) & (local[..., 2] <= height + _MARGIN_M)
    return inside | (depth == 0)
