"""Ground of a scene: road surface, recorded drive, and small pieces of the solid background. World frame, meters."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float64

from ..scene.gaussians import Gaussians, scene_cache
from ..scene.geometry import matrices_from_quaternions
from ..scene.scene import Scene
from .geometry import Route, arc_lengths, points_along

SENSOR_HEIGHT_M = 1.5
"""Height of the rig frame's origin above the road if the scene does not state it (paper, sec. on rain regions)."""

_LOWEST_RIG_M, _HIGHEST_RIG_M = -0.5, 4.0  # plausible range of the rig origin's height above a stated ground


@dataclass(frozen=True, slots=True, eq=False)
class RoadSurface:
    """Ground as a grid of heights, interpolated bilinearly; vehicles on it stay upright on any slope."""

    corner_m: tuple[float, float]
    """x and y of the center of the first cell."""
    cell_m: float
    heights_m: Float64[np.ndarray, "rows columns"]
    """Heights at cell centers; rows run along y."""
    rig_height_m: float = SENSOR_HEIGHT_M
    """Height of the rig frame's origin above it along the recorded drive."""

    def height_m(self, x_m: float, y_m: float) -> float:
        """Return the height at a point; outside the grid that of the nearest cell."""
        return float(self.heights_at(np.array([[x_m, y_m]]))[0])

    def heights_at(self, places: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        rows, columns = self.heights_m.shape
        u, v = np.clip((places - self.corner_m) / self.cell_m, 0.0, (columns - 1.0, rows - 1.0)).T
        i, j = u.astype(np.int64), v.astype(np.int64)
        right, up = np.minimum(i + 1, columns - 1), np.minimum(j + 1, rows - 1)
        s, t = u - i, v - j
        near = (1 - s) * self.heights_m[j, i] + s * self.heights_m[j, right]
        far = (1 - s) * self.heights_m[up, i] + s * self.heights_m[up, right]
        return (1 - t) * near + t * far


@scene_cache(maxsize=2)
def road_surface_of(scene: Scene) -> RoadSurface:
    """Estimate the road surface of a scene; caches two scenes.

    Its depth below the recorded drive is the one that the scene states for the start of the drive, else the most
    frequent depth of flat parts below it; its shape follows flat parts around the drive. Without a drive it is level,
    at the stated height or at 0.
    """
    drive = recorded_ego_positions(scene)
    if not len(drive):
        return RoadSurface((0.0, 0.0), 1.0, np.full((1, 1), float(scene.ground_m or 0.0)))
    below = np.nan if scene.ground_m is None else float(drive[0, 2]) - scene.ground_m
    return _fitted_surface(scene, drive, below if _LOWEST_RIG_M < below < _HIGHEST_RIG_M else None)


# Road surface from the recorded drive

_UNDER_M = 2.5  # lateral distance from the drive within which parts count as below it
_CELL_M, _MAX_CELLS = 0.5, 1500  # cell size, and maximum number of cells per side; larger scenes get larger cells
_DEEPEST_M, _HIGHEST_M = 4.0, 0.5  # search range of the ground: depth below and height above the rig frame's origin
_BIN_M = 0.05
_MIN_M2 = 2.0  # minimum flat area needed to estimate the depth
_PASSES = ((8.0, 0.8, 4), (4.0, 0.4, 4), (2.0, 0.2, 3), (1.0, 0.12, 2))
"""Smoothing and band width (both in meters) and number of iterations, from coarse to fine."""

_ABOVE_COUNTS = 0.25
"""Weight of parts above the surface relative to parts below it, because objects stand on the ground."""

_ENOUGH = 0.05  # cell coverage at which the update has half its weight


def _fitted_surface(scene: Scene, drive: Float64[np.ndarray, "n 3"], below_m: float | None) -> RoadSurface:
    """Fit the ground around a drive; `below_m` is its depth below the rig frame's origin if known.

    The surface starts parallel to the drive and moves iteratively to the smoothed mean of parts in a band around it,
    while smoothing and band narrow. It thus follows slopes and passes under cars and bushes. Empty areas keep the
    coarser result.
    """
    low, high = _around(drive)
    reach = WorldRegion(low - [0, 0, _DEEPEST_M + 2], high + [0, 0, _HIGHEST_M + 2])
    grid = _followed(drive, reach)
    pieces = gaussian_pieces(scene, reach, _CELL_M)
    if below_m is None:
        below_m = _depth_below(drive, pieces)
    heights = grid.heights_m - below_m
    rows, columns = heights.shape
    place = np.rint((pieces.places[:, :2] - grid.corner_m) / grid.cell_m).astype(np.int64)
    inside = ((place >= 0) & (place < [columns, rows])).all(axis=1)
    cells, z = place[inside, 1] * columns + place[inside, 0], pieces.places[inside, 2]
    share = np.minimum(pieces.top_m2[inside] / grid.cell_m**2, 1.0)
    level = heights.ravel()
    for scale_m, band_m, times in _PASSES:
        for _ in range(times):
            above = z - level[cells]
            weight = share * np.exp(-0.5 * (above / band_m) ** 2) * np.where(above > 0.5 * band_m, _ABOVE_COUNTS, 1.0)
            sums = [np.bincount(cells, each, rows * columns) for each in (weight * above, weight)]
            moved, known = (
                _smoothed(each.astype(np.float64).reshape(rows, columns), scale_m / grid.cell_m) for each in sums
            )  # bincount gives integers without values
            level = level + (moved / (known + _ENOUGH)).ravel()
    return RoadSurface(grid.corner_m, grid.cell_m, level.reshape(rows, columns), below_m)


class HeightSlab(NamedTuple):
    """The space between two heights above the ground."""

    ground: RoadSurface
    low_m: float
    high_m: float

    def above_m(self, places: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
        return places[:, 2] - self.ground.heights_at(places[:, :2])


class WorldRegion(NamedTuple):
    """A box in the world, optionally limited to a slab above the ground."""

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]
    slab: HeightSlab | None = None


def _followed(drive: Float64[np.ndarray, "n 3"], reach: WorldRegion) -> RoadSurface:
    """Return a surface at the height of the nearest point of the drive, smoothed."""
    low, high = reach.low[:2], reach.high[:2]
    cell = max(_CELL_M, float((high - low).max()) / _MAX_CELLS)
    columns, rows = (np.ceil((high - low) / cell).astype(int) + 1).tolist()
    y, x = np.mgrid[:rows, :columns] * cell
    path = _dense(drive)
    nearest = scipy.spatial.KDTree(path[:, :2]).query(np.stack([x.ravel() + low[0], y.ravel() + low[1]], axis=1))[1]
    heights = path[np.asarray(nearest), 2].reshape(rows, columns)
    return RoadSurface((float(low[0]), float(low[1])), cell, _smoothed(heights, 2.0 / cell))


def _dense(drive: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "m 3"]:
    """Return the drive resampled to at most half a meter."""
    along = arc_lengths(drive[:, :2])
    return points_along(drive, along, np.linspace(0.0, along[-1], int(along[-1] / _CELL_M) + 2))


def _depth_below(drive: Float64[np.ndarray, "n 3"], pieces: "GaussianPieces") -> float:
    """Return the most frequent depth of flat parts below the drive; SENSOR_HEIGHT_M if nothing flat is there."""
    path = _dense(drive)
    away, nearest = scipy.spatial.KDTree(path[:, :2]).query(pieces.places[:, :2])
    under = np.asarray(away) < _UNDER_M
    depth, area = path[np.asarray(nearest)[under], 2] - pieces.places[under, 2], pieces.top_m2[under]
    edges = np.arange(-_HIGHEST_M, _DEEPEST_M + _BIN_M / 2, _BIN_M)
    histogram = np.convolve(np.histogram(depth, edges, weights=area)[0], np.ones(3), mode="same")
    best = int(np.argmax(histogram))
    if histogram[best] < _MIN_M2:
        return SENSOR_HEIGHT_M
    near = np.abs(depth - (edges[best] + _BIN_M / 2)) < 2 * _BIN_M
    return float(np.average(depth[near], weights=area[near]))


def _smoothed(grid: Float64[np.ndarray, "rows columns"], sigma: float) -> Float64[np.ndarray, "rows columns"]:
    return scipy.ndimage.gaussian_filter(grid, sigma, mode="nearest", truncate=2.5)


# Recorded drive

LATERAL_EXTENT_M = 40.0
"""Lateral distance from the recorded drive within which ground, road and obstacles are known."""


def recorded_ego_positions(scene: Scene) -> Float64[np.ndarray, "n 3"]:
    """Return the sampled positions of the rig frame's origin; empty if the scene has no ego vehicle."""
    poses = [] if scene.ego is None else [scene.ego_to_world(float(t)) for t in scene.ego.times]
    return np.array([pose[:3, 3] for pose in poses if pose is not None]).reshape(-1, 3)


def recorded_extent(scene: Scene) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Return the corners of the box around the recorded drive and its known surroundings.

    Without a drive it surrounds the origin. Heights are those of the drive.
    """
    drive = recorded_ego_positions(scene)
    return _around(drive if len(drive) else np.zeros((1, 3)))


def _around(drive: Float64[np.ndarray, "n 3"]) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    spot = np.array([LATERAL_EXTENT_M, LATERAL_EXTENT_M, 0.0])
    return drive.min(axis=0) - spot, drive.max(axis=0) + spot


_STEP_M = 0.5  # minimum spacing of a route; closer samples of a recorded drive mostly show noise


def recorded_route(scene: Scene) -> Route:
    """Return the route of the scene's ego vehicle. Raises ValueError if there is none or it does not move."""
    if scene.ego is None:
        raise ValueError(
            f"scene {scene.name!r} has no drive to follow: it has no ego vehicle; let one drive along a camera path "
            "(gsrain convert --drive, in the window Ego drives along the path)"
        )
    points: list[np.ndarray] = []
    for place in recorded_ego_positions(scene)[:, :2]:
        if not points or np.linalg.norm(place - points[-1]) >= _STEP_M:
            points.append(place)
    if len(points) < 2:
        raise ValueError(f"scene {scene.name!r} has no drive to follow: its ego vehicle moves less than {_STEP_M} m")
    return Route(np.array(points))


SOLID = 0.5
"""Minimum opacity of solid Gaussians; haze and most floaters of a capture have less."""

_CHUNK = 1 << 15
_COUNTS = ((1, 0.0, 0.5), (16, 0.5, 1.5), (64, 1.5, 4.0), (256, 4.0, np.inf))
"""Number of pieces per Gaussian, with the range of its largest standard deviation in cells."""

_DRAWS = np.clip(np.random.default_rng(0).standard_normal((256, 3)), -2, 2)
"""Sample offsets in standard deviations, truncated at two."""


class GaussianPieces(NamedTuple):
    """Pieces of Gaussians. World frame: meters, z up."""

    places: Float64[np.ndarray, "n 3"]
    side_m2: Float64[np.ndarray, " n"]
    """Projected area of each from the side, in the direction where it is largest."""
    top_m2: Float64[np.ndarray, " n"]
    """Projected area of each from above."""


def gaussian_pieces(
    scene: Scene, reach: WorldRegion, cell_m: float, names: frozenset[str] | None = None
) -> GaussianPieces:
    """Split the visible static Gaussians of a scene, without sky, into pieces not much larger than a cell.

    Hidden and deleted Gaussians are excluded. `names` restricts the layers.
    """
    pieces = [GaussianPieces(np.zeros((0, 3)), np.zeros(0), np.zeros(0))]
    for layer in scene.layers:
        if layer.kind == "sky" or not layer.visible or (names is not None and layer.name not in names):
            continue
        part = scene.part(layer)
        assert part is not None
        pieces += _pieces(part.remaining, part.opacity, part.to_world, reach, cell_m)
    places, side, top = (np.concatenate(column) for column in zip(*pieces, strict=True))
    return GaussianPieces(places, side, top)


def _pieces(
    gaussians: Gaussians, opacity: float, to_world: Float64[np.ndarray, "4 4"], reach: WorldRegion, cell_m: float
) -> Iterator[GaussianPieces]:
    centers = gaussians.means @ to_world[:3, :3].T + to_world[:3, 3]
    far = 2.0 * gaussians.scales.max(axis=1, initial=0.0)[:, None] * np.cbrt(np.linalg.det(to_world[:3, :3]))
    near = ((centers + far >= reach.low) & (centers - far <= reach.high)).all(axis=1)
    chosen = np.flatnonzero(near & (gaussians.opacities * opacity >= SOLID))
    for first in range(0, len(chosen), _CHUNK):
        rows = chosen[first : first + _CHUNK]
        part = gaussians.take(rows)
        turn = matrices_from_quaternions(part.quaternions.astype(np.float64))
        axes = to_world[:3, :3] @ (turn * part.scales[:, None, :])
        middles, opacities = centers[rows].astype(np.float64), part.opacities * opacity
        if reach.slab is not None:
            above, tall = reach.slab.above_m(middles), 2.0 * np.linalg.norm(axes[:, 2], axis=1)
            inside = (above + tall > reach.slab.low_m) & (above - tall < reach.slab.high_m)
            middles, axes, opacities = middles[inside], axes[inside], opacities[inside]
        yield from _strewn(middles, axes, opacities, reach, cell_m)


def _strewn(
    centers: Float64[np.ndarray, "n 3"],
    axes: Float64[np.ndarray, "n 3 3"],
    opacities: np.ndarray,
    reach: WorldRegion,
    cell_m: float,
) -> Iterator[GaussianPieces]:
    """Distribute pieces over each Gaussian. A flat one's projected areas along the axes are area times normal."""
    spread = axes @ axes.transpose(0, 2, 1)
    minors = [spread[:, i, i] * spread[:, j, j] - spread[:, i, j] ** 2 for i, j in ((1, 2), (0, 2), (0, 1))]
    shadow = [2 * np.pi * opacities * np.sqrt(np.maximum(minor, 0)) for minor in minors]
    side, top = np.hypot(shadow[0], shadow[1]), shadow[2]
    longest = np.sqrt(np.einsum("nii->ni", spread).max(axis=1, initial=0.0))
    for count, low, high in _COUNTS:
        own = np.flatnonzero((longest >= low * cell_m) & (longest < high * cell_m))
        draws = _DRAWS[:count] - _DRAWS[:count].mean(axis=0)
        places = (centers[own, None] + np.einsum("kj,nij->nki", draws, axes[own])).reshape(-1, 3)
        inside = ((places >= reach.low) & (places <= reach.high)).all(axis=1)
        if reach.slab is not None:
            above = reach.slab.above_m(places)
            inside &= (above > reach.slab.low_m) & (above < reach.slab.high_m)
        side_areas, top_areas = (np.repeat(each[own] / count, count)[inside] for each in (side, top))
        yield GaussianPieces(places[inside], side_areas, top_areas)
