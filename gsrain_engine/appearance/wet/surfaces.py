"""What kind of surface each pixel shows: ground, plants, walls, vehicles. Shares from 0 to 1."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32

from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.appearance.normals.from_depth import world_points

from .ground import Ground
from .plants import plant_share
from .smoothstep import smoothstep

Plane = Float32[np.ndarray, "h w"]

_SMOOTH_SHARE = 0.01
"""Normals are averaged over this share of the picture's width: those of real scenes are rough."""
_NEAR_GROUND_M, _DEPTH_NOISE = 0.2, 0.008
"""Height up to which something is ground: at once, and a metre of distance."""
_UP, _AGREEING = (0.35, 0.8), (0.75, 0.95)
"""Up-ness from which a surface lies open to rain, and length of mean normals from which they mean anything."""
_AMONG = (0.25, 0.6)
"""Share of leaves around something from which it is one."""
_UP_ELSEWHERE = 0.8
"""Soaking of level surfaces off the ground: ledges and roofs drain."""


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """Shares of kinds, and where they lie."""

    points: Float32[np.ndarray, "h w 3"]
    """In the world, metres."""
    normals: Float32[np.ndarray, "h w 3"]
    """Averaged over small surroundings, unit or 0."""
    upness: Plane
    """How much a surface lies open to rain from above: 0 to 1."""
    ground: Plane
    plants: Plane
    """Leaves and grass, upon the ground or not."""
    vehicles: Plane
    """Without the shadows on the ground that scenes count to them."""


def surfaces_of(view: ClearView, ground: Ground | None = None) -> Surfaces:
    """Tell kinds of surface from colour, up-ness, and height above the ground if that is known."""
    points = world_points(view.depth, view.camera).astype(np.float32)
    normals, sure = _smoothed(view.normals, max(1.0, _SMOOTH_SHARE * view.camera.width))
    upness = smoothstep(*_UP, normals[..., 2]) * sure
    level = upness if ground is None else _near_ground(view, ground)
    upness = np.maximum(upness if ground is None else _UP_ELSEWHERE * upness, level)
    vehicles = view.vehicles * (1 - level)
    plants = _with_gaps(plant_share(view.image), level) * (1 - vehicles)
    return Surfaces(points, normals, upness, level, plants, vehicles)


def _with_gaps(plants: Plane, level: Plane) -> Plane:
    """Count what is dark between leaves as leaves; on the ground it is ground."""
    among = cv2.GaussianBlur(plants, (0, 0), max(1.0, _SMOOTH_SHARE * plants.shape[1]))
    return np.maximum(plants, smoothstep(*_AMONG, among) * (1 - level))


def _near_ground(view: ClearView, ground: Ground) -> Plane:
    """How surely each pixel lies on the ground by its height alone: normals of real scenes are rough."""
    slack = _NEAR_GROUND_M + _DEPTH_NOISE * view.depth
    return (1 - smoothstep(0.5, 1.5, np.abs(ground.above_m) / slack)) * (view.depth > 0)


def _smoothed(normals: Float32[np.ndarray, "h w 3"], sigma_px: float) -> tuple[Float32[np.ndarray, "h w 3"], Plane]:
    """Mean normals, unit or 0, and how surely they are known: what is averaged agrees with itself."""
    there = (np.abs(normals).sum(axis=-1) > 0).astype(np.float32)
    mean = cv2.GaussianBlur(normals, (0, 0), sigma_px)
    length = np.linalg.norm(mean, axis=-1).astype(np.float32)
    sure = smoothstep(*_AGREEING, length / np.maximum(cv2.GaussianBlur(there, (0, 0), sigma_px), 1e-3)) * there
    return there[..., None] * mean / np.maximum(length, 1e-6)[..., None], sure
