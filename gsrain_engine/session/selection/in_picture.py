"""Gaussians that a shape drawn over the picture takes in: all through, those in front, or down to a depth."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float64

from gsrain_engine.raster.projection import NEAR_M, project
from gsrain_engine.render.scene_view import Shot
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import Part
from gsrain_engine.scene.scene import Scene

from .candidates import candidates
from .colorless import colorless
from .seen import LEAST_SHARE, seen_shares

Depths = Literal["all through", "front-most", "to a depth"]


@dataclass(frozen=True)
class Reach:
    """How far into the picture a shape reaches, and what it has to meet."""

    depths: Depths = "all through"
    depth_m: float = 20.0
    """Along the view axis from the camera; counts where `depths` says so."""
    touching: bool = False
    """Whether a Gaussian is taken in that the shape touches within one standard deviation, not its centre only."""
    least_share: float = LEAST_SHARE
    """Share of a Gaussian that has to be seen for it to be in front."""


ALL_THROUGH = Reach()


def in_picture(
    scene: Scene, shot: Shot, pixels: Bool[np.ndarray, "h w"], reach: Reach = ALL_THROUGH
) -> dict[str, Mask]:
    """Find what lies within a shape of the picture that `shot` takes; `pixels` are all of its pixels."""
    camera, depth = shot.camera, reach.depth_m if reach.depths == "to a depth" else np.inf
    found: dict[str, Mask] = {}
    if not pixels.any():
        return found
    own = candidates(scene, shot.time_s)
    find = _touched if reach.touching else _centered
    for each in own:
        found[each.key] = Mask.of(find(each.part, camera, pixels, depth))
    if reach.depths == "front-most":
        for key, shares in seen_shares(scene, shot, _box_around(pixels)).items():
            if key in found:
                found[key] = found[key] & Mask.of(shares >= reach.least_share)
    return found


def _box_around(pixels: Bool[np.ndarray, "h w"]) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of what is covered; the last two are past the end."""
    columns, rows = np.flatnonzero(pixels.any(axis=0)), np.flatnonzero(pixels.any(axis=1))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def _centered(part: Part, camera: Camera, pixels: Bool[np.ndarray, "h w"], depth_m: float) -> Bool[np.ndarray, " n"]:
    flags = np.empty(len(part.gaussians), np.bool_)
    to_camera = np.ascontiguousarray((camera.world_to_camera @ part.to_world)[:3])
    _find_centers(part.gaussians.means, to_camera, _intrinsics(camera), pixels, depth_m, flags)
    return flags


def _touched(part: Part, camera: Camera, pixels: Bool[np.ndarray, "h w"], depth_m: float) -> Bool[np.ndarray, " n"]:
    splats = project([colorless(part)], camera)
    touching = np.empty(len(splats), np.bool_)
    _find_ellipses(splats.shapes, splats.colors, pixels, depth_m, touching)
    flags = np.zeros(len(part.gaussians), np.bool_)
    flags[splats.indices[touching]] = True
    return flags


def _intrinsics(camera: Camera) -> Sequence[float]:
    return float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)


def camera_depths(part: Part, camera: Camera) -> Float64[np.ndarray, " n"]:
    """Depth of each Gaussian along the view axis in metres; below 0 behind the eye."""
    row = (camera.world_to_camera @ part.to_world)[2]
    return part.gaussians.means @ row[:3] + row[3]


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def _find_centers(means, m, intrinsics, pixels, depth, flags):
    """Flag what is projected onto a flagged pixel, at least as far as a renderer draws and at most so deep."""
    fx, fy, cx, cy = intrinsics
    height, width = pixels.shape
    for i in range(len(means)):
        x, y, z = means[i, 0], means[i, 1], means[i, 2]
        pz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        flags[i] = False
        if NEAR_M < pz <= depth:
            near = 1 / pz
            u = fx * near * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) + cx
            v = fy * near * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) + cy
            if 0 <= u < width and 0 <= v < height:
                flags[i] = pixels[int(v), int(u)]


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def _find_ellipses(shapes, colors, pixels, depth, flags):
    """Flag splats whose centre, or one of eight places on their ellipse of one standard deviation, is flagged."""
    height, width = pixels.shape
    for i in range(len(shapes)):
        flags[i] = False
        if not 0 < colors[i, 3] <= depth:
            continue
        reach, shear = np.sqrt(-0.5 / shapes[i, 3]), shapes[i, 2]
        rise = np.sqrt(-0.5 / shapes[i, 4])
        for k in range(9):
            along = 0.0 if k == 8 else np.cos(k * np.pi / 4) * reach
            across = 0.0 if k == 8 else np.sin(k * np.pi / 4) * rise
            u, v = shapes[i, 0] + along, shapes[i, 1] + shear * along + across
            if 0 <= u < width and 0 <= v < height and pixels[int(v), int(u)]:
                flags[i] = True
                break
