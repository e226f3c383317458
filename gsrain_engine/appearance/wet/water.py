"""Water on the ground: a film that mirrors roughly, puddles that mirror clearly. Linear light."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32

from gsrain_engine.scene.camera import Camera

from ..clear_view import ClearView
from .blurred import Blurred, blurred
from .ground import Ground
from .mirrored import Mirrored
from .puddles import standing_water
from .rough_mirror import MirroredLight, mirrored_light
from .surroundings import Surroundings
from .unevenness import tilted, unevenness

Look = Callable[[ClearView], Float32[np.ndarray, "h w 3"]]

_FILM_SLOPE, _FILM_SMOOTHING = 0.09, 0.6
"""Standard deviation of slope of a thin film over asphalt, and by how much of that a thicker one is smoother."""
_PUDDLE_SLOPE = 0.022
"""Of standing water that rain falls on: rings of a few millimetres' height, decimetres long."""
_TEXTURE_TILT, _RIPPLE_TILT = 0.016, 0.006
"""Standard deviations of slope of the bumps that a picture resolves, in the film and in puddles."""
_FILM_COVER = (0.7, 1.0)
"""Share of the road that the film covers where it is thin and where it is thick: stones stick out of it."""
_FACETS, _PUDDLE_FACETS = 11, 5
_LEAST_SHARE = 0.01
_UNDER_WATER = 0.72
"""Part of a soaked road's light that gets out through standing water: what is mirrored back into it is absorbed."""
_UNDER_RIM = 0.88


@dataclass(frozen=True, slots=True, eq=False)
class Water:
    """What water does to a picture: (1 - share) * through * surface + color. Linear light."""

    color: Float32[np.ndarray, "h w 3"]
    """Light that the water mirrors, times its share."""
    share: Float32[np.ndarray, "h w"]
    """Share of mirrored light, 0..1."""
    through: Float32[np.ndarray, "h w"]
    """Part of the light of the ground itself that comes through the water, 0..1; 1 where there is none."""


def water_on(
    view: ClearView,
    surface: Float32[np.ndarray, "h w 3"],
    surroundings: Surroundings,
    look: Look,
    wetness: float,
    seed: int,
) -> Water | None:
    """Work out the water on the ground of a view; None where there is none.

    Args:
        view: As it is when clear.
        surface: The view on the rainy day, but for the water; linear light. It is mirrored where it shows what is.
        surroundings: Where the ground is, and what else it mirrors.
        look: Makes any view look like `surface`: what is mirrored from beyond the view goes through it.
        wetness: 0 (none) to 1.
        seed: Chooses the puddles.
    """
    ground = surroundings.ground(view) if wetness > 0 else None
    if ground is None:
        return None
    wet_rows = np.flatnonzero((ground.share > _LEAST_SHARE).any(axis=1))
    if not len(wet_rows):
        return None
    mirrored = surroundings.mirrored(view, ground)
    picture = blurred(mirrored.picture(surface, look(mirrored.beyond)))
    rows = slice(int(wet_rows[0]), int(wet_rows[-1]) + 1)
    part = _water(ground.of_rows(rows), view.camera, mirrored, picture, wetness, seed)
    size = view.depth.shape
    whole = Water(np.zeros((*size, 3), np.float32), np.zeros(size, np.float32), np.ones(size, np.float32))
    whole.color[rows], whole.share[rows], whole.through[rows] = part.color, part.share, part.through
    return whole


def _water(ground: Ground, camera: Camera, mirrored: Mirrored, picture: Blurred, wetness: float, seed: int) -> Water:
    footprint = _footprint(ground, camera)
    standing = standing_water(ground.points_m, footprint, ground.sunk_m, wetness, seed)
    puddle, is_ground = standing.puddle * ground.share, ground.share > _LEAST_SHARE
    thick = np.clip(0.6 * standing.patches + 0.5 * standing.rim, 0, 1)
    slopes = unevenness(ground.points_m, footprint, seed)

    def light(tilt: float, roughness: Float32[np.ndarray, "h w"], facets: int) -> MirroredLight:
        normals = tilted(ground.normals, slopes, tilt)
        return mirrored_light(mirrored, picture, camera.position, ground.points_m, normals, roughness, facets)

    roughness = _FILM_SLOPE * (1 - _FILM_SMOOTHING * wetness * thick)
    film = light(_TEXTURE_TILT, _where(is_ground & (puddle < 0.995), roughness), _FACETS)
    pool = light(_RIPPLE_TILT, _where(is_ground & (puddle > 0.005), _PUDDLE_SLOPE), _PUDDLE_FACETS)
    thin, full = _FILM_COVER
    film_part = (ground.share - puddle) * wetness * (thin + (full - thin) * thick)
    pool_part = puddle * min(1.0, 4 * wetness)
    color = film_part[..., None] * film.color + pool_part[..., None] * pool.color
    share = film_part * film.share + pool_part * pool.share
    damp = wetness * (standing.rim * ground.share - puddle).clip(0)
    through = 1 - (1 - _UNDER_WATER) * pool_part - (1 - _UNDER_RIM) * damp
    return Water(color.astype(np.float32), share.astype(np.float32), through.astype(np.float32))


def _where(
    chosen: Bool[np.ndarray, "h w"], roughness: Float32[np.ndarray, "h w"] | float
) -> Float32[np.ndarray, "h w"]:
    """Slopes of facets where they are asked for, and below 0 elsewhere."""
    return np.where(chosen, roughness, -1).astype(np.float32)


def _footprint(ground: Ground, camera: Camera) -> Float32[np.ndarray, "h w"]:
    """Length in metres of the ground in each pixel, along the line of sight."""
    away = camera.position - ground.points_m
    distance = np.linalg.norm(away, axis=-1)
    flat = np.maximum(np.sum(away * ground.normals, axis=-1) / np.maximum(distance, 1e-6), 0.01)
    return (distance / (camera.fy * flat)).astype(np.float32)
