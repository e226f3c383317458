"""Gaussians of a scene as surfaces: sunlight, ground, plants and level surfaces, by neighbors; and its sky."""

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int32
from scipy.spatial import KDTree

from ...scene.gaussians import SH_C0, sh_basis
from ...scene.geometry import matrices_from_quaternions, srgb_to_linear
from ...scene.objects import is_vehicle
from ...scene.progress import Progress
from ...scene.scene import Actor, Layer, Scene, core_bounds, is_sky
from .ground_plane import GroundHeights
from .illumination import (
    BROAD_EV2,
    DARKEST_EV,
    EDGE_EV2,
    LUMINANCE,
    IlluminationEstimate,
    illumination_of,
    is_gray,
    sun_ramps,
)
from .masks import AMONG_LEAVES, NEAR_GROUND_M, UP_ELSEWHERE, smoothstep, vegetation_mask

Colors = Float32[np.ndarray, "n 3"]
Values = Float32[np.ndarray, " n"]
Harmonics = Float32[np.ndarray, "n k 3"]
SkyPaint = Callable[[Float64[np.ndarray, "n 3"]], Colors]
"""Display color of a sky in unit directions of the world."""

_MAX_SCATTER_M = 0.2  # scatter of what is believed to be ground
BLOCK = 16384
"""Gaussians that are changed at once."""
_LEVEL = (0.45, 0.8)  # ramp of the squared upward component of normals, from walls to level surfaces
_SHADOW_M = 0.08  # height over the road below which a vehicle's Gaussians are its shadow


@dataclass(frozen=True, slots=True, eq=False)
class GaussianSurfaces:
    """Gaussians of a layer or an actor as surfaces; all arrays have one row for each."""

    points: Float32[np.ndarray, "n 3"]
    """Meters, z up; of an actor in its own frame."""
    color: Colors
    """Display color, 0..1, as the scene's cameras see it."""
    level_ev: Values
    """Luminance in stops over white."""
    area_m2: Values
    opacities: Values
    ground: Values
    plants: Values
    vehicles: Values
    up_facing: Values
    near: "Neighbors"
    broad: "Neighbors"


@dataclass(frozen=True, slots=True, eq=False)
class SceneSurfaces:
    """Surfaces of a scene, its sky, and the light that it was recorded in."""

    members: dict[str, GaussianSurfaces]
    """Of layers and actors by key; not of sky layers."""
    sky: "GaussianSky"
    light: IlluminationEstimate
    heights: GroundHeights | None
    """Heights of the ground, if they are known well enough."""

    def above_m(self, own: GaussianSurfaces) -> Values:
        """Height of a layer's Gaussians over the ground; over the world's origin without one."""
        above = own.points[:, 2]
        return above if self.heights is None else above - self.heights.sampled(self.heights.smooth_m, own.points)


def find_surfaces(scene: Scene, heights: GroundHeights | None) -> Generator[Progress, None, SceneSurfaces]:
    """Find the surfaces of a scene, on and above a ground of these heights, if any is known."""
    yield Progress(0.0, "Finding the sky")
    if heights is not None and heights.scatter_m > _MAX_SCATTER_M:
        heights = None
    sky = GaussianSky.of(scene)
    found, eyes = dict[str, GaussianSurfaces](), viewpoints(scene)
    for member in scene.members:
        if not is_sky(member) and len(member.gaussians):
            yield Progress(0.1 + 0.9 * len(found) / len(scene.members), f"Looking at the surfaces of {member.name}")
            found[member.key] = surfaces_of_member(scene, member, heights, eyes)
    light = light_on_ground([found[each.key] for each in scene.layers if each.key in found])
    return SceneSurfaces(found, sky, light, heights)


# Neighbors in space

_NEAREST, _NEAREST_BROAD, _BROAD_SAMPLE = 16, 32, 50_000
"""Number of neighbors of one Gaussian; of its wider surroundings, and the size of the sample that these are from."""


@dataclass(frozen=True, slots=True, eq=False)
class Neighbors:
    """Nearest ones of each point among a sample of all."""

    rows: Int32[np.ndarray, "n k"]

    @classmethod
    def among(cls, points: Float[np.ndarray, "n 3"], count: int, sample: int | None = None) -> "Neighbors":
        step = 1 if sample is None else max(1, -(-len(points) // sample))
        chosen = np.arange(0, len(points), step)
        places = np.nan_to_num(points)
        tree = KDTree(places[chosen], balanced_tree=False, compact_nodes=False)
        rows = np.empty((len(points), min(count, len(chosen))), np.int32)
        for first in range(0, len(points), BLOCK):
            near: Any = tree.query(places[first : first + BLOCK], rows.shape[1], workers=-1)[1]
            rows[first : first + BLOCK] = chosen[near.reshape(len(near), -1)]
        return cls(rows)

    def mean(self, values: Values, weights: Values | None = None) -> Values:
        result = np.empty(len(self.rows), np.float32)
        for rows, own in self._blocks():
            each = values[own]
            if weights is None:
                result[rows] = each.mean(axis=1)
            else:
                weight = weights[own] + np.float32(1e-6)
                result[rows] = (weight * each).sum(axis=1) / weight.sum(axis=1)
        return result

    def median(self, values: Values) -> Values:
        result = np.empty(len(self.rows), np.float32)
        for rows, own in self._blocks():
            result[rows] = np.median(values[own], axis=1)
        return result

    def guided(self, values: Values, guide: Values, variance: float) -> Values:
        """Smooth values as a local linear function of a guide (He, Sun and Tang 2013), with neighbors as windows."""
        mean, mean_guide = self.mean(values), self.mean(guide)
        together = self.mean(values * guide) - mean * mean_guide
        alone = self.mean(guide * guide) - mean_guide**2
        slope = together / (np.maximum(alone, 0) + np.float32(variance))
        return self.mean(slope) * guide + self.mean(mean - slope * mean_guide)

    def _blocks(self) -> Iterator[tuple[slice, Int32[np.ndarray, "m k"]]]:
        for first in range(0, len(self.rows), BLOCK):
            rows = slice(first, first + BLOCK)
            yield rows, self.rows[rows]


# Surfaces


def surfaces_of_member(
    scene: Scene, member: Layer | Actor, heights: GroundHeights | None, eyes: Float64[np.ndarray, "e 3"]
) -> GaussianSurfaces:
    g = member.gaussians
    scale = scene.metres_per_unit
    to_world = scene.scene_to_world @ member.to_scene if isinstance(member, Layer) else np.diag([scale] * 3 + [1.0])
    points = np.nan_to_num(g.means @ to_world[:3, :3].T + to_world[:3, 3]).astype(np.float32)
    color = np.clip(_recorded_colors(g.sh, points, eyes if isinstance(member, Layer) else eyes[:0], to_world), 0, 1)
    sizes = np.sort(g.scales, axis=1) * np.float32(np.cbrt(np.linalg.det(to_world[:3, :3])))
    near = Neighbors.among(points, _NEAREST)
    vehicles = np.zeros(len(g), np.float32)
    if isinstance(member, Actor):
        ground = np.zeros(len(g), np.float32)
        if is_vehicle(member.class_name):
            ground = (points[:, 2] < _SHADOW_M).astype(np.float32)
            vehicles = 1 - ground
    elif heights is None:
        ground = np.zeros(len(g), np.float32)
    else:
        above = np.abs(points[:, 2] - heights.sampled(heights.fine_m, points))
        ground = 1 - smoothstep(0.5, 1.5, above / (NEAR_GROUND_M + 2 * heights.scatter_m))
    upward = _upward_squared(g.scales, g.quaternions, to_world)
    flatness = (1 - sizes[:, 0] / np.maximum(sizes[:, 1], 1e-9)) * g.opacities
    up = smoothstep(*_LEVEL, near.mean(upward, flatness.astype(np.float32)))
    leaves = vegetation_mask(color)
    gaps = smoothstep(*AMONG_LEAVES, near.mean(leaves, g.opacities)) * (1 - ground)
    level = np.log2(np.maximum(srgb_to_linear(color) @ LUMINANCE, 2**DARKEST_EV)).astype(np.float32)
    return GaussianSurfaces(
        points, color, level, np.pi * sizes[:, 1] * sizes[:, 2], g.opacities, ground,
        np.maximum(leaves, gaps) * (1 - vehicles), vehicles, np.maximum(UP_ELSEWHERE * up, ground).astype(np.float32),
        near, Neighbors.among(points, _NEAREST_BROAD, _BROAD_SAMPLE),
    )  # fmt: skip


_VIEWPOINTS, _NEAR_M = 24, 1.0


def viewpoints(scene: Scene) -> Float64[np.ndarray, "e 3"]:
    """Places of the cameras of a recorded drive, some of all; none without one."""
    rig = next((cameras for cameras in scene.rigs.values() if cameras), ())
    if scene.ego is None or not scene.ego.valid.any() or not rig:
        return np.zeros((0, 3))
    middle = np.mean([each.camera_to_ego[:3, 3] for each in rig], axis=0)
    times = scene.ego.times[scene.ego.valid]
    chosen = times[np.unique(np.linspace(0, len(times) - 1, min(len(times), _VIEWPOINTS)).round().astype(np.int64))]
    poses = [pose for time_s in chosen.tolist() if (pose := scene.ego_to_world(time_s)) is not None]
    return np.array([pose[:3, :3] @ middle + pose[:3, 3] for pose in poses]).reshape(-1, 3)


def _recorded_colors(
    sh: Harmonics, points: Float32[np.ndarray, "n 3"], eyes: Float64[np.ndarray, "e 3"],
    to_world: Float64[np.ndarray, "4 4"],
) -> Colors:  # fmt: skip
    """Display colors as seen from some places, near ones counting most; without any, the mean over all directions.

    Harmonics are known only for directions that a recording has; their mean over all may be any color.
    """
    mean = sh[:, 0] * np.float32(SH_C0) + np.float32(0.5)
    if sh.shape[1] == 1 or not len(eyes):
        return mean.astype(np.float32)
    colors, total = np.zeros_like(mean), np.zeros((len(sh), 1), np.float32)
    turn = to_world[:3, :3] / np.cbrt(np.linalg.det(to_world[:3, :3]))
    for eye in eyes:
        for first in range(0, len(sh), BLOCK):
            rows = slice(first, first + BLOCK)
            away = points[rows] - eye
            weight = (1 / (np.sum(away * away, axis=1, keepdims=True) + _NEAR_M**2)).astype(np.float32)
            basis = sh_basis(unit_vectors(away) @ turn, sh.shape[1]).astype(np.float32)
            colors[rows] += weight * np.einsum("nk,nkc->nc", basis, sh[rows])
            total[rows] += weight
    return (colors / total + np.float32(0.5)).astype(np.float32)


def _upward_squared(
    scales: Float32[np.ndarray, "n 3"], quaternions: Float32[np.ndarray, "n 4"], to_world: Float64[np.ndarray, "4 4"]
) -> Values:
    """Squared upward component of the normal, which is the shortest axis: 1 of level surfaces, 0 of walls."""
    up = to_world[2, :3] / np.linalg.norm(to_world[2, :3])
    along = up @ matrices_from_quaternions(quaternions.astype(np.float64))  # of each axis
    shortest = np.argmin(scales, axis=1)[:, None]
    return np.square(np.take_along_axis(along, shortest, axis=1)[:, 0]).astype(np.float32)


# Light

_MAX_AREA = 0.9  # quantile of the areas of ground from which on one Gaussian counts no more
_TINTS_APART_EV, _SUNLIT_TINT = (0.2, 0.4), (0.1, 0.6)
"""Ramps of the difference between the tints of sun and shadow in stops, from where it tells them apart; and of the way
from the shadow's tint to the sun's."""


def light_on_ground(layers: list[GaussianSurfaces]) -> IlluminationEstimate:
    colors, weights = [np.zeros((0, 3), np.float32)], [np.zeros(0, np.float32)]
    for each in layers:
        linear = srgb_to_linear(each.color).astype(np.float32)
        chosen = (each.ground > 0.5) & (each.plants < 0.5) & is_gray(linear) & (each.opacities > 0.1)
        colors.append(linear[chosen])
        weights.append((each.area_m2 * each.opacities)[chosen].astype(np.float32))
    weight = np.concatenate(weights)
    if len(weight):
        weight = np.minimum(weight, np.quantile(weight, _MAX_AREA))
    return illumination_of(np.concatenate(colors), weight)


def sunlit_share(own: GaussianSurfaces, light: IlluminationEstimate) -> Values:
    """Share of sunlight on each Gaussian in the clear scene, as `illumination.sunlit_share` has it for pixels."""
    sharp, wide = sun_ramps(light)
    share = wide(own.broad.guided(own.level_ev, own.level_ev, BROAD_EV2))
    ground = np.flatnonzero(own.ground > 0)
    if len(ground) > _NEAREST:
        near, level = Neighbors.among(own.points[ground], _NEAREST), own.level_ev[ground]
        lit = sharp(level) * _warm_share(srgb_to_linear(own.color[ground]), light)
        lit = np.clip(near.guided(near.median(lit), level, EDGE_EV2), 0, 1)
        share[ground] += own.ground[ground] * (lit - share[ground])
    return share


def _warm_share(colors: Float[np.ndarray, "n 3"], light: IlluminationEstimate) -> Values:
    """Share of sunlight that the tint of ground (linear colors) allows: white paint in blue shadow is not in the sun.

    1 everywhere, unless sun and shadow differ in tint.
    """
    shadow = np.array(light.shadow_tint_ev)
    apart = np.array(light.sunlit_tint_ev) - shadow
    size = float(np.linalg.norm(apart))
    if size < _TINTS_APART_EV[0]:
        return np.ones(len(colors), np.float32)
    luminance = np.maximum(colors @ LUMINANCE, 2**DARKEST_EV)[:, None]
    tint = np.log2(np.maximum(colors, 2**DARKEST_EV) / luminance)
    toward_sun = smoothstep(*_SUNLIT_TINT, (tint - shadow) @ apart / size**2)
    trust = smoothstep(*_TINTS_APART_EV, np.array([size]))
    return 1 - trust * (1 - toward_sun)


# Sky

_LIKE = (0.04, 0.12)  # ramp of the color difference (display) from the sky behind it to other surfaces
_NEAR_IN_SKY = 8  # Gaussians of the sky around a direction
_ABOVE_M, _RISING = 4.0, (0.05, 0.12)
"""Height over the ground, and ramp of the upward component of a direction, from which Gaussians may be sky: holes in
foliage are filled with its color, and white walls are not to be taken for it."""


@dataclass(frozen=True, slots=True, eq=False)
class GaussianSky:
    """Sky of a scene: its layers, or the shell far around it."""

    middle: Float64[np.ndarray, "3"]
    shells: dict[str, Bool[np.ndarray, " _"]]
    """Mask of the Gaussians of each layer that are sky."""
    tree: KDTree | None
    """Directions of the sky's Gaussians; None without a sky."""
    colors: Colors

    @classmethod
    def of(cls, scene: Scene) -> "GaussianSky":
        parts = {layer.key: part for layer in scene.layers if (part := scene.part(layer)) is not None}
        kinds = {layer.key: is_sky(layer) for layer in scene.layers}
        core = core_bounds([parts[key] for key in parts if not kinds[key]], [parts[key] for key in parts if kinds[key]])
        middle = core.middle
        if scene.ego is not None and scene.ego.valid.any():
            ego = scene.ego.positions[scene.ego.valid].mean(axis=0)
            middle = scene.scene_to_world[:3, :3] @ ego + scene.scene_to_world[:3, 3]
        shells: dict[str, Bool[np.ndarray, " n"]] = {}
        directions, colors = [np.zeros((0, 3))], [np.zeros((0, 3), np.float32)]
        for key, part in parts.items():
            far = np.zeros(len(part.gaussians), np.bool_) if core.shell is None else core.shell.holds(part)
            shells[key] = own = np.ones_like(far) if kinds[key] else far
            means = part.gaussians.means[own] @ part.to_world[:3, :3].T + part.to_world[:3, 3]
            directions.append(unit_vectors(means - middle))
            dc = part.gaussians.sh[own, 0] * np.float32(SH_C0) + np.float32(0.5)
            colors.append(np.clip(dc, 0, 1).astype(np.float32))
        all_of_it = np.concatenate(directions)
        return cls(middle, shells, KDTree(all_of_it) if len(all_of_it) else None, np.concatenate(colors))

    def painted(self, scene: Scene, member: Layer | Actor, paint: SkyPaint, share: float = 1.0) -> Harmonics:
        """Harmonics of a layer that is sky with a share of another sky (0..1)."""
        sh = member.gaussians.sh
        part = scene.part(member) if isinstance(member, Layer) else None
        if part is None or not len(sh):
            return sh.copy()
        clear = np.clip(sh[:, 0] * np.float32(SH_C0) + np.float32(0.5), 0, 1).astype(np.float32)
        means = part.gaussians.means @ part.to_world[:3, :3].T + part.to_world[:3, 3]
        other = paint(unit_vectors(means - self.middle))
        changed = (1 - np.float32(share)) * sh
        mixed = clear + np.float32(share) * (other - clear)
        changed[:, 0] = (mixed - np.float32(0.5)) / np.float32(SH_C0)
        return changed

    def behind(self, key: str, own: GaussianSurfaces, above_m: Values, paint: SkyPaint) -> tuple[Colors, Values]:
        """Color of another sky behind each Gaussian, and the share of it that is sky rather than a surface."""
        directions = unit_vectors(own.points - self.middle)
        share = self.shells[key].astype(np.float32)
        painted = paint(directions)
        if self.tree is None:
            return painted, share
        high = np.flatnonzero((above_m > _ABOVE_M) & (directions[:, 2] > _RISING[0]))
        count = min(_NEAR_IN_SKY, len(self.colors))
        for first in range(0, len(high), BLOCK):
            rows = high[first : first + BLOCK]
            near: Any = self.tree.query(directions[rows], count, workers=-1)[1]
            behind = self.colors[near.reshape(len(rows), -1)].mean(axis=1)
            like = 1 - smoothstep(*_LIKE, np.abs(own.color[rows] - behind).max(axis=1))
            share[rows] = np.maximum(share[rows], like * smoothstep(*_RISING, directions[rows, 2]))
        return painted, share


def unit_vectors(vectors: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    far: Any = vectors.astype(np.float64)
    return far / np.maximum(np.linalg.norm(far, axis=1, keepdims=True), 1e-9)
