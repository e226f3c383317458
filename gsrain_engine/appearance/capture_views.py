"""Clear views of a capture: undistorted images with depth, normals, sky and vehicle masks."""

from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from ..datasets.capture import EGO_HEIGHT_M, Capture, CaptureFrame, LidarSweep
from ..datasets.depth_maps import camera_height_above_road, completed_depth, measured_depths, road_depth, static_sweeps
from ..datasets.geometry import lidar_depth
from ..datasets.sky_masks import certain_sky
from ..datasets.undistort import undistort_frame
from ..scene.scene import rotation_to_z_up
from .base import ClearView
from .guess_geometry import color_guided_filter, vehicle_pixels
from .normals import normals_from_depth
from .scene_views import CachedViews


class CaptureViews(CachedViews):
    """Views of a capture in the world (meters, z up), computed on access; the most recent ones are cached."""

    def __init__(self, capture: Capture, width_px: int) -> None:
        """Take a capture, which is read lazily. Images wider than `width_px` are downscaled."""
        super().__init__(len(capture), self._view)
        self._capture = capture
        self._straight = [undistort_frame(view, min(width_px, view.camera.width)) for view in capture]
        self._surfaces = CaptureSurfaces(capture)
        self._has_poses = capture.has_poses and not _stand_at_one_place(capture)

    @property
    def to_world(self) -> Float64[np.ndarray, "4 4"]:
        """Similarity from the capture's unit and axes to the world."""
        matrix = np.eye(4)
        matrix[:3, :3] = self._surfaces.metres_per_unit * rotation_to_z_up(self._capture.up)
        return matrix

    def mask(self, name: str) -> Bool[np.ndarray, "h w"] | None:
        """Mask of a view's pixels that are valid for training; None means all."""
        return next(view.mask for view in self._straight if view.name == name)

    def _view(self, index: int) -> ClearView:
        view, to_world = self._straight[index], self.to_world
        scale = np.float32(self._surfaces.metres_per_unit)
        sky = self._surfaces.sky(view)
        depth = self._surfaces.depth(view, sky > 0.5)
        known = self._surfaces.known_share(view, sky > 0.5) if depth.any() else 0.0
        camera = view.camera.moved(to_world)
        own = view.normals
        turned = None if own is None else (own @ (to_world[:3, :3] / scale).T).astype(np.float32)
        depth_m = (scale * depth).astype(np.float32)
        return ClearView(
            view.name,
            camera,
            view.time_s,
            view.image.astype(np.float32) / np.float32(255),
            depth_m,
            normals_from_depth(depth_m, camera) if turned is None else turned,
            sky,
            vehicle_pixels(view, self._capture.boxes, depth).astype(np.float32),
            view.sensor,
            has_pose=self._has_poses,
            known_share=known,
        )


def _stand_at_one_place(capture: Capture) -> bool:
    """True if all poses are identical and no measurement suggests a camera at rest, so that poses are placeholders."""
    is_measured = (
        capture.sweeps or capture.points_m is not None or any(view.depth_source is not None for view in capture)
    )
    first = capture[0].camera.world_to_camera
    return len(capture) > 1 and not is_measured and all(
        np.allclose(view.camera.world_to_camera, first, rtol=0, atol=1e-9) for view in capture
    )  # fmt: skip


def capture_views(capture: Capture, width_px: int) -> CaptureViews:
    """Views of a capture, with images at most `width_px` wide.

    Depth comes from the capture's depth maps, or densified from its lidar or points; the sky from its masks, or from
    colors and measurements; vehicles from labels or boxes. Unknown values are 0.
    """
    return CaptureViews(capture, width_px)


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
        self._last: tuple[CaptureFrame, Float32[np.ndarray, "_ _"]] | None = None

    @property
    def metres_per_unit(self) -> float:
        """Length of the capture's unit; if unknown, the one that puts its cameras at the height of a car's."""
        if self._capture.is_metric or self._drop is None:
            return 1.0
        return EGO_HEIGHT_M / self._drop

    def sky(self, view: CaptureFrame) -> Float32[np.ndarray, "h w"]:
        """Share of sky in each pixel of an undistorted view: the capture's mask, else pixels that are certainly sky.

        The edge of the `certain_sky` mask is feathered along the image's own edges, so that it follows leaves and
        wires. Pixels near a lidar return are never sky.
        """
        own = view.sky
        if own is not None:
            return own.astype(np.float32)
        sure = certain_sky(view.image).pixels
        if self._capture.sweeps:
            sure = sure & ~_near(self._measured(view), _AT_BEAM)
        return _feathered(sure, view.image)

    def known_share(self, view: CaptureFrame, sky: Bool[np.ndarray, "h w"]) -> float:
        """Share of a view below its sky that was measured or lies near a measurement; other depth is estimated."""
        if view.depth_source is not None:
            return 1.0
        return float(_near(self._measured(view), _BEAMS)[~sky].mean()) if not sky.all() else 0.0

    def depth(self, view: CaptureFrame, sky: Bool[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
        """Depth along the view axis in the capture's unit; 0 in the sky, and in views without measurements.

        Lidar and points are densified, see `completed_depth`; estimates far from them follow the image's edges. Without
        measurements no depth is estimated, since an image alone doesn't separate the road from cars on it.
        """
        own = view.depth
        if own is not None:
            return np.where(sky, np.float32(0), own)
        measured = self._measured(view)
        if not measured.any():
            return measured
        road = None if self._drop is None else road_depth(view.camera, self._drop, self._capture.up)
        return _along_edges(completed_depth(measured, sky, road), measured, view.image)

    def _measured(self, view: CaptureFrame) -> Float32[np.ndarray, "h w"]:
        """Sparse depth, cached for the last view: the static scene of all times, and moving objects of its own time."""
        if self._last is None or self._last[0] is not view:
            self._last = (view, self._newly_measured(view))
        return self._last[1]

    def _newly_measured(self, view: CaptureFrame) -> Float32[np.ndarray, "h w"]:
        static = measured_depths(self._capture, [view], self._static)[0]
        if not self._capture.sweeps or view.depth_source is not None:
            return static
        now = lidar_depth(view, [min(self._capture.sweeps, key=lambda sweep: abs(sweep.time_s - view.time_s))])
        nearer = (now > 0) & ((static == 0) | (now < static))
        return np.where(nearer, now, static)

    @cached_property
    def _static(self) -> tuple[LidarSweep, ...]:
        return static_sweeps(self._capture)

    @cached_property
    def _drop(self) -> float | None:
        """Height of the cameras above the road, if only triangulated points are known."""
        points = self._capture.points_m
        if self._capture.sweeps or points is None or not len(points):
            return None
        return camera_height_above_road(points, self._capture.views, self._capture.up)


def _near(depth: Float32[np.ndarray, "h w"], share: float) -> Bool[np.ndarray, "h w"]:
    """Pixels within a share of the image width of a measured one: lidar beams are several pixels apart."""
    reach = 2 * max(round(share * depth.shape[1]), 1) + 1
    return cv2.dilate((depth > 0).astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0


def _feathered(sky: Bool[np.ndarray, "h w"], image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w"]:
    """Share of sky: the mask, but fitted to the image's colors near its edge."""
    radius = max(round(_FEATHER * sky.shape[1]), 2)
    window = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    flags = sky.astype(np.uint8)
    edge = cv2.dilate(flags, window) > cv2.erode(flags, window)
    guide = image.astype(np.float32) / np.float32(255)
    share = color_guided_filter(sky.astype(np.float32), guide, np.ones_like(sky), radius, _SKY_SPREAD)
    # The fit has too little contrast: stretch its middle part to the whole range.
    return (np.where(edge, np.clip((share - 0.1) / 0.8, 0, 1), sky) * _between_twigs(guide)).astype(np.float32)


def _between_twigs(image: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w"]:
    """Share of light that passes thin objects darker than their surroundings; 1 elsewhere, also in clouds."""
    light = image.mean(axis=2)
    size = 2 * max(round(_TWIGS * image.shape[1]), 1) + 1
    open_light = cv2.morphologyEx(light, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    darker = np.clip(open_light - light - _TWIG_NOISE, 0, 1) / np.maximum(_TWIG_DARKNESS * open_light, 1e-3)
    return np.clip(1 - darker, 0, 1).astype(np.float32)


def _along_edges(
    depth: Float32[np.ndarray, "h w"], measured: Float32[np.ndarray, "h w"], image: UInt8[np.ndarray, "h w 3"]
) -> Float32[np.ndarray, "h w"]:
    """Let depth far from all measurements follow the image's edges; 0 stays 0."""
    radius = max(round(_GUESS * depth.shape[1]), 2)
    guessed = ~_near(measured, _BEAMS) & (depth > 0)
    if not guessed.any():
        return depth
    inverse = np.where(depth > 0, 1 / np.where(depth > 0, depth, 1), 0).astype(np.float32)
    guide = image.astype(np.float32) / np.float32(255)
    smooth = color_guided_filter(inverse, guide, depth > 0, radius, _GUESS_SPREAD)
    bounded = np.clip(smooth, inverse[depth > 0].min(), inverse.max())
    return np.where(guessed, 1 / np.where(guessed, bounded, 1), depth).astype(np.float32)
