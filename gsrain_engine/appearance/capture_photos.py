"""Photographs of a capture as pictures in rain, each in its own light and with the distances of what it shows."""

from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from ..datasets.capture import Capture, CaptureFrame
from ..datasets.depth_maps import completed_depths, measured_depths
from ..datasets.io.images import opened_image
from ..datasets.sky_masks import certain_sky, sky_masks
from ..datasets.undistort import undistort_frame
from ..rain.frame import SkyLight
from ..rain.simulation import RainSimulation
from ..render.frame_input import CameraMemory, FrameInput, Mount
from ..render.images import jpeg_file
from ..render.passes.glass import ego_motion
from ..render.photograph import Distances, Photograph, PhotoLight
from ..render.view import RenderView, ego_view
from ..scene.camera import Camera
from ..scene.geometry import linear_to_srgb, srgb_to_linear
from ..scene.scene import Scene
from .base import ClearView
from .capture_views import near_measured, vehicle_pixels
from .normals import normals_from_depth
from .overcast_photos import LightOfPhoto, whole_sky

Colors = UInt8[np.ndarray, "h w 3"]
Depth = Float32[np.ndarray, "h w"]

CAMERA_HEIGHT_M = 1.5
"""Assumed height of a camera over the road, where nothing is known of either."""

COPY_JPEG_QUALITY = 95
"""Of the JPEGs of rainy copies."""

_LEVEL = np.array([[0.0, -1, 0, 0], [0, 0, -1, CAMERA_HEIGHT_M], [1, 0, 0, 0], [0, 0, 0, 1]])
"""World-to-camera transform that looks ahead over a road, for images without poses."""

_DEPTH_WIDTH = 320
"""Width in pixels of distances: the medium changes slowly over an image."""

_SWEEPS = 3  # nearest in time, for the distances of an image
_MIN_MEASURED = 1e-3  # minimum share of measured pixels
_ROAD_END_M = 60.0
"""Distance at which what is not road stands on a level road: houses and trees of a street, in the middle."""

_BRIGHT = 0.9  # quantile of the upper half's brightness that counts as the sky's, without certain sky


class CapturePhotos:
    """Makes the frame inputs of a capture's photographs. Each is a function of its own photograph only."""

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self.world = Scene(capture.name, up=capture.up, ego=capture.ego)
        """World of the rain (meters, z up), without Gaussians."""
        self._memory = CameraMemory()
        self._last: tuple[CaptureFrame, LightOfPhoto, Distances] | None = None

    def frame(self, view: CaptureFrame, rainfall: RainSimulation, photo: Colors | None = None) -> FrameInput:
        """Return the photograph of a view in a rain, in its own lens and, if it is sunny, under clouds; surfaces stay.

        `photo` takes the place of the view's own image. Raises `CaptureError` if that can't be read.
        """
        lights, distances = self._known(view, photo)
        shot = self.view(view)
        past = ego_motion(self.world, shot)
        mount = Mount(self._memory, (view.sensor, view.name), past.motion, past.camera_to_ego)
        light = lights.light_in(rainfall, shot.time_s)
        drawn = lights.drawn(light)
        photograph = Photograph(drawn, distances, light)
        return FrameInput.of(
            self.world, rainfall, photo_sky(drawn, lights.sky(light)), shot, mount=mount, photograph=photograph
        )

    @property
    def have_distances(self) -> bool:
        """True if distances of photographs are known, so that their light may be softened."""
        return has_distances(self._capture)

    def light(self, view: CaptureFrame, rainfall: RainSimulation) -> PhotoLight:
        """Return what `frame` does to the light of a view's photograph."""
        return self._known(view)[0].light_in(rainfall, self.view(view).time_s)

    def view(self, view: CaptureFrame) -> RenderView:
        """View of the world from a captured camera; a level one over a road without poses."""
        camera = replace(view.camera, lens=view.lens)
        if not self._capture.has_poses:
            return ego_view(self.world, replace(camera, world_to_camera=_LEVEL), view.time_s)
        return ego_view(self.world, camera.moved(self.world.scene_to_world), view.time_s)

    def _known(self, view: CaptureFrame, photo: Colors | None = None) -> tuple[LightOfPhoto, Distances]:
        """Light and distances of a view's photograph, or of another one; those of the last are reused."""
        if self._last is None or self._last[0] is not view or photo is not None:
            self._last = view, *self._read(view, view.image if photo is None else photo)
        return self._last[1:]

    def _read(self, view: CaptureFrame, photo: Colors) -> tuple[LightOfPhoto, Distances]:
        """Light of a photograph, and distances by the capture's own, lidar or points, or those of a level road.

        The capture's are completed over the image.
        """
        capture = self._capture
        small = undistort_frame(replace(view, image_source=photo), min(view.camera.width, _DEPTH_WIDTH))
        if has_distances(capture):
            nearest = sorted(capture.sweeps, key=lambda sweep: abs(sweep.time_s - view.time_s))[:_SWEEPS]
            measured = measured_depths(capture, [small], nearest)
            if np.count_nonzero(measured[0]) >= _MIN_MEASURED * measured[0].size:
                skies = sky_masks([small], measured, capture.up)
                completed = completed_depths(capture, [small], measured, skies)[0]
                camera = self.view(view).camera
                surfaces = partial(self._surfaces, small, measured[0], completed)
                return LightOfPhoto(photo, camera, surfaces), Distances(small.camera, completed, measured[0] > 0)
        camera = self.view(view).camera
        road = level_road(replace(small.camera, world_to_camera=camera.world_to_camera), small.image)
        return LightOfPhoto(photo, camera), road

    def _surfaces(self, small: CaptureFrame, measured: Depth, depth: Depth) -> ClearView:
        """Surfaces and certain sky of a photograph without distortion."""
        sky = small.sky
        if sky is None:
            sky = whole_sky(certain_sky(small.image).pixels, small.image, near_measured(measured))
        depth = np.where(sky, np.float32(0), depth)
        camera = small.camera.moved(self.world.scene_to_world)
        vehicles = vehicle_pixels(small, self._capture.boxes, depth).astype(np.float32)
        return ClearView(
            small.name, camera, small.time_s, small.image.astype(np.float32) / np.float32(255), depth,
            normals_from_depth(depth, camera), sky.astype(np.float32), vehicles, small.sensor,
        )  # fmt: skip


def as_copied(view: CaptureFrame, picture: Colors) -> Colors:
    """Return the picture of a view as its rainy copy stores it: compressed, if its file is a JPEG."""
    is_jpeg = view.image_file is not None and view.image_file.suffix.lower() in (".jpg", ".jpeg")
    if not is_jpeg:
        return picture
    with opened_image(jpeg_file(picture, COPY_JPEG_QUALITY), view.name) as stored:
        return np.asarray(stored.convert("RGB"))


def has_distances(capture: Capture) -> bool:
    """Return whether distances of the pictures of a capture are known: its own, lidar or points."""
    measured = bool(capture.sweeps) or capture.points_m is not None or "depth" in capture.has
    return capture.has_poses and measured


def level_road(camera: Camera, photo: Colors) -> Distances:
    """Distances of a level road below a pinhole camera (world: z up), of what stands at its end, and of the sky."""
    rays = camera.rays.directions
    falls = -(rays @ camera.world_to_camera[:3, 2].astype(np.float32))
    away_m = np.minimum(CAMERA_HEIGHT_M / np.maximum(falls, np.float32(1e-6)), np.float32(_ROAD_END_M))
    depth_m = np.where(certain_sky(photo).pixels, np.float32(0), away_m * rays[..., 2])
    return Distances(camera, depth_m.astype(np.float32))


def photo_sky(photo: Colors, sky: Bool[np.ndarray, "h w"] | None = None) -> SkyLight:
    """Mean color of the sky in a photograph, which drops and medium take on.

    `sky` has the pixels of the sky if they are known; without certain sky it is that of the brightest tenth of the
    upper half.
    """
    found = photo[certain_sky(photo).pixels if sky is None else sky]
    if not len(found):
        upper = photo[: max(len(photo) // 2, 1)].reshape(-1, 3)
        light = upper.astype(np.float64).mean(axis=1)
        found = upper[light >= np.quantile(light, _BRIGHT)]
    counts = [np.bincount(each, minlength=256) for each in found.T]
    light = srgb_to_linear(np.arange(256) / 255)
    red, green, blue = linear_to_srgb(np.array([each @ light for each in counts]) / len(found)).tolist()
    return SkyLight.uniform((red, green, blue))
