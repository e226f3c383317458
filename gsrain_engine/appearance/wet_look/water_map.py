"""Map of the water on the ground of a captured scene, from its Gaussians: films on flat ground, puddles in hollows.

Captures have no materials. Ground is where solid Gaussians are near the surface that runs under all objects; it holds
water where it is flat, even and not green. Puddles are where the wet look has them.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64
from scipy import ndimage

from ...scene.gaussians import SH_C0
from ...scene.ground_water import GroundWater
from ...scene.scene import Scene
from .environment import SceneEnvironment
from .ground_plane import GroundHeights
from .masks import smoothstep, vegetation_mask
from .water import FILM_COVER, standing_water

_NEAR_M, _SCATTERS = 0.10, 2.0
"""Distance from the ground up to which Gaussians belong to it: fixed part in meters, and in standard deviations."""
_AROUND_M = 0.5  # standard deviation of the smoothing of what is found in cells
_LEVEL = (0.95, 0.99)  # ramp of the upward component of the normal: water runs off a slope of 18 degrees
_GRASSY = (0.15, 0.5)  # ramp of the share of leaves, from where less water to where none is visible
_ROUGH = (2.0, 4.0)  # ramp of the local scatter relative to that of all ground: bushes, stairs, rubble
_EVEN_M = 0.04  # scatter that is no roughness, but noise of a reconstruction
_MIN_POINTS, _MIN_M2, _MAX_SCATTER_M = 300, 20.0, 0.2
"""Number of Gaussians, area and scatter of what is believed to be ground."""


def with_water_map(scene: Scene) -> Scene:
    """Scene with a map of its water, if its surroundings have wet colors, and it has none."""
    if scene.water is not None or not scene.has_rainy_light:
        return scene
    return replace(scene, water=find_water(scene))


def with_water(scene: Scene) -> tuple[Scene, GroundHeights | None]:
    """Return a scene with the map of its water, found where it has none, and its ground's heights; None without one."""
    environment = SceneEnvironment(scene)
    if scene.water is None:
        scene = replace(scene, water=find_water(scene, environment))
    has_ground = scene.water is not None or scene.ground_m is not None  # a single object has none
    return scene, environment.heights if has_ground else None


def find_water(scene: Scene, surroundings: SceneEnvironment | None = None, seed: int = 0) -> GroundWater | None:
    """Find the ground of a scene, and the water that it holds when fully wet; None without ground.

    `surroundings` are those of the scene, if they are known already.

    Heights are rounded to millimeters, so that files hold them exactly. Depends on clear colors only.
    """
    surroundings = surroundings or SceneEnvironment(scene)
    heights = surroundings.heights
    if heights is None or heights.scatter_m > _MAX_SCATTER_M:
        return None
    rows, columns = heights.fine_m.shape
    cells, over, green = _near_ground(scene, surroundings, heights)
    if len(cells) < _MIN_POINTS:
        return None
    sigma = _AROUND_M / heights.cell_m

    def summed(values: Float64[np.ndarray, " n"] | None) -> Float64[np.ndarray, "rows columns"]:
        each = np.bincount(cells, values, rows * columns).astype(np.float64).reshape(rows, columns)
        return ndimage.gaussian_filter(each, sigma, truncate=3.0)

    count = summed(None)
    some = np.maximum(count, 1e-3)
    scatter = np.sqrt(summed(over**2) / some)
    y, x = np.mgrid[:rows, :columns] * heights.cell_m
    points = np.stack([x + heights.corner_m[0], y + heights.corner_m[1], heights.fine_m], axis=-1)
    share = smoothstep(*_LEVEL, heights.normals(points)[..., 2]) * (1 - smoothstep(*_GRASSY, summed(green) / some))
    share *= 1 - smoothstep(*_ROUGH, scatter / max(heights.scatter_m, _EVEN_M))
    share[count < 1e-2] = 0
    if share.sum() * heights.cell_m**2 < _MIN_M2:
        return None
    footprint = np.full((rows, columns), heights.cell_m, np.float32)
    standing = standing_water(points, footprint, heights.sunk_m, 1.0, seed)
    thin, full = FILM_COVER
    film = (1 - standing.puddle) * (thin + (full - thin) * np.clip(0.6 * standing.patches + 0.5 * standing.rim, 0, 1))
    cover = np.rint(255 * share[..., None] * np.stack([film, standing.puddle], axis=-1)).astype(np.uint8)
    x0, y0 = heights.corner_m
    corner = x0 - heights.cell_m / 2, y0 - heights.cell_m / 2
    rounded = (np.rint(1000 * heights.fine_m.astype(np.float64)) / 1000).astype(np.float32)
    return GroundWater(corner, heights.cell_m, cover, rounded, heights.scatter_m)


def _near_ground(
    scene: Scene, surroundings: SceneEnvironment, heights: GroundHeights
) -> tuple[Int64[np.ndarray, " n"], Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Cells of the solid Gaussians on the ground, their heights over it, and their likeness to leaves, 0..1."""
    rows, columns = heights.fine_m.shape
    cells, overs, greens = [np.zeros(0, np.int64)], [np.zeros(0)], [np.zeros(0)]
    for layer in surroundings.layers:
        points = layer.points[layer.solid]
        place = np.rint((points[:, :2] - heights.corner_m) / heights.cell_m).astype(np.int64)
        inside = np.flatnonzero(((place >= 0) & (place < [columns, rows])).all(axis=1))
        over = points[inside, 2] - heights.fine_m[place[inside, 1], place[inside, 0]]
        near = np.abs(over) < _NEAR_M + _SCATTERS * heights.scatter_m
        own = inside[near]
        sh = scene.member(layer.key).gaussians.sh[np.flatnonzero(layer.solid)[own], 0]
        colors = np.clip(sh * np.float32(SH_C0) + np.float32(0.5), 0, 1)
        cells.append(place[own, 1] * columns + place[own, 0])
        overs.append(over[near])
        greens.append(vegetation_mask(colors[None])[0].astype(np.float64))
    return np.concatenate(cells), np.concatenate(overs), np.concatenate(greens)
