"""Recorded cameras as pyramids in the picture, and their pictures on the pyramids' far sides."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.scene.camera import Camera

from ..view.projection import NEAR_M, projected_lines, projected_point

MOST_FRUSTUMS = 100
"""Those nearest to the eye are drawn: more of them hide what they stand in."""

_NEAR = 1e-6
_TIP = 0.5
"""Of a pyramid's length: from nearer, its picture covers two thirds of the view or more."""


class Frustum(NamedTuple):
    """One recorded camera in the picture."""

    view: int
    eye_px: tuple[float, float] | None
    """Where its centre of projection is seen; None where it is not."""
    lines_px: Float64[np.ndarray, "m 2 2"]


class RecordedCameras:
    """Cameras of views in the world, with where they are and what they see as arrays: made once, drawn each frame."""

    def __init__(self, cameras: Iterable[Camera]) -> None:
        self._cameras = tuple(cameras)
        self.eyes: Float64[np.ndarray, "n 3"] = np.array([each.position for each in self._cameras]).reshape(-1, 3)
        corners = [image_corners(each, 1.0) - each.position for each in self._cameras]
        self.rays: Float64[np.ndarray, "n 4 3"] = np.array(corners).reshape(-1, 4, 3)
        """From the eye to the picture's corners on a plane 1 m in front of it."""

    def __len__(self) -> int:
        return len(self._cameras)

    def __getitem__(self, view: int) -> Camera:
        return self._cameras[view]


def frustums(cameras: RecordedCameras, views: Sequence[int], length_m: float, camera: Camera) -> list[Frustum]:
    """Project the chosen views that are nearest to the eye into a picture, the farthest of them first.

    Those at whose tip the eye is are left out: their pictures would hide the scene.
    """
    chosen = np.asarray(views, np.int64)
    distances = np.linalg.norm(cameras.eyes[chosen] - camera.position, axis=1)
    is_apart = distances > _TIP * length_m
    chosen, distances = chosen[is_apart], distances[is_apart]
    nearest = chosen[np.argsort(distances, kind="stable")[:MOST_FRUSTUMS][::-1]]
    if not len(nearest):
        return []
    eyes = cameras.eyes[nearest]
    corners = eyes[:, None] + length_m * cameras.rays[nearest]
    sides = np.stack([np.broadcast_to(eyes[:, None], corners.shape), corners], axis=2)
    far = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)
    lines = np.concatenate([sides, far], axis=1)  # (frustums, 8 lines, 2 ends, 3)
    depth = lines @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
    seen = (depth > NEAR_M).any(axis=2).sum(axis=1)
    drawn = np.split(projected_lines(lines.reshape(-1, 2, 3), camera), np.cumsum(seen)[:-1])
    return [
        Frustum(int(view), seen and (seen.x, seen.y), own)
        for view, seen, own in zip(nearest, (projected_point(each, camera) for each in eyes), drawn, strict=True)
        if len(own)
    ]


def image_corners(camera: Camera, length_m: float) -> Float64[np.ndarray, "4 3"]:
    """World positions of a picture's corners on a plane so far in front of its camera: from top left, clockwise."""
    w, h = camera.width, camera.height
    return _on_plane(camera, length_m, np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float64))


def picture_grid(
    shown: Camera, length_m: float, camera: Camera, cells: tuple[int, int]
) -> Float64[np.ndarray, "rows columns 2"] | None:
    """Pixels at which a grid over a recorded picture (cells across and down) is seen; None where it is behind the eye.

    Seen from the recorded camera itself, the picture is where it was taken, whatever `length_m` is.
    """
    columns, rows = np.meshgrid(np.linspace(0, shown.width, cells[0] + 1), np.linspace(0, shown.height, cells[1] + 1))
    points = _on_plane(shown, length_m, np.stack([columns.ravel(), rows.ravel()], axis=1))
    seen = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    if seen[:, 2].min() < max(0.02 * length_m, _NEAR):
        return None
    focal, center = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    return (focal * seen[:, :2] / seen[:, 2:] + center).reshape(*columns.shape, 2)


def fitting_fov_deg(shown: Camera, aspect: float) -> float:
    """Vertical angle of a viewport (width over height) with this line of sight that sees a whole recorded picture."""
    upward = max(shown.cy, shown.height - shown.cy) / shown.fy
    sideways = max(shown.cx, shown.width - shown.cx) / shown.fx
    return float(np.degrees(2 * np.arctan(max(upward, sideways / aspect))))


def frustum_length(capture: Capture) -> float:
    """A length for the pyramids, in the capture's units: they show which way views look and seldom overlap."""
    places = np.array([view.camera.position for view in capture])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    steps = steps[steps > 1e-9]
    if not len(steps):
        return 1.0
    extent = float(np.linalg.norm(np.ptp(places, axis=0)))
    return float(np.clip(0.8 * np.median(steps), extent / 60, max(extent / 4, 1e-6)))


def _on_plane(camera: Camera, length_m: float, pixels: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 3"]:
    pose = camera.camera_to_world
    x, y = (pixels[:, 0] - camera.cx) / camera.fx, (pixels[:, 1] - camera.cy) / camera.fy
    return length_m * np.stack([x, y, np.ones(len(x))], axis=1) @ pose[:3, :3].T + pose[:3, 3]
