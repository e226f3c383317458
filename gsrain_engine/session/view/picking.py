"""What is under a pixel: the Gaussian that a person means by pointing at it, and the point of its surface."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from gsrain_engine.raster.projection import project
from gsrain_engine.raster.splats import Splats
from gsrain_engine.render.scene_view import Shot
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.members import Actor, Layer, Part
from gsrain_engine.scene.rotations import matrices_from_quaternions
from gsrain_engine.scene.scene import Scene

_LEAST_ALPHA = 0.1
"""A pixel that is covered less than this shows nothing to point at."""


class Picked(NamedTuple):
    """What is under a pixel."""

    key: str
    """Of the member that it belongs to."""
    gaussian: int
    """Of the Gaussian among the member's."""
    point_m: Float64[np.ndarray, "3"]
    """Where the line of sight meets its surface, in the world."""


def pick_point(scene: Scene, shot: Shot, x: float, y: float) -> Float64[np.ndarray, "3"] | None:
    """Return the point of the world (metres) that is seen at a pixel; None where nothing or only sky is.

    Pixels count from the picture's upper left corner; the centre of the first is at 0.5, 0.5. Locked members count,
    hidden and deleted Gaussians do not.
    """
    picked = pick(scene, shot, x, y, _is_thing)
    return None if picked is None else picked.point_m


def pick(
    scene: Scene, shot: Shot, x: float, y: float, among: Callable[[Layer | Actor], bool] | None = None
) -> Picked | None:
    """Find the Gaussian that is seen at a pixel, among some of the visible members (None: among all of them).

    It is the one by which, from the eye on, half of what covers the pixel is passed: neither a faint veil before a
    surface nor what shimmers through it. None where nothing covers the pixel.
    """
    members, parts = _shown(scene, shot.time_s, among)
    splats = project(parts, _pixel_camera(shot.camera, x, y))
    rows, weights = _weights(parts, splats)
    if not len(rows) or weights.sum() < _LEAST_ALPHA:
        return None
    row = rows[np.searchsorted(np.cumsum(weights), weights.sum() / 2)]
    number, index = _owner(parts, int(splats.indices[row]))
    point = _surface_point(parts[number], index, shot.camera, x, y)
    return Picked(members[number].key, index, point)


def _is_thing(member: Layer | Actor) -> bool:
    return not (isinstance(member, Layer) and member.kind == "sky")


def _shown(
    scene: Scene, time_s: float, among: Callable[[Layer | Actor], bool] | None
) -> tuple[list[Layer | Actor], list[Part]]:
    members: list[Layer | Actor] = []
    parts: list[Part] = []
    for member in scene.members:
        if member.visible and (among is None or among(member)):
            part = scene.part(member, time_s)
            if part is not None:
                members.append(member)
                parts.append(part)
    return members, parts


def _pixel_camera(camera: Camera, x: float, y: float) -> Camera:
    """Camera of one pixel, with its centre at x, y of the whole picture."""
    cx, cy = camera.cx - x + 0.5, camera.cy - y + 0.5
    return Camera(1, 1, camera.fx, camera.fy, cx, cy, camera.world_to_camera, camera.exposure_s)


def _weights(parts: list[Part], splats: Splats) -> tuple[Int64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
    """Rows of splats that cover the pixel, nearest first, and their blending weights."""
    order = splats.nearest_first().astype(np.int64)
    order = order[_is_drawn(parts, splats.indices[order])]
    shapes = splats.shapes[order].astype(np.float64)
    dx, dy = 0.5 - shapes[:, 0], 0.5 - shapes[:, 1]
    log_alpha = shapes[:, 5] + shapes[:, 3] * dx**2 + shapes[:, 4] * (dy - shapes[:, 2] * dx) ** 2
    alpha = np.where(log_alpha > shapes[:, 6], np.minimum(np.exp(log_alpha), 0.999), 0.0)
    transmittance = np.cumprod(1 - alpha)
    return order, alpha * np.concatenate([[1.0], transmittance[:-1]])[: len(alpha)]


def _is_drawn(parts: list[Part], indices: Int64[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
    drawn = np.ones(len(indices), bool)
    first = 0
    for part in parts:
        own = (indices >= first) & (indices < first + len(part.gaussians))
        if part.left_out is not None:
            drawn[own] = ~part.left_out.flags[indices[own] - first]
        first += len(part.gaussians)
    return drawn


def _owner(parts: list[Part], index: int) -> tuple[int, int]:
    """Which part a Gaussian belongs to that is counted through all of them, and which of its own it is."""
    for number, part in enumerate(parts):
        if index < len(part.gaussians):
            return number, index
        index -= len(part.gaussians)
    raise IndexError(index)


def _surface_point(part: Part, index: int, camera: Camera, x: float, y: float) -> Float64[np.ndarray, "3"]:
    """Where a Gaussian is densest along the line of sight through a pixel: for a flat one, where it is cut."""
    to_object = np.linalg.inv(part.to_world)
    sight = camera.world_to_camera[:3, :3].T @ [(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0]
    eye = to_object[:3, :3] @ camera.position + to_object[:3, 3]
    own = _whitening(part.gaussians, index)
    start, way = own @ (eye - part.gaussians.means[index]), own @ (to_object[:3, :3] @ sight)
    depth = max(float(-(start @ way) / (way @ way)), 0.0)
    return camera.position + depth * sight


def _whitening(gaussians: Gaussians, index: int) -> Float64[np.ndarray, "3 3"]:
    """Matrix that makes a ball of radius 1 of one Gaussian."""
    scales = gaussians.scales[index].astype(np.float64)
    scales = np.maximum(scales, max(1e-3 * scales.max(), 1e-9))
    rotation = matrices_from_quaternions(gaussians.quaternions[index].astype(np.float64))
    return rotation.T / scales[:, None]
