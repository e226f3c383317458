"""The rain regions as lines in the picture."""

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from gsrain_engine.rain.rain import Box
from gsrain_engine.render.scene_view import rain_anchor
from gsrain_engine.scene.camera import Camera

from ..session import Session

_NEAR_M = 0.05
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]


class RegionOutline(NamedTuple):
    """The edges of one region."""

    name: str
    lines_px: Float64[np.ndarray, "m 2 2"]
    """Start and end of each edge that is in front of the camera, as x, y in pixels of the picture."""


def region_outlines(session: Session, width: int, height: int) -> list[RegionOutline]:
    """Project the regions that the view options ask for."""
    shown = []
    if session.view.show_streak_region:
        shown.append(("streak region", session.rain.streak_region))
    if session.view.show_haze_region:
        shown.append(("haze region", session.rain.haze_region))
    shot = session.shot(width, height)
    anchor = rain_anchor(session.shown_scene, session.shown_rainfall, shot)
    return [RegionOutline(name, project_edges(box, anchor, shot.camera)) for name, box in shown]


def project_edges(
    box: Box, anchor_to_world: Float64[np.ndarray, "4 4"], camera: Camera
) -> Float64[np.ndarray, "m 2 2"]:
    """Project the twelve edges of a box, each cut off at the near plane."""
    corners = np.array(list(product(*zip(box.minimum_m, box.maximum_m, strict=True))))
    to_camera = camera.world_to_camera @ anchor_to_world
    points = corners @ to_camera[:3, :3].T + to_camera[:3, 3]
    lines = [cut for a, b in _EDGES if (cut := _in_front(points[a], points[b])) is not None]
    if not lines:
        return np.zeros((0, 2, 2))
    cut = np.array(lines)
    focal, center = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    return focal * cut[..., :2] / cut[..., 2:] + center


def _in_front(start: Float64[np.ndarray, "3"], end: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "2 3"] | None:
    if start[2] < _NEAR_M and end[2] < _NEAR_M:
        return None
    line = np.array([start, end])
    behind = line[:, 2] < _NEAR_M
    if behind.any():
        share = (_NEAR_M - start[2]) / (end[2] - start[2])
        line[behind] = start + share * (end - start)
    return line
