"""Training data: the task of a reconstruction, and its undistorted views at three sizes with masks, depth and sky."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
from jaxtyping import Float32, UInt8

from ..datasets.capture import Capture, CaptureError, CaptureFrame, readable_images
from ..datasets.image_override import with_images
from ..datasets.layout_hints import nearest_layout
from ..datasets.masks import read_camera_masks, with_camera_masks
from ..datasets.open_capture import open_capture
from ..datasets.undistort import undistort_frame
from ..evaluation.image_metrics import Mask
from ..safe_io.file_names import shortened
from ..scene.camera import Camera
from .evaluation import validation_indices
from .schedule import LEVELS
from .settings import TrainingSettings


class ReconstructionTask(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A reconstruction request; picklable for a worker process."""

    capture: Path
    output: Path
    settings: TrainingSettings
    images: Path | None = None
    """Folder with images that replace the capture's own."""
    masks: Path | None = None
    """Folder with one mask image per camera, of the same name: white pixels are used, black ones (own hood) are not."""
    resume: bool = False
    """Resume from the checkpoint next to the output."""
    lpips: Path | None = None
    """LPIPS weights; None uses those installed on this machine, if any."""
    report: Path | None = None
    snapshot: Path | None = None
    """Scene folder for a preview, rewritten at each held-out evaluation."""

    allow_outside: bool | None = None
    """Allow files outside the capture's folder that its files name; None leaves it to the context."""

    @property
    def checkpoint(self) -> Path:
        """Checkpoint file of this task; removed once the scene is written."""
        return self.output.with_name(f"{shortened(self.output.name)}.checkpoint.npz")

    def read(self) -> Capture:
        """Read the capture; raises `CaptureError`, also if it has nothing to train on."""
        capture = readable_images(open_capture(self.capture, allow_outside=self.allow_outside))
        if self.images is not None:
            capture = with_images(capture, self.images)
        if self.masks is not None:
            capture = replace(capture, views=with_camera_masks(capture.views, read_camera_masks(self.masks)))
        if not capture.has_poses:
            near = nearest_layout(self.capture)
            raise CaptureError(
                f"{self.capture}: nothing tells where the cameras stood; let COLMAP find it, and give its folder"
                + (f"; nearest to this one is {near}" if near is not None else "")
            )
        if len(capture) < 2:
            raise CaptureError(
                f"{self.capture}: has {len(capture)} usable view{'s' * (not capture.views)}, at least 2 are needed"
            )
        self.held_out(capture)
        return capture

    def held_out(self, capture: Capture) -> list[int]:
        settings = self.settings
        return validation_indices([view.name for view in capture], settings.held_out, settings.held_out_views)

    def fingerprint(self, capture: Capture) -> str:
        """Text that identifies a capture's views, so that a checkpoint resumes only with its own."""
        names = [view.name for view in capture]
        pictures = "" if self.images is None else f", pictures of {self.images.name}"
        return f"{len(names)} views of {capture.name}, {names[0]} to {names[-1]}{pictures}"


# Views

_SMALLEST_PX = 48  # images are not halved below this side length


@dataclass(frozen=True, slots=True, eq=False)
class PyramidLevel:
    """One view at one size."""

    camera: Camera
    image: UInt8[np.ndarray, "h w 3"]
    mask: Mask | None
    """Pixels used for training; None means all."""
    depth: Float32[np.ndarray, "h w"] | None
    """Along the view axis; 0 where unmeasured."""
    sky: Mask | None


@dataclass(frozen=True, slots=True, eq=False)
class TrainingView:
    """One view at all its sizes: full, half and quarter."""

    name: str
    time_s: float
    valid: Mask | None
    """Pixels used for evaluation: visible to the lens and allowed by the dataset; None means all."""
    levels: tuple[PyramidLevel, ...]

    @classmethod
    def of(
        cls, view: CaptureFrame, depth: Float32[np.ndarray, "h w"] | None, learned: Mask | None, sky: Mask | None
    ) -> "TrainingView":
        """Build the image pyramid of an undistorted view."""
        levels = [PyramidLevel(view.camera, view.image, learned, depth, sky)]
        while len(levels) < LEVELS:
            last = levels[-1]
            small = min(last.camera.width, last.camera.height) < 2 * _SMALLEST_PX
            levels.append(last if small else half_size(last))
        return cls(view.name, view.time_s, view.mask, tuple(levels))


def training_views(capture: Capture, width_px: int) -> list[CaptureFrame]:
    """Undistorted views at most `width_px` wide, with image and mask in memory."""
    views: list[CaptureFrame] = []
    for view in capture:
        straight = undistort_frame(view, min(width_px, view.camera.width))
        views.append(replace(straight, image_source=straight.image, mask_source=straight.mask))
    return views


def half_size(level: PyramidLevel) -> PyramidLevel:
    """Return the view at half size: colors are averaged, depth is the nearest of four, masks need all four pixels."""
    height, width = level.camera.height // 2, level.camera.width // 2
    camera = replace(
        level.camera, width=width, height=height, fx=level.camera.fx / 2, fy=level.camera.fy / 2,
        cx=level.camera.cx / 2, cy=level.camera.cy / 2,
    )  # fmt: skip
    even = (slice(0, 2 * height), slice(0, 2 * width))
    image = cv2.resize(level.image[even], (width, height), interpolation=cv2.INTER_AREA)
    flags = (level.mask, level.sky)
    mask, sky = (None if each is None else np.asarray(_fours(each[even]).all(axis=(1, 3))) for each in flags)
    depth = None
    if level.depth is not None:
        fours = _fours(level.depth[even])
        nearest = np.where(fours > 0, fours, np.float32(np.inf)).min(axis=(1, 3))
        depth = np.where(np.isfinite(nearest), nearest, np.float32(0))
    return PyramidLevel(camera, image, mask, depth, sky)


def _fours(values: np.ndarray) -> np.ndarray:
    height, width = values.shape
    return values.reshape(height // 2, 2, width // 2, 2)
