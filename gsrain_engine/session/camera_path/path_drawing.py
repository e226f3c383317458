"""The person's camera path as lines in the picture: the way, its seconds, its keys, and where the camera is now."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from gsrain_engine.render.scene_view import Shot
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.paths.camera_path import CameraPath

from ..document.viewed_document import ViewedDocument
from ..view.projection import NEAR_M, projected_lines, projected_point
from .edits import place_key

_SAMPLES_A_SECOND, _MOST_SAMPLES = 12, 700
_FRUSTUM_PX = 26.0
_MOST_KEYS = 200
"""A path imported frame by frame has thousands: handles for all of them would hide the picture."""


class KeyMark(NamedTuple):
    """A key in the picture."""

    key: int
    handle_px: tuple[float, float]
    frustum_px: Float64[np.ndarray, "m 2 2"]


@dataclass(frozen=True, slots=True, eq=False)
class PathDrawing:
    """Lines as start and end, x and y in pixels of the picture; only what is in front of the camera."""

    way_px: Float64[np.ndarray, "m 2 2"]
    ticks_px: Float64[np.ndarray, "n 2"]
    """Where the camera is at each full second."""
    keys: list[KeyMark]
    now_px: Float64[np.ndarray, "k 2 2"]
    """A small camera where the flight is at the clock's time."""


def path_drawing(session: ViewedDocument, camera: Camera) -> PathDrawing | None:
    """Project the person's path into a picture; None where they have made none."""
    if session.scene.path is None:
        return None
    path = session.path
    way, seconds = _sampled(path)
    step = max(1, -(-len(path.times_s) // _MOST_KEYS))
    keys = [mark for k in range(0, len(path.times_s), step) if (mark := _key_mark(path, k, camera)) is not None]
    t = session.clock.time_s
    return PathDrawing(
        projected_lines(np.stack([way[:-1], way[1:]], axis=1), camera),
        _projected_points(seconds, camera),
        keys,
        _frustum(path.camera(t, 3, 2), camera),
    )


def drag_in_view(session: ViewedDocument, shot: Shot, moved_px: tuple[float, float], *, upright: bool) -> None:
    """Move the key in the hand in the plane that faces the view, or along the world's height only."""
    drag = session.timeline.drag
    if drag is None:
        return
    camera, start = shot.camera, _place(session, drag.path.positions[drag.key])
    depth = float(camera.world_to_camera[2, :3] @ start + camera.world_to_camera[2, 3])
    metres_a_pixel = max(depth, NEAR_M) / camera.fy
    right, down = camera.world_to_camera[0, :3], camera.world_to_camera[1, :3]
    if upright:
        steepness = max(-float(down[2]), 0.2)  # seen from straight above the height has no length in the picture
        change = np.array([0.0, 0.0, -moved_px[1] * metres_a_pixel / steepness])
    else:
        change = metres_a_pixel * (moved_px[0] * right + moved_px[1] * down)
    place_key(session, drag.key, "Move camera key", position_m=start + change, gesture="drag a key")


@lru_cache(maxsize=4)
def _sampled(path: CameraPath) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "s 3"]]:
    """Places along the way, and those of full seconds."""
    count = int(np.clip(_SAMPLES_A_SECOND * path.duration_s, 8 * len(path.times_s), _MOST_SAMPLES))
    end = np.nextafter(path.end_s, -np.inf) if path.loop else path.end_s
    inner = path.times_s if len(path.times_s) <= _MOST_SAMPLES else path.times_s[:0]
    times = np.union1d(np.linspace(path.start_s, end, max(count, 2)), inner)
    seconds = np.arange(np.ceil(path.start_s), min(path.end_s, path.start_s + _MOST_SAMPLES) + 1e-9)
    return path.places(times), path.places(seconds)


def _key_mark(path: CameraPath, key: int, camera: Camera) -> KeyMark | None:
    seen = projected_point(path.positions[key], camera)
    if seen is None:
        return None
    there = path.camera(float(path.times_s[key]), 3, 2)
    return KeyMark(key, (seen.x, seen.y), _frustum(there, camera))


def _frustum(shown: Camera, camera: Camera) -> Float64[np.ndarray, "k 2 2"]:
    """A small pyramid that opens where a camera looks, with a flag at the top; equally large at every distance."""
    pose = shown.camera_to_world
    depth = float(camera.world_to_camera[2, :3] @ pose[:3, 3] + camera.world_to_camera[2, 3])
    if depth < NEAR_M:
        return np.zeros((0, 2, 2))
    size = _FRUSTUM_PX * depth / camera.fy
    w, h = 0.75 * size, 0.5 * size
    eye = np.zeros(3)
    a, b, c, d = (np.array([x, y, size]) for x, y in ((-w, -h), (w, -h), (w, h), (-w, h)))
    flag = np.array([0, -1.7 * h, size])
    left, right = np.array([-0.5 * w, -1.1 * h, size]), np.array([0.5 * w, -1.1 * h, size])
    lines = np.array(
        [[eye, a], [eye, b], [eye, c], [eye, d], [a, b], [b, c], [c, d], [d, a], [left, flag], [flag, right]]
    )
    return projected_lines(lines @ pose[:3, :3].T + pose[:3, 3], camera)


def _projected_points(points: Float64[np.ndarray, "n 3"], camera: Camera) -> Float64[np.ndarray, "m 2"]:
    seen = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    seen = seen[seen[:, 2] > NEAR_M]
    return np.array([camera.fx, camera.fy]) * seen[:, :2] / seen[:, 2:] + np.array([camera.cx, camera.cy])


def _place(session: ViewedDocument, position: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
    to_world = session.scene.scene_to_world
    return to_world[:3, :3] @ position + to_world[:3, 3]
