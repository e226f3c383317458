"""Training views: undistorted images at three sizes, with masks, depth and sky."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from ..datasets.capture import Capture, CaptureFrame
from ..datasets.undistort import undistort_frame
from ..scene.camera import Camera
from .settings import LEVELS

_SMALLEST_PX = 48  # images are not halved below this side length


@dataclass(frozen=True, slots=True, eq=False)
class PyramidLevel:
    """One view at one size."""

    camera: Camera
    image: UInt8[np.ndarray, "h w 3"]
    mask: Bool[np.ndarray, "h w"] | None
    """Pixels used for training; None means all."""
    depth: Float32[np.ndarray, "h w"] | None
    """Along the view axis; 0 where unmeasured."""
    sky: Bool[np.ndarray, "h w"] | None


@dataclass(frozen=True, slots=True, eq=False)
class TrainingView:
    """One view at all its sizes: full, half and quarter."""

    name: str
    time_s: float
    seen: Bool[np.ndarray, "h w"] | None
    """Pixels used for evaluation: visible to the lens and allowed by the dataset; None means all."""
    levels: tuple[PyramidLevel, ...]

    @classmethod
    def of(
        cls,
        view: CaptureFrame,
        depth: Float32[np.ndarray, "h w"] | None,
        learned: Bool[np.ndarray, "h w"] | None,
        sky: Bool[np.ndarray, "h w"] | None,
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
    return PyramidLevel(
        camera,
        image,
        None if level.mask is None else _all_of_four(level.mask[even]),
        None if level.depth is None else _nearest_of_four(level.depth[even]),
        None if level.sky is None else _all_of_four(level.sky[even]),
    )


def _all_of_four(mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h2 w2"]:
    return np.asarray(_fours(mask).all(axis=(1, 3)))


def _nearest_of_four(depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h2 w2"]:
    nearest = np.where(_fours(depth) > 0, _fours(depth), np.float32(np.inf)).min(axis=(1, 3))
    return np.where(np.isfinite(nearest), nearest, np.float32(0))


def _fours(values: np.ndarray) -> np.ndarray:
    height, width = values.shape
    return values.reshape(height // 2, 2, width // 2, 2)
