"""Views prepared for training: without distortion, of a given size, with a mask of pixels covered by the lens."""

from dataclasses import replace
from functools import lru_cache, partial

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Shaped, UInt8

from ..scene.camera import Camera
from ..scene.lens import Lens, largest_tangent
from .capture import CaptureFrame
from .geometry import intrinsics, scaled_camera

_CACHED_LENSES = 8  # number of cached lens maps of 8 bytes a pixel each, enough for a rig's cameras
_AT_CENTERS = ("depth", "normals", "labels", "sky")


def undistort_frame(view: CaptureFrame, width: int | None = None) -> CaptureFrame:
    """Undistort a view (OpenCV) and scale it to a width, keeping its proportions; arrays are read on demand.

    Color is averaged over area; depth, normals, labels and sky are those at the pixel's center. The mask is True if all
    source pixels of a pixel are inside the lens's range and usable for training.
    """
    camera = view.camera
    if width is not None:
        if width < 1:
            raise ValueError(f"width {width}: must be at least 1 px")
        camera = scaled_camera(camera, width, max(round(camera.height * width / camera.width), 1))
    if view.lens is None and camera is view.camera:
        return view
    at_centers = {
        f"{name}_source": partial(_nearest, view, camera, name)
        for name in _AT_CENTERS
        if getattr(view, f"{name}_source") is not None
    }
    needs_mask = view.lens is not None or view.mask_source is not None
    return replace(
        view,
        camera=camera,
        lens=None,
        image_source=partial(_color, view, camera),
        mask_source=partial(_mask, view, camera) if needs_mask else None,
        **at_centers,
    )


def _color(view: CaptureFrame, camera: Camera) -> UInt8[np.ndarray, "h w 3"]:
    straight = view.image
    if view.lens is not None:
        lens_map = _lens_map(_key(view.camera), view.lens)
        straight = cv2.remap(straight, *lens_map, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(_resized(straight, camera), np.uint8)


def _mask(view: CaptureFrame, camera: Camera) -> Bool[np.ndarray, "h w"]:
    size, allowed = (view.camera.height, view.camera.width), view.mask
    usable = np.ones(size, np.float32) if allowed is None else allowed.astype(np.float32)
    if view.lens is not None:
        columns, rows = _lens_map(_key(view.camera), view.lens)
        usable = cv2.remap(usable, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(_resized(np.asarray(usable, np.float32), camera) > 1 - 1e-3)


def _resized(pixels: Shaped[np.ndarray, "h w ..."], camera: Camera) -> Shaped[np.ndarray, "h2 w2 ..."]:
    if pixels.shape[:2] == (camera.height, camera.width):
        return pixels
    interpolation = cv2.INTER_AREA if camera.width < pixels.shape[1] else cv2.INTER_LINEAR
    return cv2.resize(pixels, (camera.width, camera.height), interpolation=interpolation)


def _nearest(view: CaptureFrame, camera: Camera, name: str) -> Shaped[np.ndarray, "h w ..."]:
    """Take each pixel's value at its center's position in the original; 0 outside the lens's range."""
    pixels = getattr(view, name)
    columns, rows = _source_pixels(view, camera)
    inside = (columns >= 0) & (columns < view.camera.width) & (rows >= 0) & (rows < view.camera.height)
    values = pixels[np.where(inside, rows, 0), np.where(inside, columns, 0)]
    values[~inside] = 0
    return values


def _source_pixels(view: CaptureFrame, camera: Camera) -> tuple[Shaped[np.ndarray, "h w"], Shaped[np.ndarray, "h w"]]:
    """Column and row in the original image of each pixel of a camera at the same pose."""
    if view.lens is not None:
        columns, rows = _bending_map(_key(view.camera), view.lens, _key(camera))
        return np.floor(columns + 0.5).astype(np.int64), np.floor(rows + 0.5).astype(np.int64)
    columns = (np.arange(camera.width) + 0.5) * view.camera.width / camera.width
    rows = (np.arange(camera.height) + 0.5) * view.camera.height / camera.height
    both = np.broadcast_arrays(columns[None].astype(np.int64), rows[:, None].astype(np.int64))
    return both[0], both[1]


_Key = tuple[int, int, float, float, float, float]


def _key(camera: Camera) -> _Key:
    """Camera properties that determine a lens map; the pose does not."""
    return camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy


@lru_cache(maxsize=_CACHED_LENSES)
def _lens_map(key: _Key, lens: Lens) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    return _bending_map(key, lens, key)


def _bending_map(
    source: _Key, lens: Lens, straight: _Key
) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Column and row (first center at 0) in the distorted image of each undistorted pixel; far outside if none."""
    bent_k, straight_k = intrinsics(Camera(*source), 0.0), intrinsics(Camera(*straight), 0.0)
    size, coefficients = straight[:2], np.array(lens.coefficients)
    undistort = cv2.fisheye.initUndistortRectifyMap if lens.model == "fisheye" else cv2.initUndistortRectifyMap
    columns, rows = undistort(bent_k, coefficients, np.eye(3), straight_k, size, cv2.CV_32FC1)
    width, height, fx, fy, cx, cy = straight
    x, y = (np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy
    folded = np.hypot(x[None], y[:, None]) > largest_tangent(lens)
    columns[folded] = rows[folded] = -1e6
    return np.asarray(columns, np.float32), np.asarray(rows, np.float32)
