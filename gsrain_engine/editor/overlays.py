"""Viewport overlays: selected centers, the camera path with its keyframes, and the frustums of captured cameras."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from ..datasets.capture import Capture
from ..scene.camera import Camera
from ..scene.camera_path import CameraPath
from ..scene.gaussians import scene_cache
from ..scene.scene import Scene
from .viewport.picking import NEAR_M, in_camera, project_lines, project_point, to_pixels
from .viewport_state import ViewportState, selected_items

_SAMPLES_A_SECOND, _MAX_SAMPLES = 12, 700
_FRUSTUM_PX = 26.0
_MAX_KEYS = 200  # maximum number of drawn keyframes: a path imported frame by frame has thousands


class KeyHandle(NamedTuple):
    """A keyframe in the image."""

    key: int
    handle_px: tuple[float, float]
    frustum_px: Float64[np.ndarray, "m 2 2"]


@dataclass(frozen=True, slots=True, eq=False)
class PathOverlay:
    """Lines as start and end, x and y in image pixels; only the parts in front of the camera."""

    path_px: Float64[np.ndarray, "m 2 2"]
    ticks_px: Float64[np.ndarray, "n 2"]
    """Positions of the camera at full seconds."""
    keys: list[KeyHandle]
    now_px: Float64[np.ndarray, "k 2 2"]
    """Frustum of the path's camera at the clock's time."""


def path_overlay_of(viewport: ViewportState, camera: Camera) -> PathOverlay | None:
    """Project the user's path into an image; None if there is none."""
    if viewport.document.scene.path is None:
        return None
    path = viewport.path
    positions, at_seconds = _sampled(path)
    keys: list[KeyHandle] = []
    for key in range(0, len(path.times_s), max(1, -(-len(path.times_s) // _MAX_KEYS))):
        if (handle := project_point(path.positions[key], camera)) is not None:
            frustum = _frustum(path.camera(float(path.times_s[key]), 3, 2), camera)
            keys.append(KeyHandle(key, (handle.x, handle.y), frustum))
    ticks = in_camera(at_seconds, camera)
    return PathOverlay(
        project_lines(np.stack([positions[:-1], positions[1:]], axis=1), camera),
        to_pixels(ticks[ticks[:, 2] > NEAR_M], camera),
        keys,
        _frustum(path.camera(viewport.playback.clock.time_s, 3, 2), camera),
    )


@lru_cache(maxsize=4)
def _sampled(path: CameraPath) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "s 3"]]:
    """Positions along the path, and those at full seconds."""
    count = int(np.clip(_SAMPLES_A_SECOND * path.duration_s, 8 * len(path.times_s), _MAX_SAMPLES))
    end = np.nextafter(path.end_s, -np.inf) if path.loop else path.end_s
    inner = path.times_s if len(path.times_s) <= _MAX_SAMPLES else path.times_s[:0]
    times = np.union1d(np.linspace(path.start_s, end, max(count, 2)), inner)
    seconds = np.arange(np.ceil(path.start_s), min(path.end_s, path.start_s + _MAX_SAMPLES) + 1e-9)
    return path.places(times), path.places(seconds)


def _frustum(shown: Camera, camera: Camera) -> Float64[np.ndarray, "k 2 2"]:
    """A small frustum with a flag at the top, of the same size in pixels at every distance."""
    pose = shown.camera_to_world
    depth = float(camera.world_to_camera[2, :3] @ pose[:3, 3] + camera.world_to_camera[2, 3])
    if depth < NEAR_M:
        return np.zeros((0, 2, 2))
    size = _FRUSTUM_PX * depth / camera.fy
    w, h = 0.75 * size, 0.5 * size
    corners = ((-w, -h), (w, -h), (w, h), (-w, h), (0, -1.7 * h), (-0.5 * w, -1.1 * h), (0.5 * w, -1.1 * h))
    eye, (a, b, c, d, flag, left, right) = [0, 0, 0], [[x, y, size] for x, y in corners]
    ends = [[eye, a], [eye, b], [eye, c], [eye, d], [a, b], [b, c], [c, d], [d, a], [left, flag], [flag, right]]
    lines = np.array(ends, np.float64)
    return project_lines(lines @ pose[:3, :3].T + pose[:3, 3], camera)


# Frustums of captured cameras and the corners of their images

MAX_FRUSTUMS = 100  # of those drawn, nearest first: more would hide the scene
_NEAR = 1e-6
_TIP = 0.5
"""Minimum distance as a share of a frustum's length: from nearer, its image covers two thirds of the view or more."""


class Frustum(NamedTuple):
    """A captured camera in the image."""

    view: int
    eye_px: tuple[float, float] | None
    """Projected camera center; None if it is not visible."""
    lines_px: Float64[np.ndarray, "m 2 2"]


class RecordedCameras:
    """World positions and corner rays of the cameras of all views, computed once for all frames."""

    def __init__(self, cameras: Iterable[Camera]) -> None:
        self._cameras = tuple(cameras)
        self.eyes: Float64[np.ndarray, "n 3"] = np.array([each.position for each in self._cameras]).reshape(-1, 3)
        corners = [image_corners(each, 1.0) - each.position for each in self._cameras]
        self.rays: Float64[np.ndarray, "n 4 3"] = np.array(corners).reshape(-1, 4, 3)
        """From the camera center to the image corners on a plane 1 m in front of it."""

    def __len__(self) -> int:
        return len(self._cameras)

    def __getitem__(self, view: int) -> Camera:
        return self._cameras[view]


def frustums(cameras: RecordedCameras, views: Sequence[int], length_m: float, camera: Camera) -> list[Frustum]:
    """Project the frustums nearest to the camera, the farthest of them first.

    Omits frustums around the camera itself: their images would hide the scene.
    """
    chosen = np.asarray(views, np.int64)
    distances = np.linalg.norm(cameras.eyes[chosen] - camera.position, axis=1)
    is_apart = distances > _TIP * length_m
    chosen, distances = chosen[is_apart], distances[is_apart]
    nearest = chosen[np.argsort(distances, kind="stable")[:MAX_FRUSTUMS][::-1]]
    if not len(nearest):
        return []
    eyes = cameras.eyes[nearest]
    corners = eyes[:, None] + length_m * cameras.rays[nearest]
    rays = np.stack([np.broadcast_to(eyes[:, None], corners.shape), corners], axis=2)
    far = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)
    lines = np.concatenate([rays, far], axis=1)  # (frustums, 8 lines, 2 ends, 3)
    depth = lines @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
    counts = (depth > NEAR_M).any(axis=2).sum(axis=1)
    drawn = np.split(project_lines(lines.reshape(-1, 2, 3), camera), np.cumsum(counts)[:-1])
    return [
        Frustum(int(view), eye and (eye.x, eye.y), own)
        for view, eye, own in zip(nearest, (project_point(each, camera) for each in eyes), drawn, strict=True)
        if len(own)
    ]


def image_corners(camera: Camera, length_m: float) -> Float64[np.ndarray, "4 3"]:
    """World positions of the image corners on a plane at a distance from the camera, clockwise from top left."""
    w, h = camera.width, camera.height
    return _on_plane(camera, length_m, np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float64))


def image_grid(
    shown: Camera, length_m: float, camera: Camera, cells: tuple[int, int]
) -> Float64[np.ndarray, "rows columns 2"] | None:
    """Project a grid over a captured image (cells across and down) into the view, in pixels; None if behind the camera.

    From the captured camera itself, the result does not depend on `length_m`.
    """
    columns, rows = np.meshgrid(np.linspace(0, shown.width, cells[0] + 1), np.linspace(0, shown.height, cells[1] + 1))
    points = _on_plane(shown, length_m, np.stack([columns.ravel(), rows.ravel()], axis=1))
    points = in_camera(points, camera)
    if points[:, 2].min() < max(0.02 * length_m, _NEAR):
        return None
    return to_pixels(points, camera).reshape(*columns.shape, 2)


def fov_to_fit_deg(shown: Camera, aspect: float) -> float:
    """Vertical field of view of a viewport (aspect: width over height) in which a whole captured image fits."""
    upward = max(shown.cy, shown.height - shown.cy) / shown.fy
    sideways = max(shown.cx, shown.width - shown.cx) / shown.fx
    return float(np.degrees(2 * np.arctan(max(upward, sideways / aspect))))


def frustum_length(capture: Capture) -> float:
    """Choose a frustum length, in the capture's units, that shows directions and seldom overlaps."""
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


# Selected Gaussians of which a tint shows nothing

_FAINT = 0.3  # opacity below which a tint hardly shows
_SMALL_PX = 1.0  # longest standard deviation in pixels below which one hardly shows
_MAX_CENTERS = 1500


def hardly_visible_selection(scene: Scene, time_s: float, camera: Camera) -> Float64[np.ndarray, "n 2"]:
    """Pixels of the centers of selected Gaussians that are too faint or small to be seen tinted; a sample of many."""
    means, sizes_m = _selected_samples(scene, time_s if scene.actors else 0.0)
    places = in_camera(means, camera)
    there = places[:, 2] > NEAR_M
    pixels, sizes_px = to_pixels(places[there], camera), sizes_m[there] * camera.fx / places[there, 2]
    inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=1)
    return pixels[inside & (sizes_px < _SMALL_PX)]


@scene_cache(maxsize=2)
def _selected_samples(scene: Scene, time_s: float) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, " n"]]:
    """World positions and sizes (m) of selected Gaussians, faint ones with size 0: those first, then others."""
    means, sizes = [np.zeros((0, 3))], [np.zeros(0)]
    for item in selected_items(scene, time_s):
        gaussians = item.remaining
        scale = float(np.cbrt(np.linalg.det(item.to_world[:3, :3])))
        faint = gaussians.opacities * item.opacity < _FAINT
        means.append(gaussians.means @ item.to_world[:3, :3].T + item.to_world[:3, 3])
        sizes.append(np.where(faint, 0.0, scale * gaussians.scales.max(axis=1, initial=0)))
    all_means, all_sizes = np.concatenate(means), np.concatenate(sizes)
    is_faint = all_sizes == 0
    chosen = np.concatenate([_sample(np.flatnonzero(is_faint)), _sample(np.flatnonzero(~is_faint))])
    return all_means[chosen], all_sizes[chosen]


def _sample(rows: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " m"]:
    return rows[:: -(-len(rows) // _MAX_CENTERS) or 1]
