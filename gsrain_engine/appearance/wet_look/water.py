"""Water on the ground: a film with rough reflections, puddles with clear ones. Linear light."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64
from scipy.special import ndtri

from ...scene.camera import Camera
from ..base import ClearView, Image, Plane
from .environment import ReflectionEnvironment
from .glossy import GlossyReflection, Ripmap, build_ripmap, glossy_reflection
from .masks import VisibleGround, smoothstep
from .noise import lattice_noise_at, tilt_normals, water_slopes
from .reflections import PlanarReflection

_FILM_SLOPE, _FILM_SMOOTHING = 0.09, 0.6
"""Slope deviation of a thin film over asphalt, and the share by which a thick film is smoother."""
_PUDDLE_SLOPE = 0.022  # slope deviation of standing water in rain: rings a few millimeters high, decimeters long
_TEXTURE_TILT, _RIPPLE_TILT = 0.016, 0.006
"""Slope deviation of the bumps that an image resolves, in the film and in puddles."""
FILM_COVER = (0.2, 0.95)
"""Share of the road that a thin and a thick film cover: stones stick out of it."""
_FACETS, _PUDDLE_FACETS = 11, 5
_MIN_SHARE = 0.01
_UNDER_WATER = 0.72
"""Share of a soaked road's light that leaves standing water; light reflected back into the water is absorbed."""
_UNDER_RIM = 0.88


@dataclass(frozen=True, slots=True, eq=False)
class WaterLayer:
    """Effect of water on an image: (1 - share) * through * surface + color. Linear light."""

    color: Image
    """Reflected light, multiplied by its share."""
    share: Plane
    """Share of reflected light, 0..1."""
    through: Plane
    """Share of the ground's own light that passes the water, 0..1; 1 without water."""


def water_layer_of(
    view: ClearView,
    surface: Image,
    surroundings: ReflectionEnvironment,
    look: Callable[[ClearView], Image],
    wetness: float,
    seed: int,
) -> WaterLayer | None:
    """Compute the water on the ground of a view, for a wetness of 0 (none) to 1; None if there is none.

    `surface` is the view on the rainy day without the water, in linear light: the source of screen-space reflections.
    `surroundings` provide the ground and reflections from outside the view, to which `look` gives the same weather.
    """
    ground = surroundings.ground(view) if wetness > 0 else None
    if ground is None:
        return None
    wet_rows = np.flatnonzero((ground.share > _MIN_SHARE).any(axis=1))
    if not len(wet_rows):
        return None
    mirrored = surroundings.mirrored(view, ground)
    picture = build_ripmap(mirrored.picture(surface, look(mirrored.beyond)))
    rows = slice(int(wet_rows[0]), int(wet_rows[-1]) + 1)
    maps = {name: getattr(ground, name)[rows] for name in ("share", "above_m", "points_m", "normals", "sunk_m")}
    part = _water(replace(ground, **maps), view.camera, mirrored, picture, wetness, seed)
    size = view.depth.shape
    whole = WaterLayer(np.zeros((*size, 3), np.float32), np.zeros(size, np.float32), np.ones(size, np.float32))
    whole.color[rows], whole.share[rows], whole.through[rows] = part.color, part.share, part.through
    return whole


def _water(
    ground: VisibleGround, camera: Camera, mirrored: PlanarReflection, picture: Ripmap, wetness: float, seed: int
) -> WaterLayer:
    # Length in meters of the ground in each pixel, along the line of sight.
    away = camera.position - ground.points_m
    distance = np.linalg.norm(away, axis=-1)
    flat = np.maximum(np.sum(away * ground.normals, axis=-1) / np.maximum(distance, 1e-6), 0.01)
    footprint = (distance / (camera.fy * flat)).astype(np.float32)
    standing = standing_water(ground.points_m, footprint, ground.sunk_m, wetness, seed)
    puddle, is_ground = standing.puddle * ground.share, ground.share > _MIN_SHARE
    thick = np.clip(0.6 * standing.patches + 0.5 * standing.rim, 0, 1)
    slopes = water_slopes(ground.points_m, footprint, seed)

    def light(tilt: float, chosen: Bool[np.ndarray, "h w"], slope: Plane | float, facets: int) -> GlossyReflection:
        normals = tilt_normals(ground.normals, slopes, tilt)
        roughness = np.where(chosen, slope, -1).astype(np.float32)
        return glossy_reflection(mirrored, picture, camera.position, ground.points_m, normals, roughness, facets)

    film_slope = _FILM_SLOPE * (1 - _FILM_SMOOTHING * wetness * thick)
    film = light(_TEXTURE_TILT, is_ground & (puddle < 0.995), film_slope, _FACETS)
    pool = light(_RIPPLE_TILT, is_ground & (puddle > 0.005), _PUDDLE_SLOPE, _PUDDLE_FACETS)
    thin, full = FILM_COVER
    film_part = (ground.share - puddle) * wetness * (thin + (full - thin) * thick)
    pool_part = puddle * min(1.0, 4 * wetness)
    color = film_part[..., None] * film.color + pool_part[..., None] * pool.color
    share = film_part * film.share + pool_part * pool.share
    damp = wetness * (standing.rim * ground.share - puddle).clip(0)
    through = 1 - (1 - _UNDER_WATER) * pool_part - (1 - _UNDER_RIM) * damp
    return WaterLayer(color.astype(np.float32), share.astype(np.float32), through.astype(np.float32))


# Standing water by world position, so that all views agree. Meters.

_OCTAVES = ((4.3, 0.8), (2.1, 0.9), (1.0, 0.5), (0.47, 0.25), (0.23, 0.13), (0.11, 0.07))
"""Size of bumps in meters, and height relative to the first; the finest ones fray the shores."""
_PATCHES = (0.0, 1.0, 1.0, 0.9, 0.6, 0.6)  # strength of each octave in the film's thickness
_TURN = 2.39996  # rotation in radians between octaves (the golden angle), so that no direction repeats
_HEIGHT_M = 0.006  # standard deviation of unevenness that captures don't resolve: a road of medium quality
_STANDING = 0.12  # share of an even, soaked road under standing water
_SHORE, _RIM = 0.35, 1.3  # widths of the shore and of the damp rim around it, in standard deviations of height
_BLUR = 3.4  # width of the smooth step closest to a normal distribution, in its standard deviations


@dataclass(frozen=True, slots=True, eq=False)
class StandingWater:
    """Standing water on the ground; each map is 0..1."""

    puddle: Plane
    """Share of each pixel under standing water."""
    rim: Plane
    """Proximity to a puddle: 1 in it, falling to 0."""
    patches: Plane
    """Relative thickness of the film: 0.5 on average."""


def standing_water(
    points_m: Float64[np.ndarray, "h w 3"], footprint_m: Plane, sunk_m: Plane, wetness: float, seed: int
) -> StandingWater:
    """Compute the extent of puddles.

    The ground's unevenness is a sum of random bumps of halving size plus `sunk_m`, the known depth of each point below
    its surroundings. Water fills the lowest parts, up to the level that covers the share of an even road set by the
    wetness. Bumps smaller than a pixel's `footprint_m` are not drawn but replaced by the share of the pixel under
    water, so that distant water doesn't flicker.
    """
    low, hidden, patches = (np.zeros(points_m.shape[:-1], np.float32) for _ in range(3))
    total = float(np.sum([height**2 for _, height in _OCTAVES]))
    for k, (size, height) in enumerate(_OCTAVES):
        share = 1 / (1 + np.square(np.square(np.minimum(footprint_m / (0.6 * size), 1e3))))
        height_there = share * lattice_noise_at(points_m, size, k * _TURN, seed * 31 + k)
        low += np.float32(height / np.sqrt(total)) * height_there
        hidden += np.float32(height**2 / total) * (1 - share**2)
        patches += np.float32(_PATCHES[k]) * height_there
    low += sunk_m / np.float32(_HEIGHT_M)
    depth = low - np.float32(ndtri(1 - _STANDING * wetness))
    puddle = smoothstep(-0.5, 0.5, depth / (_SHORE + _BLUR * np.sqrt(hidden)))
    return StandingWater(puddle, smoothstep(-_RIM, 0.1, depth), smoothstep(-2.6, 2.6, patches))
