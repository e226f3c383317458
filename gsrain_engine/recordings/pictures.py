"""Recorded pictures in rain: photographs behind streaks and a medium, or pictures of a scene made of the recording."""

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import cv2
import msgspec
import numpy as np
from jaxtyping import Float32, UInt8

from ..appearance.guided_filter import color_guided_filter
from ..appearance.rainy_photo import composite_on_photo, photo_view
from ..datasets.capture import Capture, CaptureError, CaptureFrame
from ..datasets.depth_maps import completed_depths, measured_depths
from ..datasets.sky_masks import certain_sky, sky_masks
from ..datasets.undistort import undistort_frame
from ..rain.frame import SkyLight
from ..rain.medium import RainMedium
from ..rain.settings import RainSettings
from ..rain.simulation import OVERCAST, RainSimulation, mean_linear_color
from ..render.draw import draw_view, ego_view, rain_camera
from ..render.renderer import Renderer
from ..render.sky_color import sky_color
from ..scene.camera import Camera
from ..scene.scene import Scene

Colors = UInt8[np.ndarray, "h w 3"]


@runtime_checkable
class RainyPictures(Protocol):
    """Source of the rainy pictures of a recording."""

    written: int
    """Number of pictures so far."""

    def rainy(self, view: CaptureFrame, photo: Colors) -> Colors:
        """Return a picture of the size of a view's photograph; the same array without rain."""
        ...


class PhotoRain:
    """Rain over photographs: streaks of the drops nearby, and a medium by the distances that are known.

    With B the photograph, T the medium's transmittance up to a pixel's distance, A its airlight, W the share of a pixel
    that streaks cover and S their light, all linear: (1 - W) (T B + (1 - T) A) + W S. Distances are the capture's own,
    or lidar or points, completed over the image; without any, haze is of the paper's Gaussians. Surfaces stay dry, and
    drops fall in front of everything.
    """

    def __init__(self, renderer: Renderer, capture: Capture, rain: RainSettings) -> None:
        self._renderer, self._capture = renderer, capture
        self._world = Scene(capture.name, up=capture.up, ego=capture.ego)
        self._sky = measured_sky(capture)
        streaks = msgspec.structs.replace(rain, haze="none", visibility_m=None)
        self._streaks, self._medium = RainSimulation.start(streaks), RainSimulation.start(rain)
        self._gaussians = RainSimulation.start(rain.without_medium)
        self.written = self.with_distances = 0
        """Numbers of pictures so far, and of those whose distances are known."""

    def rainy(self, view: CaptureFrame, photo: Colors) -> Colors:
        self.written += 1
        if self._medium.state_at(view.time_s).is_clear:
            return photo
        shot = photo_view(self._world, self._capture, view)
        shot = replace(shot, camera=replace(shot.camera, lens=view.lens))
        distances = self._distances(view, photo)
        self.with_distances += distances is not None
        air = self._medium.frame(shot.time_s, rain_camera(self._world, self._medium, shot), self._sky)
        has_medium = distances is not None and air.medium is not None
        rainfall = self._streaks if has_medium and self._medium.rain.haze == "medium" else self._gaussians
        falling = rainfall.frame(shot.time_s, rain_camera(self._world, rainfall, shot), self._sky)
        self._renderer.draw([], shot.camera, falling)
        share = self._renderer.read().rgba[..., 3:]
        if distances is None or air.medium is None:
            return composite_on_photo(share, falling, photo)
        kept = _refined(distances.transmittance(air.medium, view), photo)[..., None]
        return composite_on_photo(share, falling, photo, kept, air.airlight)

    def _distances(self, view: CaptureFrame, photo: Colors) -> "_Distances | None":
        capture = self._capture
        if not capture.has_poses:
            return None
        small = undistort_frame(replace(view, image_source=photo), min(view.camera.width, _DEPTH_WIDTH))
        nearest = sorted(capture.sweeps, key=lambda sweep: abs(sweep.time_s - view.time_s))[:_SWEEPS]
        measured = measured_depths(capture, [small], nearest)
        if np.count_nonzero(measured[0]) < _MIN_MEASURED * measured[0].size:
            return None
        skies = sky_masks([small], measured, capture.up)
        return _Distances(small.camera, completed_depths(capture, [small], measured, skies)[0])


_DEPTH_WIDTH = 320
"""Width in pixels of distances: the medium changes slowly over an image."""

_SWEEPS = 3  # nearest in time, for the distances of an image
_MIN_MEASURED = 1e-3  # minimum share of measured pixels


_GUIDED_SHARE, _GUIDED_SPREAD = 1 / 12, 3e-3**0.5  # radius over the width; deviation of colors (0..1) that is an edge


def _refined(transmittance: Float32[np.ndarray, "h w"], photo: Colors) -> Float32[np.ndarray, "h w"]:
    """Let a transmittance follow the edges of its photograph, in place of those of distances between lidar points.

    The guided filter (He, Sun and Tang 2013), as haze is estimated from photographs.
    """
    radius = max(round(_GUIDED_SHARE * photo.shape[1]), 1)
    guide = photo.astype(np.float32) / 255
    smooth = color_guided_filter(transmittance, guide, radius, _GUIDED_SPREAD)
    return np.clip(smooth, transmittance.min(), transmittance.max())


@dataclass(frozen=True, slots=True, eq=False)
class _Distances:
    """Depth along the view axis in m, 0 in the sky, for a camera without lens distortion."""

    camera: Camera
    depth_m: Float32[np.ndarray, "_ _"]

    def transmittance(self, medium: RainMedium, view: CaptureFrame) -> Float32[np.ndarray, "h w"]:
        """Share of light that each pixel of a view keeps in the medium."""
        camera, depth = self.camera, self.depth_m
        points = np.dstack([_tangents(camera), np.ones_like(depth)]) * depth[..., None]
        near = medium.transmittance(np.maximum(points.reshape(-1, 3), -1e9)).reshape(depth.shape)
        behind = medium.sky_transmittance(camera.rays)
        found = np.ascontiguousarray(np.where(depth > 0, near, behind), np.float32)
        tangents = _tangents(replace(view.camera, lens=view.lens))
        columns = tangents[..., 0] * np.float32(camera.fx) + np.float32(camera.cx - 0.5)
        rows = tangents[..., 1] * np.float32(camera.fy) + np.float32(camera.cy - 0.5)
        return cv2.remap(found, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


_LEAST_AHEAD = 0.1  # cosine of a ray to the axis: beyond 84 degrees, distances of the picture's edge go on


def _tangents(camera: Camera) -> Float32[np.ndarray, "h w 2"]:
    """Tangents x / z and y / z of the rays of a camera's pixels."""
    directions = camera.rays.directions
    return directions[..., :2] / np.maximum(directions[..., 2:], np.float32(_LEAST_AHEAD))


# Light of the sky in photographs

_SKY_VIEWS = 6
_BRIGHT = 0.9  # quantile of the upper half's brightness that counts as the sky's, if no image shows certain sky


def has_distances(capture: Capture) -> bool:
    """Return whether distances of the pictures of a capture are known: its own, lidar or points."""
    measured = bool(capture.sweeps) or capture.points_m is not None or "depth" in capture.has
    return capture.has_poses and measured


def measured_sky(capture: Capture) -> SkyLight:
    """Mean color of the sky in some images of a capture, which drops and medium take on.

    Without certain sky in any of them it is that of the brightest tenth of their upper halves; overcast if no image can
    be read.
    """
    colors: list[np.ndarray] = []
    bright: list[np.ndarray] = []
    for number in range(0, len(capture), max(len(capture) // _SKY_VIEWS, 1)):
        try:
            photo = capture[number].image
        except CaptureError:
            continue
        sky = certain_sky(photo).pixels
        if sky.any():
            colors.append(photo[sky])
        upper = photo[: max(len(photo) // 2, 1)].reshape(-1, 3)
        light = upper.astype(np.float64).mean(axis=1)
        bright.append(upper[light >= np.quantile(light, _BRIGHT)])
    found = colors or bright
    if not found:
        return OVERCAST
    means = np.array([mean_linear_color(each.astype(np.float64) / 255) for each in found])
    return SkyLight.uniform(mean_linear_color(means))


class ScenePictures:
    """Pictures of a scene that was made of the recording, in rain, from the cameras of its views.

    They have everything that `draw_view` draws: wet colors where the scene has them, mirror, splashes, spray, medium.
    """

    def __init__(self, renderer: Renderer, scene: Scene, capture: Capture, rain: RainSettings) -> None:
        self._renderer, self._scene, self._rainfall = renderer, scene, RainSimulation.start(rain)
        self._sky = sky_color(renderer, scene, capture[0].camera.moved(scene.scene_to_world))
        self.written = 0

    def rainy(self, view: CaptureFrame, photo: Colors) -> Colors:
        self.written += 1
        camera = replace(view.camera, lens=view.lens).moved(self._scene.scene_to_world)
        sky = self._sky.at(self._rainfall.overcast_at(view.time_s))
        draw_view(self._renderer, self._scene, self._rainfall, sky, ego_view(self._scene, camera, view.time_s))
        return self._renderer.read_uint8()
