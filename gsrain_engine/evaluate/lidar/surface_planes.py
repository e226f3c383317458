"""Where rays meet a scene's surfaces: each flat Gaussian is a piece of a plane, and half of a ray's light ends at one.

Blended depth of splats' centres lies in front of a road that is seen at a grazing angle, and between two things where
it mixes them. So the ray is followed through the splats to where less than half of it is left (median depth), and met
with the planes of the splats around there, n . x = d (as Chen et al. 2024, PGSR, take depth), which has pieces of one
plane give that plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from gsrain_engine.raster.projection import project
from gsrain_engine.raster.tiles import TILE, bin_into_tiles
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.members import Layer, Part
from gsrain_engine.scene.rotations import matrices_from_quaternions
from gsrain_engine.scene.scene import Scene

_FLAT = 0.35
"""A Gaussian is flat if its shortest axis is less than this share of the next; a round one faces the eye."""

_FARTHEST_OFF = 0.5
"""A plane that a ray meets so far from the splat's centre, as a share of the depth, is not met where the splat is."""

_SAME_SHARE, _SAME_M = 0.03, 0.05
"""Splats that a ray meets within this of the median are pieces of the same surface."""


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """What can be seen of a scene at a time: its parts, and which of their Gaussians are sky."""

    parts: tuple[Part, ...]
    is_sky: Bool[np.ndarray, " n"]

    @classmethod
    def of(cls, scene: Scene, time_s: float) -> "Surfaces":
        members = [(each, scene.part(each, time_s)) for each in scene.members if each.visible]
        shown = [(member, part) for member, part in members if part is not None]
        sky = [np.full(len(p.gaussians), isinstance(m, Layer) and m.kind == "sky") for m, p in shown]
        return cls(tuple(part for _, part in shown), np.concatenate([np.zeros(0, np.bool_), *sky]))

    def met_by(
        self, directions: Float64[np.ndarray, "n 3"], camera: Camera
    ) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, "n 3"]]:
        """Ranges in metres (infinite where there is nothing) and world normals that face the eye.

        Unit `directions` in the world start in the camera and lie in its picture, whose size of pixels is how sharply
        the Gaussians are seen.
        """
        splats = project(self.parts, camera)
        tiles = bin_into_tiles(splats.shapes, splats.nearest_first(), camera.width, camera.height)
        turn = camera.world_to_camera[:3, :3]
        own = directions @ turn.T
        rays = own / own[:, 2:]
        planes = np.column_stack([_planes(self.parts, splats.indices, camera), splats.colors[:, 3]])
        places = np.stack([camera.cx + camera.fx * rays[:, 0], camera.cy + camera.fy * rays[:, 1]], axis=1)
        found = np.zeros((len(rays), 4))
        is_sky = self.is_sky[splats.indices]
        _meet(splats.shapes, tiles.starts, tiles.members, tiles.columns, planes, is_sky, rays, places, found)
        there = found[:, 0] > 0
        return np.where(there, found[:, 0] / own[:, 2], np.inf), found[:, 1:] @ turn


@numba.njit(parallel=True, cache=True)
@no_type_check
def _meet(shapes, starts, members, columns, planes, is_sky, rays, places, found):
    """Write depth along the view axis, 0 where there is nothing, and the unit normal of what each ray meets."""
    for i in numba.prange(len(rays)):
        u, v, ray = places[i, 0], places[i, 1], rays[i]
        tile = int(v) // TILE * columns + int(u) // TILE
        left, hit = 1.0, -1
        for k in range(starts[tile], starts[tile + 1]):
            left *= 1 - _alpha(shapes[members[k]], u, v)
            if left < 0.5:
                hit = members[k]
                break
        if hit < 0 or is_sky[hit]:
            continue
        median = _depth(planes[hit], ray)
        left, weight, depth = 1.0, 0.0, 0.0
        normal = np.zeros(3)
        for k in range(starts[tile], starts[tile + 1]):
            m = members[k]
            alpha = _alpha(shapes[m], u, v)
            if alpha == 0 or is_sky[m]:
                continue
            own = _depth(planes[m], ray)
            if abs(own - median) <= _SAME_SHARE * median + _SAME_M:
                weight += left * alpha
                depth += left * alpha * own
                normal += left * alpha * planes[m, :3]
            left *= 1 - alpha
            if left < 1e-3:
                break
        length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        found[i, 0] = depth / weight
        found[i, 1:] = normal / max(length, 1e-9)


@numba.njit(inline="always")
@no_type_check
def _alpha(shape, u, v):
    """Alpha of a splat at a place in the picture, see `Splats`."""
    dx = u - shape[0]
    if abs(dx) > shape[7]:
        return 0.0
    dy = v - shape[1] - shape[2] * dx
    log = shape[5] + shape[3] * dx * dx + shape[4] * dy * dy
    return np.exp(log) if log >= shape[6] else 0.0


@numba.njit(inline="always")
@no_type_check
def _depth(plane, ray):
    """Depth at which a ray meets a splat's plane; that of its centre where it meets it elsewhere."""
    towards = plane[0] * ray[0] + plane[1] * ray[1] + plane[2] * ray[2]
    if towards >= -1e-6:
        return plane[4]
    depth = plane[3] / towards
    return depth if abs(depth - plane[4]) < _FARTHEST_OFF * plane[4] else plane[4]


def _planes(parts: Sequence[Part], indices: Int64[np.ndarray, " m"], camera: Camera) -> Float64[np.ndarray, "m 4"]:
    """Unit normals that face the eye, and n . x, of some Gaussians counted through all parts; camera axes, metres."""
    planes = np.zeros((len(indices), 4))
    first = 0
    for part in parts:
        rows = slice(*np.searchsorted(indices, [first, first + len(part.gaussians)]).tolist())
        chosen = indices[rows] - first
        first += len(part.gaussians)
        to_camera = camera.world_to_camera @ part.to_world
        places = part.gaussians.means[chosen].astype(np.float64) @ to_camera[:3, :3].T + to_camera[:3, 3]
        planes[rows, :3] = _normals(part, chosen, places, to_camera)
        planes[rows, 3] = np.sum(planes[rows, :3] * places, axis=1)
    planes[planes[:, 3] > 0] *= -1
    return planes


def _normals(
    part: Part,
    chosen: Int64[np.ndarray, " m"],
    places: Float64[np.ndarray, "m 3"],
    to_camera: Float64[np.ndarray, "4 4"],
) -> Float64[np.ndarray, "m 3"]:
    scales: Float32[np.ndarray, "m 3"] = part.gaussians.scales[chosen]
    turns = matrices_from_quaternions(part.gaussians.quaternions[chosen].astype(np.float64))
    shortest = np.argmin(scales, axis=1)
    along = np.take_along_axis(turns, shortest[:, None, None], axis=2)[:, :, 0] @ to_camera[:3, :3].T
    ordered = np.sort(scales, axis=1)
    flat = ordered[:, 0] < _FLAT * ordered[:, 1]
    normals = np.where(flat[:, None], along, places)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
