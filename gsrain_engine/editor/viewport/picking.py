"""Picking of Gaussians and surface points, projection of points and lines, gizmo matrices, and sky color picks."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from ...rain.simulation import mean_linear_color
from ...render.cpu.projection import project
from ...render.cpu.splats import Splats
from ...render.renderer import Color, Renderer
from ...render.view import RenderView
from ...scene.camera import Camera
from ...scene.geometry import matrices_from_quaternions
from ...scene.scene import Actor, DrawItem, Layer, Scene

_MIN_ALPHA = 0.1  # minimum coverage of a pixel that can be picked


class PickResult(NamedTuple):
    """Result of picking a pixel."""

    key: str
    """Key of the member that was hit."""
    gaussian: int
    """Index of the Gaussian in the member."""
    point_m: Float64[np.ndarray, "3"]
    """Intersection of the line of sight with its surface, in the world."""


def pick_point(scene: Scene, shot: RenderView, x: float, y: float) -> Float64[np.ndarray, "3"] | None:
    """Return the world point (meters) visible at a pixel; None for sky or nothing.

    Pixels count from the image's upper left corner; the center of the first is at 0.5, 0.5. Includes locked members,
    excludes hidden and deleted Gaussians.
    """
    picked = pick(scene, shot, x, y, lambda each: not (isinstance(each, Layer) and each.kind == "sky"))
    return None if picked is None else picked.point_m


def pick(
    scene: Scene, shot: RenderView, x: float, y: float, among: Callable[[Layer | Actor], bool] | None = None
) -> PickResult | None:
    """Find the Gaussian visible at a pixel, among some of the visible members (None: all).

    It is the one at which half of the pixel's coverage is reached from the camera: neither a faint veil before a
    surface nor something shining through it. None if nothing covers the pixel.
    """
    members = [each for each in scene.members if each.visible and (among is None or among(each))]
    owned = [(each.key, part) for each in members if (part := scene.part(each, shot.time_s)) is not None]
    parts, camera = [part for _, part in owned], shot.camera
    pixel = replace(camera, width=1, height=1, cx=camera.cx - x + 0.5, cy=camera.cy - y + 0.5, rolling=None)
    splats = project(parts, pixel)
    rows, weights = _weights(parts, splats)
    if not len(rows) or weights.sum() < _MIN_ALPHA:
        return None
    row = rows[np.searchsorted(np.cumsum(weights), weights.sum() / 2)]
    index = int(splats.indices[row])  # counted through all parts
    for key, part in owned:
        if index < len(part.gaussians):
            return PickResult(key, index, _surface_point(part, index, camera, x, y))
        index -= len(part.gaussians)
    raise IndexError(index)


def _weights(parts: list[DrawItem], splats: Splats) -> tuple[Int64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
    """Rows of splats that cover the pixel, nearest first, and their blending weights."""
    order = splats.nearest_first().astype(np.int64)
    drawn = [np.ones(len(each.gaussians), bool) if each.left_out is None else ~each.left_out.flags for each in parts]
    order = order[np.concatenate([*drawn, np.zeros(0, bool)])[splats.indices[order]]]
    shapes = splats.shapes[order].astype(np.float64)
    dx, dy = 0.5 - shapes[:, 0], 0.5 - shapes[:, 1]
    log_alpha = shapes[:, 5] + shapes[:, 3] * dx**2 + shapes[:, 4] * (dy - shapes[:, 2] * dx) ** 2
    alpha = np.where(log_alpha > shapes[:, 6], np.minimum(np.exp(log_alpha), 0.999), 0.0)
    transmittance = np.cumprod(1 - alpha)
    return order, alpha * np.concatenate([[1.0], transmittance[:-1]])[: len(alpha)]


def _surface_point(part: DrawItem, index: int, camera: Camera, x: float, y: float) -> Float64[np.ndarray, "3"]:
    """Point of maximum density of a Gaussian along a pixel's line of sight; for a flat one, the intersection."""
    to_object, gaussians = np.linalg.inv(part.to_world), part.gaussians
    sight = camera.world_to_camera[:3, :3].T @ _sight(camera, x, y)
    eye = to_object[:3, :3] @ camera.position + to_object[:3, 3]
    scales = gaussians.scales[index].astype(np.float64)
    scales = np.maximum(scales, max(1e-3 * scales.max(), 1e-9))
    rotation = matrices_from_quaternions(gaussians.quaternions[index].astype(np.float64))
    to_sphere = rotation.T / scales[:, None]  # maps the Gaussian to the unit sphere
    start, along = to_sphere @ (eye - gaussians.means[index]), to_sphere @ (to_object[:3, :3] @ sight)
    depth = max(float(-(start @ along) / (along @ along)), 0.0)
    return camera.position + depth * sight


def _sight(camera: Camera, x: float, y: float) -> Float64[np.ndarray, "3"]:
    """Direction of a pixel in the camera's frame."""
    if camera.lens is None:
        return np.array([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0])
    return np.nan_to_num(camera.directions(np.array([[x, y]]))[0])


NEAR_M = 0.05


class ProjectedPoint(NamedTuple):
    """A point in image pixels, with its depth."""

    x: float
    y: float
    depth_m: float


def project_point(point: Float64[np.ndarray, "3"], camera: Camera) -> ProjectedPoint | None:
    """Project a world point (meters) to pixels; None if nearer than the near plane."""
    x, y, z = (camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]).tolist()
    return ProjectedPoint(camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, z) if z > NEAR_M else None


def project_lines(lines: Float64[np.ndarray, "n 2 3"], camera: Camera) -> Float64[np.ndarray, "m 2 2"]:
    """Project world lines (meters) to pixels, clipped at the near plane."""
    ends = in_camera(lines, camera)
    ends = ends[(ends[..., 2] > NEAR_M).any(axis=1)]
    start, end = ends[:, 0], ends[:, 1]
    behind = ends[..., 2] < NEAR_M
    rise = np.where(behind.any(axis=1), end[:, 2] - start[:, 2], 1.0)
    crossing = start + ((NEAR_M - start[:, 2]) / rise)[:, None] * (end - start)
    return to_pixels(np.where(behind[..., None], crossing[:, None], ends), camera)


def in_camera(points: Float64[np.ndarray, "*n 3"], camera: Camera) -> Float64[np.ndarray, "*n 3"]:
    """Points of the world in the frame of a camera, meters."""
    return points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]


def to_pixels(points: Float64[np.ndarray, "*n 3"], camera: Camera) -> Float64[np.ndarray, "*n 2"]:
    """Project points in the frame of the camera."""
    return np.array([camera.fx, camera.fy]) * points[..., :2] / points[..., 2:] + np.array([camera.cx, camera.cy])


# Gizmo matrices (4x4, column-major)

Handle = Literal["translate", "rotate", "scale"]
_FAR_M = 5000.0


def opengl_projection(camera: Camera) -> list[float]:
    """Eye to OpenGL clip space, with the camera's focal lengths and center."""
    near, far = NEAR_M + 0.5 * camera.plane_m, _FAR_M + 2 * camera.plane_m
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[0, 2] = 2 * camera.fx / camera.width, 1 - 2 * camera.cx / camera.width
    matrix[1, 1], matrix[1, 2] = 2 * camera.fy / camera.height, 2 * camera.cy / camera.height - 1
    matrix[2, 2] = -(far + near) / (far - near)
    matrix[2, 3] = -2 * far * near / (far - near)
    matrix[3, 2] = -1
    return column_major(matrix)


def column_major(matrix: Float64[np.ndarray, "4 4"]) -> list[float]:
    return matrix.T.ravel().tolist()


def frame_at(point_m: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "4 4"]:
    """Frame at a point of the world, with the world's axes."""
    frame = np.eye(4)
    frame[:3, 3] = point_m
    return frame


def gizmo_delta(
    handle: Handle, start: Float64[np.ndarray, "4 4"], now: Float64[np.ndarray, "4 4"]
) -> Float64[np.ndarray, "4 4"]:
    """Similarity of the world by which a handle moved a gizmo's frame from `start` to `now`.

    A gizmo computes in single precision and scales each axis separately. Removes components that the handle does not
    represent; the largest scale of an axis applies to all three, around the gizmo's position.
    """
    delta = np.eye(4)
    if handle == "translate":
        return frame_at(now[:3, 3] - start[:3, 3])
    change = now[:3, :3] @ np.linalg.inv(start[:3, :3])
    if handle == "scale":
        factors = np.clip(np.linalg.norm(change, axis=0), 1e-3, 1e3)
        delta[:3, :3] *= factors[np.argmax(np.abs(np.log(factors)))]
    else:
        u, _, v = np.linalg.svd(change)  # nearest rotation
        delta[:3, :3] = u @ v
    return frame_at(start[:3, 3]) @ delta @ frame_at(-start[:3, 3])


@dataclass(frozen=True, slots=True)
class SkyColorPick:
    """Rectangle for the color of drops if no sky is found, in shares of the image from its upper left corner."""

    left: float
    top: float
    right: float
    bottom: float

    @classmethod
    def between(cls, a: tuple[float, float], b: tuple[float, float]) -> "SkyColorPick":
        """Span two corners, clipped to the image."""
        (left, right), (top, bottom) = (sorted(np.clip(pair, 0.0, 1.0).tolist()) for pair in zip(a, b, strict=True))
        return cls(left, top, right, bottom)


def mean_color_in_rectangle(
    renderer: Renderer,
    scene: Scene,
    shot: RenderView,
    pick: SkyColorPick,
    background: Color,
    wetness: float = 0.0,
    overcast: float | None = None,
) -> Color:
    """Render a scene without rain and average a rectangle of at least one pixel in linear light."""
    renderer.draw(scene.parts(shot.time_s, wetness=wetness, overcast=overcast), shot.camera)
    rgba = renderer.read().rgba
    height, width = rgba.shape[:2]
    x0, x1 = _pixels(pick.left, pick.right, width)
    y0, y1 = _pixels(pick.top, pick.bottom, height)
    pixels = rgba[y0:y1, x0:x1].reshape(-1, 4).astype(np.float64)
    return mean_linear_color(np.clip(pixels[:, :3] + (1 - pixels[:, 3:]) * np.array(background), 0, 1))


def _pixels(low: float, high: float, count: int) -> tuple[int, int]:
    first = min(int(low * count), count - 1)
    return first, max(first + 1, min(round(high * count), count))
