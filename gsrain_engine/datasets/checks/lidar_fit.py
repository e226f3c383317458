"""How well a lidar's depth edges meet a picture's edges under a pose (after Levinson and Thrun 2013)."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from gsrain_engine.scene.camera import Camera

from ..capture import Sweep, View
from ..geometry.lens_projection import project_points
from ..geometry.lidar_depth import pixels_inside
from ..prepared import prepared

WIDTH_PX = 640
"""Pictures are looked at in this width: far edges of a lidar with 32 beams are no finer."""

_CELL_DEG = (0.4, 1.4)
_JUMP_PART, _JUMP_M = 0.1, 0.5
_OWN_CAR_M = 2.0
_BLUR_PX, _AROUND_PX, _CLEAREST = 1.5, 81, 6.0
_TURNS_DEG = (-6.0, -4.0, -2.5, 2.5, 4.0, 6.0)
_FEWEST_POINTS = 40


@dataclass(frozen=True, slots=True, eq=False)
class EdgePicture:
    """A picture's edges, ready to be met."""

    view: View
    """Straight lines, `WIDTH_PX` wide."""
    clearness: Float32[np.ndarray, "h w"]
    """How many times steeper the colour is here than around: leaves are steep all over and hide no edge for that."""


def edge_picture(view: View) -> EdgePicture:
    """Find a view's edges across. Raises `CaptureError` where its picture can't be read."""
    straight = prepared(view, min(WIDTH_PX, view.camera.width)).held()
    lab = cv2.cvtColor(straight.image, cv2.COLOR_RGB2LAB).astype(np.float32)
    steep = cv2.Sobel(cv2.GaussianBlur(lab, (0, 0), _BLUR_PX), cv2.CV_32F, 1, 0, ksize=3)
    steep = cv2.dilate(np.linalg.norm(steep, axis=2), np.ones((3, 5)))
    around = cv2.blur(steep, (_AROUND_PX, _AROUND_PX)) + 2.0
    return EdgePicture(straight, np.minimum(steep / around, _CLEAREST).astype(np.float32))


def depth_edges(sweep: Sweep) -> Float64[np.ndarray, "e 3"]:
    """Points of a sweep beside which, as the lidar saw it, lies something much farther away, or only sky (world)."""
    rays = sweep.points_m.astype(np.float64) - sweep.origin_m
    ranges = np.linalg.norm(rays, axis=1)
    kept = ranges > _OWN_CAR_M
    points, rays, ranges = sweep.points_m[kept], rays[kept], ranges[kept]
    across = np.degrees(np.arctan2(rays[:, 1], rays[:, 0]))
    up = np.degrees(np.arcsin(np.clip(rays[:, 2] / ranges, -1, 1)))
    columns, rows = round(360 / _CELL_DEG[0]), round(180 / _CELL_DEG[1])
    column = ((across + 180) / 360 * columns).astype(np.int64) % columns
    row = np.clip(((up + 90) / 180 * rows).astype(np.int64), 0, rows - 1)
    order = np.argsort(-ranges)  # the nearest of a cell comes last and stays
    cells = np.full((rows, columns), -1, np.int64)
    cells[row[order], column[order]] = order
    image = np.full(cells.shape, np.nan)
    image[cells >= 0] = ranges[cells[cells >= 0]]
    edge = np.zeros(image.shape, np.bool_)
    for side in (-1, 1):
        beside = [np.roll(image, side * step, axis=1) for step in (1, 2, 3, 4)]
        farther = image * (1 + _JUMP_PART) + _JUMP_M
        edge |= (beside[0] > farther) & ~(beside[1] < farther)  # a single far point is no edge
        edge |= np.isnan(beside).all(axis=0)
    return points[cells[edge & (cells >= 0)]].astype(np.float64)


def _met(edges: EdgePicture, points: Float64[np.ndarray, "e 3"], camera: Camera) -> tuple[float, int]:
    """Mean clearness of the picture's edges at the points under a camera, and how many fall into the picture."""
    pixels, _ = project_points(points, camera)
    rows, columns, inside = pixels_inside(pixels, edges.clearness.shape)
    count = int(np.count_nonzero(inside))
    return (float(edges.clearness[rows[inside], columns[inside]].mean()) if count else 0.0), count


def fit(edges: EdgePicture, points: Float64[np.ndarray, "e 3"], camera: Camera) -> float:
    """How far a pose stands out from itself turned by some degrees, in standard deviations; NaN where nothing falls in.

    A true pose stands out by 2 to 8, a wrong one by 0 on average and hardly by more than 2.
    """
    own, count = _met(edges, points, camera)
    if count < _FEWEST_POINTS:
        return float("nan")
    others = [_met(edges, points, each)[0] for each in _turned(camera)]
    spread = float(np.std(others))
    return (own - float(np.mean(others))) / spread if spread > 0 else 0.0


def _turned(camera: Camera) -> list[Camera]:
    """The camera turned left, right, up and down, and both at once."""
    cameras: list[Camera] = []
    for yaw in _TURNS_DEG:
        for pitch in (0.0, -yaw / 2, yaw / 2):
            turn, _ = cv2.Rodrigues(np.radians([pitch, yaw, 0.0]))
            matrix = np.eye(4)
            matrix[:3, :3] = turn
            cameras.append(replace(camera, world_to_camera=matrix @ camera.world_to_camera))
    return cameras
