"""Rain regions in the viewport: face handles and drags, outlines, and a view of a region from outside."""

import math
from dataclasses import dataclass
from itertools import product
from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Float64

from ..rain.settings import RainSettings, RegionBox
from ..rain.simulation import RainSimulation
from ..render.view import RenderView, rain_anchor
from ..scene.camera import Camera, look_at
from ..scene.geometry import EDGES
from ..scene.scene import Scene
from .overlays import image_corners
from .viewport.picking import NEAR_M, project_lines, project_point
from .viewport_state import ViewportState

RegionName = Literal["streak_region", "haze_region"]
_END_ON_PX = 8.0
"""A face that moves less than this for a tenth of its distance is end-on: vertical mouse motion drags it."""
_MAX_DISTANCE_M, _MIN_SIZE_M = 200.0, 0.1
_MAX_M3 = {"streak_region": 5_000.0, "haze_region": 1e7}
"""Maximum volumes: streaks are simulated drop by drop, so a huge region would stall the window."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceHandle:
    """A visible face of a region."""

    axis: int
    upper: bool
    point_m: Float64[np.ndarray, "3"]
    """Centroid of the visible part of the face, in the world."""
    normal: Float64[np.ndarray, "3"]
    """Outward, in the world."""

    @property
    def face(self) -> tuple[int, bool]:
        """Axis, and True for its upper side."""
        return self.axis, self.upper


def face_handles(
    box: RegionBox, anchor_to_world: Float64[np.ndarray, "4 4"], camera: Camera, *, inset: float = 0.08
) -> list[FaceHandle]:
    """Handles of the faces at least partly visible; they keep a margin (`inset`, share of the image) from its edges."""
    low, high = np.array(box.minimum_m), np.array(box.maximum_m)
    handles: list[FaceHandle] = []
    for axis, upper in product(range(3), (False, True)):
        middle = _visible_centroid(_corners(low, high, axis, upper), anchor_to_world, camera, inset)
        if middle is not None:
            normal = anchor_to_world[:3, axis] * (1.0 if upper else -1.0)
            handles.append(FaceHandle(axis, upper, middle, normal))
    return handles


@dataclass(frozen=True, slots=True, eq=False)
class BoxFaceDrag:
    """Drag of a face: its initial state and the mapping of the mouse."""

    handle: FaceHandle
    box: RegionBox
    name: RegionName
    camera: Camera
    start_px: tuple[float, float]

    def pulled(self, x: float, y: float) -> RegionBox:
        """Return the region with its face at the mouse, within the limits of its size."""
        axis, distance = self.handle.axis, self._along(x, y) - self._along(*self.start_px)
        low, high = list(self.box.minimum_m), list(self.box.maximum_m)
        others = self.box.volume_m3 / self.box.size_m[axis]
        max_m = _MAX_M3[self.name] / others
        if self.handle.upper:
            end = max(min(_MAX_DISTANCE_M, low[axis] + max_m), high[axis])
            high[axis] = float(np.clip(high[axis] + distance, low[axis] + _MIN_SIZE_M, end))
        else:
            end = min(max(-_MAX_DISTANCE_M, high[axis] - max_m), low[axis])
            low[axis] = float(np.clip(low[axis] - distance, end, high[axis] - _MIN_SIZE_M))
        corners = {"minimum_m": tuple(round(v, 3) for v in low), "maximum_m": tuple(round(v, 3) for v in high)}
        return msgspec.convert(corners, RegionBox)

    @property
    def is_end_on(self) -> bool:
        """True if the face moves along the line of sight, so that vertical mouse motion drags it."""
        here, there = (
            project_point(self.handle.point_m + step * self.handle.normal, self.camera)
            for step in (0.0, self._distance / 10)
        )
        return there is None or here is None or math.hypot(there.x - here.x, there.y - here.y) < _END_ON_PX

    def _along(self, x: float, y: float) -> float:
        """Distance of a pixel along the normal, from the handle."""
        point, normal, camera = self.handle.point_m, self.handle.normal, self.camera
        if self.is_end_on:
            farther = 1.0 if float(normal @ camera.world_to_camera[2, :3]) > 0 else -1.0
            return -2.0 * farther * self._distance * y / camera.height
        sight = np.array([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0])
        sight = camera.world_to_camera[:3, :3].T @ sight
        sight /= np.linalg.norm(sight)
        across = sight - float(sight @ normal) * normal
        return float((camera.position - point) @ (normal - float(sight @ normal) / float(across @ across) * across))

    @property
    def _distance(self) -> float:
        return max(float(np.linalg.norm(self.handle.point_m - self.camera.position)), 0.5)


def _corners(
    low: Float64[np.ndarray, "3"], high: Float64[np.ndarray, "3"], axis: int, upper: bool
) -> Float64[np.ndarray, "4 3"]:
    """Corners of a face in order around it."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    corners = np.empty((4, 3))
    corners[:, axis] = (high if upper else low)[axis]
    corners[:, u] = [low[u], high[u], high[u], low[u]]
    corners[:, v] = [low[v], low[v], high[v], high[v]]
    return corners


def _visible_centroid(
    corners_m: Float64[np.ndarray, "4 3"], anchor_to_world: Float64[np.ndarray, "4 4"], camera: Camera, inset: float
) -> Float64[np.ndarray, "3"] | None:
    """Centroid of the visible part of a face, in the world; None if nothing is visible."""
    to_camera = camera.world_to_camera @ anchor_to_world
    part = corners_m @ to_camera[:3, :3].T + to_camera[:3, 3]
    x, y, wide, high = camera.cx, camera.cy, camera.width, camera.height
    left, right = (inset * wide - x) / camera.fx, ((1 - inset) * wide - x) / camera.fx
    top, bottom = (inset * high - y) / camera.fy, ((1 - inset) * high - y) / camera.fy
    planes = ((0, 0, 1, -NEAR_M), (1, 0, -left, 0), (-1, 0, right, 0), (0, 1, -top, 0), (0, -1, bottom, 0))
    for plane in planes:
        part = _cut(part, np.array(plane, np.float64))
        if len(part) < 3:
            return None
    triangles = np.stack([np.broadcast_to(part[0], part[1:-1].shape), part[1:-1], part[2:]], axis=1)
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    centroid = (triangles.mean(axis=1) * areas[:, None]).sum(axis=0) / max(float(areas.sum()), 1e-12)
    to_world = np.linalg.inv(camera.world_to_camera)
    return to_world[:3, :3] @ centroid + to_world[:3, 3]


def _cut(polygon: Float64[np.ndarray, "n 3"], plane: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "m 3"]:
    """Clip a polygon to the positive side of a plane (Sutherland and Hodgman, 1974)."""
    side = polygon @ plane[:3] + plane[3]
    corners: list[Float64[np.ndarray, 3]] = []
    for k in range(len(polygon)):
        here, there = polygon[k - 1], polygon[k]
        a, b = float(side[k - 1]), float(side[k])
        if (a > 0) != (b > 0):
            corners.append(here + a / (a - b) * (there - here))
        if b > 0:
            corners.append(there)
    return np.array(corners).reshape(-1, 3)


# View of a region from outside
# Cameras are inside of their regions, so that most faces are out of sight.

_FROM = np.array([-0.75, 0.8, 0.62])  # from behind, left and above: x runs to the upper right, y to the upper left
_FOV_DEG = 24.0
_FILLED = 0.74  # share of the image height that the region fills


def inset_view(box: RegionBox, anchor_to_world: Float64[np.ndarray, "4 4"], width: int, height: int) -> RenderView:
    """View of a whole region from outside."""
    turn = anchor_to_world[:3, :3]
    middle = turn @ np.array(box.center_m) + anchor_to_world[:3, 3]
    direction = turn @ (_FROM / np.linalg.norm(_FROM))
    pose = look_at(middle + direction, middle, np.array([0.0, 0.0, 1.0]))
    corners = np.array(list(product((-0.5, 0.5), repeat=3))) * np.array(box.size_m)
    x, y, z = (corners @ turn.T @ pose[:3, :3].T).T
    high = np.tan(np.radians(_FOV_DEG) / 2) * _FILLED
    away = float(np.max(np.maximum(np.abs(x) * height / width, np.abs(y)) / high - z))
    pose = look_at(middle + away * direction, middle, np.array([0.0, 0.0, 1.0]))
    return RenderView(Camera.from_fov(width, height, _FOV_DEG, pose))


def frustum_lines(camera: Camera, length_m: float) -> Float64[np.ndarray, "8 2 3"]:
    """Edges of a camera's frustum up to a depth, as lines in the world."""
    corners = image_corners(camera, length_m)
    eye = np.broadcast_to(camera.position, (4, 3))
    return np.concatenate([np.stack([eye, corners], axis=1), np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)])


# Outlines


def region_box(rain: RainSettings, name: RegionName) -> RegionBox:
    """Return a region; for haze without one, the box of the paper's Gaussians."""
    return rain.streak_region if name == "streak_region" else rain.haze_box


def region_outlines(
    viewport: ViewportState, scene: Scene, rainfall: RainSimulation, width: int, height: int
) -> dict[str, Float64[np.ndarray, "m 2 2"]]:
    """Edges of the regions that the view options show in a scene and its rain, by name; see `project_edges`."""
    boxes: dict[str, RegionBox] = {}
    if viewport.options.show_streak_region:
        boxes["streak region"] = viewport.document.rain.streak_region
    if viewport.options.show_haze_region:
        boxes["haze region"] = viewport.document.rain.haze_box
    shot = viewport.canvas_view(width, height)
    anchor = rain_anchor(scene, rainfall, shot)
    return {name: project_edges(box, anchor, shot.camera) for name, box in boxes.items()}


def project_edges(
    box: RegionBox, anchor_to_world: Float64[np.ndarray, "4 4"], camera: Camera
) -> Float64[np.ndarray, "m 2 2"]:
    """Start and end of the twelve edges of a box, as x, y in image pixels, clipped at the near plane."""
    corners = np.array(list(product(*zip(box.minimum_m, box.maximum_m, strict=True))))
    in_world = corners @ anchor_to_world[:3, :3].T + anchor_to_world[:3, 3]
    return project_lines(in_world[EDGES], camera)
