"""Object labels: label pass, masks, boxes and visibility of layers and actors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import lazy_loader
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt16

from ..scene.camera import Camera
from ..scene.flags import BitMask
from ..scene.geometry import before_camera, box_corners
from ..scene.objects import SceneObject
from ..scene.scene import Actor, DrawItem, Scene, take_gaussians
from .renderer import Renderer

cv2: Any = lazy_loader.load("cv2")  # `gsrain render` imports this module, and seldom exports boxes

_MIN_ALPHA = 0.5  # minimum alpha of a labeled pixel, as for depth


def draw_labels(renderer: Renderer, scene: Scene, camera: Camera, time_s: float) -> UInt16[np.ndarray, "h w"]:
    """Label each pixel with the member of the largest share in its color: 1 is the first member, 0 is nothing.

    Three members at a time are drawn in pure red, green and blue, the others in black: each channel is then a member's
    blending weight. Rain is ignored.
    """
    visible = [
        (number, part)
        for number, member in enumerate(scene.members, start=1)
        if member.visible and (part := scene.part(member, time_s)) is not None
    ]
    labels = np.zeros((camera.height, camera.width), np.uint16)
    largest = np.zeros((camera.height, camera.width), np.float32)
    for first in range(0, len(visible), 3):
        rgba = _drawn(renderer, _in_signal_colors([part for _, part in visible], first), camera)
        for channel, (number, _) in enumerate(visible[first : first + 3]):
            weight = np.where(rgba[..., 3] >= _MIN_ALPHA, rgba[..., channel], np.float32(0))
            labels[weight > largest] = number
            largest = np.maximum(largest, weight)
    return labels


def label_legend(scene: Scene) -> dict[str, Any]:
    """Meaning of a scene's labels as plain values, identical for every frame."""
    return {
        "0": {"name": "", "kind": "nothing"},
        **{
            str(number): {"name": member.name, "kind": "actor", "class": member.class_name}
            if isinstance(member, Actor)
            else {"name": member.name, "kind": member.kind}
            for number, member in enumerate(scene.members, start=1)
        },
    }


def _in_signal_colors(parts: Sequence[DrawItem], first: int) -> list[DrawItem]:
    """Return parts `first`, `first + 1` and `first + 2` in red, green and blue, all others in black."""
    return [part._replace(colors=single_channel_grading(number - first)) for number, part in enumerate(parts)]


def single_channel_grading(channel: int) -> Float64[np.ndarray, "3 4"]:
    """Color matrix that maps every color to one pure channel; black for channels that don't exist."""
    change = np.zeros((3, 4))
    if 0 <= channel < 3:
        change[channel, 3] = 1.0
    return change


# Visible objects

MIN_SHARE = 0.5  # minimum share of a pixel's light that an object needs to own the pixel
_MIN_HEIGHT_PX = 3.0  # minimum height of an object's outline; smaller ones are skipped


BoxXYXY = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels; the left edge of the first column is 0."""


@dataclass(frozen=True, slots=True, eq=False)
class VisibleObject:
    """Object visible in an image."""

    object: SceneObject
    to_camera: Float64[np.ndarray, "4 4"]
    """From its frame (x forward, y left, z up, origin at the bottom center) to the camera's (OpenCV axes), meters."""
    size_lwh_m: tuple[float, float, float]
    mask: Bool[np.ndarray, "h w"]
    visibility: float
    """Ratio of its pixels to its pixels without occlusion; 0..1."""
    truncation: float
    """Share of its box's outline outside the image; 0..1."""

    @property
    def box_xyxy(self) -> BoxXYXY:
        """Bounding box of its pixels, at their outer edges."""
        rows, columns = np.flatnonzero(self.mask.any(axis=1)), np.flatnonzero(self.mask.any(axis=0))
        return float(columns[0]), float(rows[0]), float(columns[-1] + 1), float(rows[-1] + 1)

    @property
    def center_m(self) -> Float64[np.ndarray, "3"]:
        """Center of its 3D box in the camera's frame."""
        return self.to_camera[:3, 3] + self.to_camera[:3, 2] * (self.size_lwh_m[2] / 2)

    @property
    def distance_m(self) -> float:
        return float(np.linalg.norm(self.center_m))


def visible_objects(
    renderer: Renderer, scene: Scene, objects: Sequence[SceneObject], camera: Camera, time_s: float = 0.0
) -> list[VisibleObject]:
    """Find the objects visible to a camera (world, meters) at a time, nearest first.

    Three at a time are drawn in pure red, green and blue and all else in black, so that a channel is an object's share
    of a pixel's light; then each one alone for its occlusion. Objects without pixels are omitted.
    """
    candidates = _in_image(scene, objects, camera, time_s)
    rest, own = _split(scene, candidates, time_s)
    found: list[VisibleObject] = []
    for first in range(0, len(candidates), 3):
        shares = _drawn(renderer, [*rest, *_in_signal_colors(own, first)], camera)
        for channel, candidate in enumerate(candidates[first : first + 3]):
            mask = shares[..., channel] >= MIN_SHARE
            if mask.any():
                alone = _drawn(renderer, _in_signal_colors([own[first + channel]], 0), camera)[..., 0]
                visibility = int(mask.sum()) / max(int((mask | (alone >= MIN_SHARE)).sum()), 1)
                found.append(replace(candidate, mask=mask, visibility=visibility))
    return sorted(found, key=lambda each: each.distance_m)


def _in_image(scene: Scene, objects: Sequence[SceneObject], camera: Camera, time_s: float) -> list[VisibleObject]:
    """Candidates with boxes in the image, without mask and visibility."""
    found: list[VisibleObject] = []
    for each in objects:
        pose = each.track.pose(time_s)
        if pose is None or not len(each.rows):
            continue
        to_camera = camera.world_to_camera @ scene.scene_to_world @ pose
        to_camera[:3, :3] /= scene.metres_per_unit
        length, width, height = (scene.metres_per_unit * side for side in each.size_lwh)
        hull = convex_outline(box_corners(to_camera, (length, width, height)), camera)
        within = cut_at_edges(hull, camera)
        if len(within) and np.ptp(hull[:, 1]) >= _MIN_HEIGHT_PX:
            truncation = min(max(1 - area_px(within) / max(area_px(hull), 1e-9), 0.0), 1.0)
            size, nothing = (length, width, height), np.zeros((0, 0), np.bool_)
            found.append(VisibleObject(each, to_camera, size, nothing, 0.0, truncation))
    return found


def _split(scene: Scene, candidates: Sequence[VisibleObject], time_s: float) -> tuple[list[DrawItem], list[DrawItem]]:
    """Split the scene into the parts that are no object (in black) and one part per object."""
    rest: list[DrawItem] = []
    own: dict[int, DrawItem] = {}
    for member in scene.members:
        part = scene.part(member, time_s) if member.visible else None
        if part is None:
            continue
        is_left_out = np.zeros(len(member.gaussians), bool) if part.left_out is None else part.left_out.flags.copy()
        for number, candidate in enumerate(candidates):
            if candidate.object.member == member.key:
                rows = candidate.object.rows[~is_left_out[candidate.object.rows]]
                gaussians, _ = take_gaussians(member, rows)
                own[number] = DrawItem(gaussians, part.to_world, opacity=part.opacity)
                is_left_out[rows] = True
        rest.append(part._replace(colors=single_channel_grading(-1), left_out=BitMask.of(is_left_out)))
    return rest, [own[number] for number in range(len(candidates))]


def _drawn(renderer: Renderer, parts: Sequence[DrawItem], camera: Camera) -> Float32[np.ndarray, "h w 4"]:
    renderer.draw(parts, camera)
    return renderer.read().rgba


def convex_outline(corners: Float64[np.ndarray, "8 3"], camera: Camera) -> Float64[np.ndarray, "c 2"]:
    """Convex outline of a box in pixels, not clipped to the image; empty if the box is behind the camera."""
    points = before_camera(corners)
    if len(points) < 3:
        return np.zeros((0, 2))
    pixels = points[:, :2] / points[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    return cv2.convexHull(pixels.astype(np.float32))[:, 0].astype(np.float64)


def cut_at_edges(hull: Float64[np.ndarray, "c 2"], camera: Camera) -> Float64[np.ndarray, "d 2"]:
    """Part of a convex outline inside the image; may be empty."""
    if len(hull) < 3:
        return np.zeros((0, 2))
    width, height = camera.width, camera.height
    picture = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    area, common = cv2.intersectConvexConvex(hull.astype(np.float32), picture)
    return common[:, 0].astype(np.float64) if area > 0 else np.zeros((0, 2))


def area_px(polygon: Float64[np.ndarray, "c 2"]) -> float:
    x, y = polygon.T if len(polygon) else np.zeros((2, 1))
    return abs(float(x @ np.roll(y, 1) - y @ np.roll(x, 1))) / 2


def bounding_rectangle(polygon: Float64[np.ndarray, "c 2"]) -> BoxXYXY:
    """Bounding box of at least one point."""
    left, top = polygon.min(axis=0).tolist()
    right, bottom = polygon.max(axis=0).tolist()
    return left, top, right, bottom
