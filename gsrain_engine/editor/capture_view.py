"""An open capture in the viewport: its points, its images, the selected view, and moving the camera to it."""

import logging
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from ..datasets.capture import Capture, CaptureFrame, OutsideError
from ..datasets.undistort import undistort_frame
from ..scene.scene import Scene, rotation_to_z_up
from .background import Background, Task
from .overlays import RecordedCameras, fov_to_fit_deg, frustum_length
from .status import Answer, Question, StatusBus
from .viewport.options import Texture
from .viewport_state import ViewportState

logger = logging.getLogger("gsrain")
_ALIKE = float(np.cos(np.radians(20.0)))
"""Tolerance of the up directions: users level a scene by a few degrees, other data sets have another up axis."""
_SAME_PLACE = 1e-6  # relative tolerance of pose entries within which the viewport camera equals that of the image


@dataclass(frozen=True, slots=True, eq=False)
class PointSample:
    """Points of a capture in its own world, with 8-bit colors."""

    positions: Float32[np.ndarray, "n 3"]
    colors: UInt8[np.ndarray, "n 3"]
    total: int
    """Number of points in the capture, including those not sampled."""


class CaptureController:
    """The open capture. Main thread only; call `poll` once a frame."""

    def __init__(self, viewport: ViewportState, status: StatusBus, background: Background) -> None:
        self._viewport, self._document, self._status = viewport, viewport.document, status
        self.capture: Capture | None = None
        self.path: Path | None = None
        """Path that the capture was read from."""
        self.chosen = 0
        self.sensor = ""
        """Camera whose views are listed and shown; "" for all."""
        self.show_frustums = True
        self.show_points = True
        self.show_picture = True
        """True if the recorded image overlays the render while the viewport camera is at its pose."""
        self.opacity = 0.5
        """Opacity of that image; 0 shows only the render."""
        self.frustum_m = 1.0
        """Length of the camera frustums, in the capture's units."""
        self.points: PointSample | None = None
        self.pictures: CaptureImageLoader | None = None
        self.textures: dict[ImageRequest, Texture] = {}
        self.points_texture: Texture | None = None
        """Points as rendered for the current viewport."""
        self.viewport_px = (960, 640)
        """Size of the viewport at the last frame."""
        self._background = background
        self.allows_outside = False
        """True if files outside of the capture's folder that its files refer to may be read."""
        self._opening: Task[tuple[Capture, PointSample | None]] | None = None
        self.in_scene_axes: bool | None = None
        """The user's choice if the capture has the scene's units and axes; None if not set."""
        self._cameras: tuple[Float64[np.ndarray, "4 4"], RecordedCameras] | None = None
        self._snapped: tuple[int, Float64[np.ndarray, "4 4"]] | None = None

    # Opening and closing

    def open(self, path: Path, *, allow_outside: bool = False) -> None:
        """Read a capture in the background; a later call supersedes an earlier one. Errors are reported.

        Asks first if the capture refers to files outside of its folder, unless `allow_outside` is set.
        """

        def take(read: tuple[Capture, PointSample | None]) -> None:
            self._opening, self.allows_outside = None, allow_outside
            self.display(path, *read)

        def fail(error: Exception) -> None:
            self._opening = None
            if isinstance(error, OutsideError):
                logger.error("%s", error)
                self._ask_about_outside(path, error)
            else:
                self._status.report(str(error))

        if self._opening is not None:
            self._opening.cancel()
        self._opening = self._background.start(
            lambda: read_capture(path, allow_outside), take, fail, message=f"Reading {path.name}", lane="capture"
        )

    def _ask_about_outside(self, path: Path, error: OutsideError) -> None:
        """Ask before files outside of a capture's folder are read."""
        text = f"{str(error).partition('; --allow')[0]}. Read files outside of its folder?"
        yes = Answer("Read them", lambda: self.open(path, allow_outside=True), "Open it with those files.")
        self._status.ask(Question("Files outside of the capture", text, (yes, Answer("Cancel"))))

    def close_capture(self) -> None:
        self.capture = self.path = self.points = self.pictures = self._snapped = None
        self.in_scene_axes = self._cameras = None
        self.chosen, self.sensor = 0, ""

    @property
    def busy(self) -> str | None:
        """Description of the read in progress, or None."""
        return None if self._opening is None else self._opening.progress.message

    @property
    def is_working(self) -> bool:
        """True while something is being read, so that frames must be drawn."""
        return self.busy is not None or (self.pictures is not None and self.pictures.is_reading)

    def poll(self) -> None:
        if self.pictures is not None:
            self.pictures.poll()

    def display(self, path: Path, capture: Capture, points: PointSample | None) -> None:
        """Open a capture that was read from a path."""
        self.close_capture()
        self.capture, self.path, self.points = capture, path, points
        self.pictures = CaptureImageLoader(capture, self._background)
        self.frustum_m = frustum_length(capture)
        self._status.dismiss()
        logger.info("Opened capture %s: %d view%s", capture.name, len(capture), "s"[: len(capture) != 1])
        for problem in capture.problems:
            logger.warning("%s: %s", capture.name, problem)

    # Views

    @property
    def view(self) -> CaptureFrame | None:
        return None if self.capture is None else self.capture[min(self.chosen, len(self.capture) - 1)]

    @property
    def listed(self) -> list[int]:
        """Indices of the views of the selected camera, in order."""
        return [i for i, view in enumerate(self.capture or ()) if self.sensor in ("", view.sensor)]

    @property
    def has_times(self) -> bool:
        return self.capture is not None and any(view.time_s for view in self.capture)

    @property
    def problems(self) -> list[str]:
        """Problems found when the capture was opened, and errors of images read since."""
        if self.capture is None or self.pictures is None:
            return []
        return [*self.capture.problems, *self.pictures.faults.values()]

    def lies_in(self, scene: Scene) -> bool:
        """Return whether the capture has the scene's units and axes: the user's choice, else if up directions agree."""
        if self.in_scene_axes is not None or self.capture is None:
            return self.in_scene_axes is not False
        ups = [np.asarray(each, np.float64) / np.linalg.norm(each) for each in (scene.up, self.capture.up)]
        return bool(scene.members) and float(np.dot(*ups)) > _ALIKE

    def to_world(self, scene: Scene) -> Float64[np.ndarray, "4 4"]:
        """Similarity from the capture to the world (meters, z up).

        Uses the scene's own transform if both share units and axes; otherwise rotates the capture's up direction to z.
        """
        if self.capture is None or self.lies_in(scene):
            return scene.scene_to_world
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_to_z_up(self.capture.up)
        return matrix

    def cameras(self, scene: Scene) -> RecordedCameras:
        """Cameras of all views in the world."""
        matrix = self.to_world(scene)
        if self._cameras is None or not np.array_equal(self._cameras[0], matrix):
            self._cameras = matrix, RecordedCameras(view.camera.moved(matrix) for view in self.capture or ())
        return self._cameras[1]

    def length_m(self, scene: Scene) -> float:
        """Length of the frustums in the world."""
        return self.frustum_m * float(np.cbrt(np.linalg.det(self.to_world(scene)[:3, :3])))

    def step(self, steps: int) -> None:
        """Select the view a number of steps further in the list, wrapping around."""
        if listed := self.listed:
            at = listed.index(self.chosen) if self.chosen in listed else -1 if steps > 0 else 0
            self.look_from(listed[(at + steps) % len(listed)])

    def look_from(self, index: int) -> None:
        """Select a view and move the viewport camera to its pose (without roll) and time."""
        if self.capture is None:
            return
        self.chosen = index
        viewport, camera, (width, height) = self._viewport, self.cameras(self._document.scene)[index], self.viewport_px
        viewport.look_from(camera)
        viewport.navigation.vertical_fov_deg = min(fov_to_fit_deg(camera, width / height), 150.0)
        if self._document.scene.actors:
            viewport.playback.clock.playing = False
            viewport.playback.clock.seek(self.capture[index].time_s)
        self._snapped = index, viewport.navigation.camera(1, 1).world_to_camera

    @property
    def view_at_camera(self) -> int | None:
        """The view whose pose the viewport camera has, or None after the user moved on."""
        if self._snapped is None or self._viewport.options.follow_path:
            return None
        index, pose = self._snapped
        now = self._viewport.navigation.camera(1, 1).world_to_camera
        return index if np.allclose(now, pose, rtol=0, atol=_SAME_PLACE * max(1.0, float(np.abs(pose).max()))) else None


def read_capture(path: Path, allow_outside: bool) -> tuple[Capture, PointSample | None]:
    """Read a capture, and sample its points."""
    from ..datasets.open_capture import open_capture  # loads every reader

    capture = open_capture(path, allow_outside=allow_outside)
    return capture, sample_points(capture)


# Point sample

MAX_POINTS = 120_000
"""Number of points that software OpenGL draws in a few milliseconds."""


def sample_points(capture: Capture) -> PointSample | None:
    """Sample points of a capture at random, at most `MAX_POINTS`; None if it has none.

    Points with colors keep them; lidar points are colored by height, from blue to red.
    """
    rng = np.random.default_rng(0)
    given = 0 if capture.points_m is None else len(capture.points_m)
    total = given + sum(len(sweep.points_m) for sweep in capture.sweeps)
    if total == 0:
        return None
    share = min(1.0, MAX_POINTS / total)
    positions: list[np.ndarray] = []
    colors: list[np.ndarray] = []
    if capture.points_m is not None and given:
        chosen = _chosen(given, share, rng)
        positions.append(capture.points_m[chosen])
        plain = np.tile(np.array((205, 210, 215), np.uint8), (len(chosen), 1))
        colors.append(plain if capture.point_colors is None else capture.point_colors[chosen])
    lidar = [sweep.points_m[_chosen(len(sweep.points_m), share, rng)] for sweep in capture.sweeps]
    if sum(map(len, lidar)):
        measured = np.concatenate(lidar).astype(np.float64)
        positions.append(measured)
        heights = measured @ np.asarray(capture.up)
        low, high = np.percentile(heights, (2, 98))
        shares = np.clip((heights - low) / max(high - low, 1e-9), 0, 1)
        turbo = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]
        colors.append(np.asarray(turbo[np.rint(shares * 255).astype(int)], np.uint8))
    return PointSample(np.concatenate(positions).astype(np.float32), np.concatenate(colors), total)


def _chosen(count: int, share: float, rng: np.random.Generator) -> np.ndarray:
    return np.arange(count) if share >= 1 else np.sort(rng.choice(count, int(count * share), replace=False))


# Images of the capture

THUMBNAIL_PX = 192
LARGE_PX = 1280
"""Widths in pixels of loaded images; all are undistorted."""

_CACHE_LIMITS = {THUMBNAIL_PX: 400, LARGE_PX: 6}
"""Number of images cached per width: 25 MB of thumbnails, 25 MB of large ones."""

Pixels = UInt8[np.ndarray, "h w 3"]


class ImageRequest(NamedTuple):
    """An image in a size."""

    view: int
    width_px: int


class CaptureImageLoader:
    """Loads images in a background thread and caches them. Main thread only; call `poll` once a frame."""

    def __init__(self, capture: Capture, background: Background) -> None:
        self.faults: dict[int, str] = {}
        self._capture, self._background = capture, background
        self._reading: Task[Pixels] | None = None
        self._images: OrderedDict[ImageRequest, Pixels] = OrderedDict()
        self._requests: dict[ImageRequest, None] = {}

    def want(self, view: int, width_px: int) -> Pixels | None:
        """Return an image of at most this width, or None while it is being read; call again each frame."""
        request = ImageRequest(view, width_px)
        if request in self._images:
            self._images.move_to_end(request)
            return self._images[request]
        if view not in self.faults:
            self._requests[request] = None
        return None

    def __iter__(self) -> Iterator[tuple[ImageRequest, Pixels]]:
        return iter(self._images.items())

    @property
    def is_reading(self) -> bool:
        """True while a requested image is not loaded yet."""
        return self._reading is not None or bool(self._requests)

    def poll(self) -> None:
        """Start to read an image that the last frame requested."""
        requests = [each for each in self._requests if each not in self._images and each.view not in self.faults]
        self._requests.clear()
        if requests and self._reading is None:
            self._read(max(requests, key=lambda each: each.width_px))  # the selected image before the thumbnails

    def _read(self, request: ImageRequest) -> None:
        view = self._capture[request.view]

        def take(pixels: Pixels) -> None:
            self._reading, self._images[request] = None, pixels
            same = [each for each in self._images if each.width_px == request.width_px]
            for old in same[: -_CACHE_LIMITS[request.width_px]]:
                del self._images[old]

        def fail(error: Exception) -> None:
            self._reading, self.faults[request.view] = None, str(error)

        width = min(request.width_px, view.camera.width)
        self._reading = self._background.start(lambda: undistort_frame(view, width).image, take, fail, lane="capture")
