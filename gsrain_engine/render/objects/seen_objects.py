"""The objects that a picture shows: each one's pixels, its boxes, and how much of it stands free.

Rain takes no part: what a picture shows is the same in any weather.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64

from gsrain_engine.scene.box_corners import box_corners
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import Part, rows_of
from gsrain_engine.scene.objects import SceneObject
from gsrain_engine.scene.scene import Scene

from ..labels import only_channel
from ..renderer import Renderer
from .box_outline import BoxXYXY, area_px, bounds, cut_at_edges, outline

LEAST_SHARE = 0.5
"""A pixel shows an object where at least this share of its light comes from it."""
_LEAST_HEIGHT_PX = 3.0
"""What a whole object is lower than is not looked for."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenObject:
    """An object in a picture."""

    object: SceneObject
    to_camera: Float64[np.ndarray, "4 4"]
    """From its frame (x forward, y left, z up, origin at the bottom centre) to the camera's (OpenCV axes), metres."""
    size_lwh_m: tuple[float, float, float]
    mask: Bool[np.ndarray, "h w"]
    """Pixels that show it."""
    visibility: float
    """Its pixels over those that it would have if nothing stood in front of it; 0..1."""
    truncation: float
    """Share of its box's outline that lies outside the picture; 0..1."""
    outline_xyxy: BoxXYXY
    """Box around its projected 3D box, cut at the picture's edges."""

    @property
    def box_xyxy(self) -> BoxXYXY:
        """Box around its pixels; their outer edges."""
        rows, columns = np.flatnonzero(self.mask.any(axis=1)), np.flatnonzero(self.mask.any(axis=0))
        return float(columns[0]), float(rows[0]), float(columns[-1] + 1), float(rows[-1] + 1)

    @property
    def center_m(self) -> Float64[np.ndarray, "3"]:
        """Middle of its 3D box in the camera's frame."""
        return self.to_camera[:3, 3] + self.to_camera[:3, 2] * (self.size_lwh_m[2] / 2)

    @property
    def distance_m(self) -> float:
        return float(np.linalg.norm(self.center_m))


class _Candidate(NamedTuple):
    object: SceneObject
    to_camera: Float64[np.ndarray, "4 4"]
    size_lwh_m: tuple[float, float, float]
    truncation: float
    outline_xyxy: BoxXYXY


def seen_objects(
    renderer: Renderer, scene: Scene, objects: Sequence[SceneObject], camera: Camera, time_s: float = 0.0
) -> list[SeenObject]:
    """Find which objects of a scene a camera (world, metres) sees at a time, the nearest first.

    Three at a time are drawn in pure red, green and blue and all else in black, so that a channel is an object's share
    of a pixel's light; then each one alone. Objects without a pixel of their own are left out.
    """
    candidates = _in_picture(scene, objects, camera, time_s)
    rest, own = _split(scene, candidates, time_s)
    seen: list[SeenObject] = []
    for first in range(0, len(candidates), 3):
        signals = [part._replace(colors=only_channel(number - first)) for number, part in enumerate(own)]
        shares = _drawn(renderer, [*rest, *signals], camera)
        for channel, candidate in enumerate(candidates[first : first + 3]):
            mask = shares[..., channel] >= LEAST_SHARE
            if mask.any():
                alone = _drawn(renderer, [own[first + channel]._replace(colors=only_channel(0))], camera)[..., 0]
                visibility = int(mask.sum()) / max(int((mask | (alone >= LEAST_SHARE)).sum()), 1)
                to_camera, size, truncation, box = candidate[1:]
                seen.append(SeenObject(candidate.object, to_camera, size, mask, visibility, truncation, box))
    return sorted(seen, key=lambda each: each.distance_m)


def _in_picture(scene: Scene, objects: Sequence[SceneObject], camera: Camera, time_s: float) -> list[_Candidate]:
    found: list[_Candidate] = []
    for each in objects:
        pose = each.track.pose(time_s)
        if pose is None or not len(each.rows):
            continue
        to_camera = camera.world_to_camera @ scene.scene_to_world @ pose
        to_camera[:3, :3] /= scene.metres_per_unit
        length, width, height = (scene.metres_per_unit * side for side in each.size_lwh)
        hull = outline(box_corners(to_camera, (length, width, height)), camera)
        within = cut_at_edges(hull, camera)
        if len(within) and np.ptp(hull[:, 1]) >= _LEAST_HEIGHT_PX:
            truncation = min(max(1 - area_px(within) / max(area_px(hull), 1e-9), 0.0), 1.0)
            found.append(_Candidate(each, to_camera, (length, width, height), truncation, bounds(within)))
    return found


def _split(scene: Scene, candidates: Sequence[_Candidate], time_s: float) -> tuple[list[Part], list[Part]]:
    """What is drawn, as the parts that are no object (in black) and one part for each object."""
    rest: list[Part] = []
    own: dict[int, Part] = {}
    for member in scene.members:
        part = scene.part(member, time_s) if member.visible else None
        if part is None:
            continue
        taken = np.zeros(len(member.gaussians), bool) if part.left_out is None else part.left_out.flags.copy()
        for number, candidate in enumerate(candidates):
            if candidate.object.member == member.key:
                rows = candidate.object.rows[~taken[candidate.object.rows]]
                gaussians, _ = rows_of(member, rows)
                own[number] = Part(gaussians, part.to_world, opacity=part.opacity)
                taken[rows] = True
        rest.append(part._replace(colors=only_channel(-1), left_out=Mask.of(taken)))
    return rest, [own[number] for number in range(len(candidates))]


def _drawn(renderer: Renderer, parts: Sequence[Part], camera: Camera) -> Float32[np.ndarray, "h w 4"]:
    renderer.draw(parts, camera)
    return renderer.read().rgba
