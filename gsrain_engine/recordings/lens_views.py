"""Pictures for a lens: rain is drawn by a pinhole camera that covers it, and sampled where the lens sends each ray."""

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float32, Shaped

from ..datasets.capture import CaptureFrame, Lens
from ..datasets.geometry import intrinsics, largest_tangent
from ..scene.camera import Camera

_WIDEST = 2.2
"""Largest tangent of an angle from the axis that rain is drawn for (65 degrees); beyond, the picture's edge goes on."""

_CACHED_LENSES = 8  # enough for a rig's cameras; 8 bytes a pixel each
_LensKey = tuple[int, int, float, float, float, float]


def lens_tangents(view: CaptureFrame) -> Float32[np.ndarray, "h w 2"]:
    """Tangents x / z and y / z of the ray that each pixel of a view has taken through its lens."""
    camera = view.camera
    return _tangents((camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy), view.lens)


@lru_cache(maxsize=_CACHED_LENSES)
def _tangents(key: _LensKey, lens: Lens | None) -> Float32[np.ndarray, "h w 2"]:
    width, height, fx, fy, cx, cy = key
    if lens is None:
        x, y = (np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy
        return np.stack(np.meshgrid(x, y), axis=-1).astype(np.float32)
    matrix = intrinsics(Camera(width, height, fx, fy, cx, cy))
    pixels = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1).reshape(-1, 1, 2)
    undistort = cv2.fisheye.undistortPoints if lens.model == "fisheye" else cv2.undistortPoints
    found = np.asarray(undistort(pixels, matrix, np.array(lens.coefficients)), np.float64).reshape(height, width, 2)
    widest = min(largest_tangent(lens), _WIDEST)
    length = np.linalg.norm(found, axis=-1, keepdims=True)
    found *= np.minimum(widest / np.maximum(np.nan_to_num(length, nan=np.inf), 1e-9), 1)
    return np.nan_to_num(found).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class LensView:
    """A view and the pinhole camera that covers its rays, with the same focal lengths."""

    view: CaptureFrame
    camera: Camera

    @classmethod
    def of(cls, view: CaptureFrame, camera: Camera) -> "LensView":
        """Cover a view; `camera` is its own, in any world."""
        if view.lens is None:
            return cls(view, camera)
        rays = lens_tangents(view)
        (left, top), (right, bottom) = rays.min(axis=(0, 1)), rays.max(axis=(0, 1))
        return cls(
            view,
            replace(
                camera,
                cx=float(-left * camera.fx) + 1,
                cy=float(-top * camera.fy) + 1,
                width=int(np.ceil((right - left) * camera.fx)) + 2,
                height=int(np.ceil((bottom - top) * camera.fy)) + 2,
            ),
        )

    def through_lens(self, pixels: Shaped[np.ndarray, "h w ..."]) -> Shaped[np.ndarray, "h2 w2 ..."]:
        """Sample a picture of the pinhole camera as the view's lens takes it."""
        return pixels if self.view.lens is None else sampled(pixels, self.camera, self.view)


def sampled(
    pixels: Shaped[np.ndarray, "h w ..."], camera: Camera, view: CaptureFrame
) -> Shaped[np.ndarray, "h2 w2 ..."]:
    """Sample an image of a pinhole camera at the rays of a view, which has the same pose."""
    rays = lens_tangents(view)
    columns = rays[..., 0] * np.float32(camera.fx) + np.float32(camera.cx - 0.5)
    rows = rays[..., 1] * np.float32(camera.fy) + np.float32(camera.cy - 0.5)
    pixels = np.ascontiguousarray(pixels)
    return np.asarray(cv2.remap(pixels, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
