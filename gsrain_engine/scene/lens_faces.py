"""Pinhole pictures from which a picture through a lens is sampled.

One that covers all rays up to 62 degrees from the axis, else those faces of a cube that rays hit. What is computed on
planes, such as the mirror of wet ground and the light of lamps, is sampled from one face of up to 76 degrees.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Shaped

from .camera import Camera
from .lens import Lens, PixelRays
from .rolling_shutter import RollingShutter

_WIDEST_DEG, _WIDEST_PLANE_DEG = 62.0, 76.0
_LARGEST_FACE_PX = 4096
_MARGIN_PX = 2


@dataclass(frozen=True, slots=True, eq=False)
class LensFace:
    """A pinhole picture from which pixels of a lens are sampled."""

    camera: Camera
    """At the origin, with the axes of the lens' camera but for `turn`."""
    turn: Float64[np.ndarray, "3 3"]
    """Axes of the face in those of the lens."""
    columns: Float32[np.ndarray, "h w"]
    rows: Float32[np.ndarray, "h w"]
    """Coordinates in the face's picture, as OpenCV counts them: 0 is the center of the first pixel."""
    covered: Bool[np.ndarray, "h w"]
    """Pixels of the lens that are sampled from this face."""

    def of(self, camera: Camera) -> Camera:
        """Camera of the face where a camera with the lens is."""
        turned = np.eye(4)
        turned[:3, :3] = self.turn.T
        pose = turned @ camera.world_to_camera
        return replace(self.camera, world_to_camera=pose, exposure_s=camera.exposure_s)

    def sampled(self, picture: Shaped[np.ndarray, "a b ..."]) -> Shaped[np.ndarray, "h w ..."]:
        """Picture of the face at the pixels of the lens; any value where it does not cover them."""
        return cv2.remap(picture, self.columns, self.rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def assemble(faces: tuple[LensFace, ...], pictures: list[Shaped[np.ndarray, "_ _ c"]]) -> Shaped[np.ndarray, "h w c"]:
    """Picture through a lens from those of its faces, in their order; pixels that no ray comes to are 0."""
    height, width = faces[0].covered.shape
    found = np.zeros((height, width, pictures[0].shape[2]), pictures[0].dtype)
    for face, picture in zip(faces, pictures, strict=True):
        found[face.covered] = face.sampled(picture)[face.covered]
    return found


def lens_faces(camera: Camera) -> tuple[LensFace, ...]:
    """Faces of a camera that has a lens; none if it images nothing."""
    return _lens_faces(_size(camera), camera.lens, camera.rolling)


def wide_face(camera: Camera) -> LensFace:
    """One face of a camera with a lens, of all rays up to 76 degrees from the axis."""
    return _wide_face(_size(camera), camera.lens, camera.rolling)


_Intrinsics = tuple[int, int, float, float, float, float]


def _size(c: Camera) -> _Intrinsics:
    return c.width, c.height, c.fx, c.fy, c.cx, c.cy


@lru_cache(maxsize=8)
def _lens_faces(size: _Intrinsics, lens: Lens | None, rolling: RollingShutter | None) -> tuple[LensFace, ...]:
    rays = Camera(*size, lens=lens, rolling=rolling).rays
    directions, is_imaged = rays.directions.astype(np.float64), rays.is_imaged
    if not is_imaged.any():
        return ()
    focal = _pixels_per_radian(directions, is_imaged)
    if directions[is_imaged][:, 2].min() > math.cos(math.radians(_WIDEST_DEG)):
        return (_face(directions, is_imaged, np.eye(3), focal),)
    forwards = np.stack([turn[:, 2] for turn in _CUBE.values()])
    nearest = (directions @ forwards.T).argmax(axis=-1)
    found: list[LensFace] = []
    for index, turn in enumerate(_CUBE.values()):
        covered = is_imaged & (nearest == index)
        if covered.any():
            found.append(_face(directions, covered, turn, focal))
    return tuple(found)


@lru_cache(maxsize=8)
def _wide_face(size: _Intrinsics, lens: Lens | None, rolling: RollingShutter | None) -> LensFace:
    rays: PixelRays = Camera(*size, lens=lens, rolling=rolling).rays
    directions = rays.directions.astype(np.float64)
    covered = rays.is_imaged & (directions[..., 2] > math.cos(math.radians(_WIDEST_PLANE_DEG)))
    if not covered.any():
        covered = np.ones_like(covered)
        directions = np.broadcast_to(np.array([0.0, 0.0, 1.0]), directions.shape)
    focal = math.sqrt(size[2] * size[3])
    return _face(directions, covered, np.eye(3), focal)


_CUBE = {
    "front": np.eye(3),
    "right": np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], np.float64),
    "left": np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], np.float64),
    "down": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float64),
    "up": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], np.float64),
    "back": np.array([[-1, 0, 0], [0, 1, 0], [0, 0, -1]], np.float64),
}
"""Axes of each face (columns: right, down, forward) in those of the lens."""


def _pixels_per_radian(directions: Float64[np.ndarray, "h w 3"], is_imaged: Bool[np.ndarray, "h w"]) -> float:
    """Largest density of pixels across and down, in the middle half of all that see anything."""
    densities: list[float] = [1.0]
    for axis in (0, 1):
        if directions.shape[axis] > 1:
            steps = np.linalg.norm(np.diff(directions, axis=axis), axis=-1)
            both = np.logical_and(*(np.take(is_imaged, range(k, is_imaged.shape[axis] - 1 + k), axis) for k in (0, 1)))
            if both.any():
                densities.append(1 / max(float(np.quantile(steps[both], 0.25)), 1e-6))
    return max(densities)


def _face(
    directions: Float64[np.ndarray, "h w 3"],
    covered: Bool[np.ndarray, "h w"],
    turn: Float64[np.ndarray, "3 3"],
    focal: float,
) -> LensFace:
    """Pinhole picture of the rays of some pixels, cut to them."""
    local = directions @ turn
    points = local[..., :2] / np.where(covered, local[..., 2], 1.0)[..., None]
    low, high = points[covered].min(axis=0), points[covered].max(axis=0)
    focal = min(focal, (_LARGEST_FACE_PX - 2 * _MARGIN_PX) / max(float((high - low).max()), 1e-6))
    start = np.floor(low * focal) - _MARGIN_PX
    width, height = (np.ceil(high * focal) + _MARGIN_PX - start).astype(int).tolist()
    camera = Camera(width, height, focal, focal, -float(start[0]), -float(start[1]))
    columns, rows = np.moveaxis((points * focal - start - 0.5).astype(np.float32), -1, 0)
    return LensFace(camera, turn, np.ascontiguousarray(columns), np.ascontiguousarray(rows), covered)
