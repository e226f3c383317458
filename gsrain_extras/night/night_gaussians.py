"""A night version of a scene: reflectance of each Gaussian from its clear color, relit by lamps under a dark sky.

No view is drawn. Sunlight and its shadows are removed as by the wet look, which also darkens what is soaked.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Float64
from scipy.spatial import KDTree

from gsrain_engine.appearance.wet_look.gaussian_surfaces import (
    BLOCK,
    Colors,
    GaussianSurfaces,
    Harmonics,
    SceneSurfaces,
    Values,
    find_surfaces,
    sunlit_share,
    viewpoints,
)
from gsrain_engine.appearance.wet_look.ground_plane import GroundHeights
from gsrain_engine.appearance.wet_look.illumination import DARKEST_EV, IlluminationEstimate, is_gray, overcast_colors
from gsrain_engine.appearance.wet_look.masks import smoothstep
from gsrain_engine.appearance.wet_look.materials import MEAN_REFLECTANCE, WHITE, lamp_share, wet_surfaces_color
from gsrain_engine.appearance.wet_look.settings import WetSettings
from gsrain_engine.appearance.wet_look.water_map import with_water
from gsrain_engine.appearance.wet_look.wet_gaussians import changed_harmonics, row_of
from gsrain_engine.scene.find_lamps import is_dark
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.geometry import LUMINANCE, matrices_from_quaternions, srgb_to_linear
from gsrain_engine.scene.lamps import LAMP_REACH_M, Lamp, facing_share, lit_lamps
from gsrain_engine.scene.progress import Progress, subprogress
from gsrain_engine.scene.scene import Actor, Layer, Scene, SceneCore, core_bounds, is_sky
from gsrain_engine.scene.skies import NIGHT, overcast_share
from gsrain_engine.scene.sky_dome import dome_directions, dome_gaussians

from .lamp_shadows import OpacityGrid
from .lanterns import bulbs, default_lamps
from .traffic_lights import LENS_LIGHT, SignalLens, is_traffic_light, lamps_of_lenses, lit_lenses

_NEUTRAL = WetSettings(sun_removal=1.0, coolness=0.0)
"""Clouds of neutral color, in whose light a color is the reflectance but for a factor."""
_GROUND_ALBEDO, _MEAN_ALBEDO, _LEAF_ALBEDO = 0.15, 0.18, 0.09
"""Reflectance of level gray ground, such as weathered asphalt; of the middle of a scene without it, for which exposure
meters are made (ISO 2720); and the mean of leaves in visible light (Gates et al. 1965), at least."""
_FACTOR, _MAX_ALBEDO = (0.3, 2.5), 0.85
"""Range of the factors by which these are reached, and the reflectance of the whitest."""


def night_scene(scene: Scene, lamps: Sequence[Lamp] | None = None) -> Generator[Progress, None, Scene]:
    """Relight a scene that was recorded by day as by night: with dry and soaked colors, dark sky, and lamps.

    Args:
        scene: The scene; its geometry stays.
        lamps: Lamps in place of the scene's own. A scene without any gets those of `default_lamps`, and one for each
            lit lens of its traffic lights. Only those that are mounted on the scene light surfaces; lenses don't.

    Raises ValueError for a scene that is dark already, or has no Gaussians.
    """
    if not scene.gaussian_count:
        raise ValueError(f"scene {scene.name!r} has no Gaussians that could be relit")
    if is_dark(scene):
        raise ValueError(f"scene {scene.name!r} is dark already: it can't be relit as by night")
    yield Progress(0.0, "Finding the ground, and the water that it holds")
    scene, heights = with_water(scene)
    surfaces = yield from subprogress(find_surfaces(scene, heights), 0.1, 0.45)
    core = _core(scene)
    lights = [each for each in scene.members if is_traffic_light(each) and each.key in surfaces.members]
    lenses = {each.key: lit_lenses(scene, each, surfaces.members[each.key]) for each in lights}
    shining, bodies, signals = list(lamps if lamps is not None else scene.lamps), None, ()
    if lamps is None and not scene.lamps:
        shining, bodies = default_lamps(scene, core, surfaces.heights)
        signals = lamps_of_lenses(scene, [(each, lenses[each.key]) for each in lights])
    yield Progress(0.5, "Finding what lamps are hidden by")
    night = _Night.over(scene, surfaces, core, shining, lenses)
    layers, actors = list[Layer](), list[Actor]()
    for number, member in enumerate(scene.members):
        yield Progress(0.5 + 0.5 * number / len(scene.members), f"Lighting {member.name}")
        dry, wet = night.colors(scene, member)
        relit = replace(member, gaussians=member.gaussians.with_sh(dry), wet_sh=wet)
        if isinstance(relit, Layer):
            layers.append(relit)
        else:
            actors.append(relit)
    bodies = bodies or bulbs(scene, shining)
    new = [*([] if bodies is None else [bodies]), *([_dome(scene, core)] if surfaces.sky.tree is None else [])]
    layers += [replace(each, name=_free_name(scene, each.name), wet_sh=each.gaussians.sh) for each in new]
    yield Progress(1.0, "Done")
    return replace(scene, layers=tuple(layers), actors=tuple(actors), lamps=(*shining, *signals))


def _core(scene: Scene) -> SceneCore:
    parts = {each.key: part for each in scene.members if (part := scene.part(each)) is not None}
    sky = {each.key for each in scene.layers if is_sky(each)}
    return core_bounds(
        [part for key, part in parts.items() if key not in sky], [parts[key] for key in parts if key in sky]
    )


def _free_name(scene: Scene, name: str) -> str:
    names = {each.name for each in scene.layers}
    return next(each for k in range(len(names) + 1) if (each := f"{name} {k + 1}" if k else name) not in names)


# Reflectance

_EVEN, _UNEVEN_EV = 0.7, 1.5
"""Share of the broad differences of ground that is taken for what is left of the sun, and their limit in stops."""
_MIN_GAUSSIANS = 100  # of ground or plants, from which their factor is known


def reflectances(own: GaussianSurfaces, light: IlluminationEstimate) -> Colors:
    """Diffuse reflectance of Gaussians but for a factor, linear: their color under clouds, without sun and shadow.

    Ground has no other broad differences of brightness than those of the light (Land and McCann 1971).
    """
    sunlit, found = sunlit_share(own, light), np.empty_like(own.color)
    linear = srgb_to_linear(own.color).astype(np.float32)
    for first in range(0, len(found), BLOCK):
        rows = slice(first, first + BLOCK)
        found[rows] = overcast_colors(linear[None, rows], sunlit[None, rows], light, _NEUTRAL, row_of(own, rows))[0]
    ground = own.ground * (1 - own.plants)
    if light.sun > 0 and ground.any():
        level = np.log2(np.maximum(found @ LUMINANCE, 2**DARKEST_EV)).astype(np.float32)
        mean = np.average(level, weights=ground * own.area_m2)
        uneven = np.clip(own.broad.mean(level, ground) - mean, -_UNEVEN_EV, _UNEVEN_EV)
        found *= np.exp2(-_EVEN * light.sun * ground * uneven)[:, None]
    return found


class _Albedo(NamedTuple):
    """Factors on relative reflectances."""

    solid: float
    plants: float

    @classmethod
    def of(cls, surfaces: SceneSurfaces, relative: dict[str, Colors]) -> "_Albedo":
        """Factors by which level gray ground is asphalt, or the mean that of most scenes; and plants have leaves."""
        names = "value", "area", "ground", "plants"
        lists: dict[str, list[Float[np.ndarray, " _"]]] = {name: [np.zeros(0)] for name in names}
        for key, own in surfaces.members.items():
            gray = own.ground * (1 - own.plants) * is_gray(relative[key])
            columns = relative[key] @ LUMINANCE, own.area_m2 * own.opacities, gray, own.plants
            for name, column in zip(names, columns, strict=True):
                lists[name].append(column[own.opacities > 0.1])
        value, area, ground, plants = (np.concatenate(lists[name]) for name in names)
        solid, leaves = np.ones(len(value), np.bool_), plants > 0.5
        aim = _MEAN_ALBEDO
        if surfaces.heights is not None and np.count_nonzero(ground > 0.5) >= _MIN_GAUSSIANS:
            solid, aim = ground > 0.5, _GROUND_ALBEDO
        factor = _clipped(aim / max(_median(value[solid], area[solid]), 1e-6))
        if np.count_nonzero(leaves) < _MIN_GAUSSIANS:
            return cls(factor, factor)
        mean = float(np.average(value[leaves], weights=np.minimum(area, np.quantile(area, 0.9))[leaves]))
        return cls(factor, max(factor, _clipped(_LEAF_ALBEDO / max(mean, 1e-6))))

    def on(self, relative: Colors, own: GaussianSurfaces) -> Colors:
        factor = self.solid + own.plants * np.float32(self.plants - self.solid)
        return np.minimum(factor[:, None] * relative, np.float32(_MAX_ALBEDO))


def _clipped(factor: float) -> float:
    return float(np.clip(factor, *_FACTOR))


def _median(values: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]) -> float:
    order = np.argsort(values)
    summed = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(summed, 0.5 * summed[-1])]]) if len(values) else 0.0


# Normals

_SURE = (0.45, 0.8)  # ramp of the largest eigenvalue of the mean of n n^T: 1/3 for any direction, 1 for one


class SurfaceNormals(NamedTuple):
    """Normals that agree between neighbors. World frame."""

    directions: Float32[np.ndarray, "n 3"]
    """Unit, toward the outside."""
    sureness: Values
    """1 where neighbors lie in one plane, 0 where their axes point anywhere."""


def surface_normals(
    g: Gaussians, own: GaussianSurfaces, turn: Float64[np.ndarray, "3 3"], outward: Float[np.ndarray, "n 3"]
) -> SurfaceNormals:
    """Normals of Gaussians: the common one of the shortest axes of flat neighbors, on the side of `outward`.

    It is the first eigenvector of the mean of n n^T, since the shortest axis has no sign.
    """
    shortest = np.argmin(g.scales, axis=1)
    axes = np.take_along_axis(
        matrices_from_quaternions(g.quaternions.astype(np.float64)), shortest[:, None, None], axis=2
    )[:, :, 0]
    axes = (axes @ turn.T).astype(np.float32)
    sizes = np.sort(g.scales, axis=1)
    flat = ((1 - sizes[:, 0] / np.maximum(sizes[:, 1], 1e-9)) * g.opacities).astype(np.float32)
    tensor = np.empty((len(g), 3, 3), np.float32)
    for a in range(3):
        for b in range(a, 3):
            tensor[:, a, b] = tensor[:, b, a] = own.near.mean(axes[:, a] * axes[:, b], flat)
    values, vectors = np.linalg.eigh(tensor)
    normals = vectors[:, :, 2]
    normals = normals * np.where(np.sum(normals * outward, axis=1) < 0, -1, 1)[:, None]
    return SurfaceNormals(normals.astype(np.float32), smoothstep(*_SURE, values[:, 2]))


# Light

_ROUGH = 0.3
"""Cosine at surfaces without a known normal: 1/4 is the mean over all directions, and visible ones face outward."""
_SOLID = 0.05  # opacity from which a Gaussian hides lamps
_BOUNCE, _BOUNCE_RADIUS = 0.1, 0.7
"""Light that the ground below a lamp returns upwards, over the lamp's intensity, from a disk of this radius over the
lamp's height: 0.12 of the light in a cone of 55 degrees, over pi."""
_RAYS = 6  # directions to the sky besides the zenith
_RAY_RISE = 0.57  # sine of their elevation, 35 degrees
_NEAREST_M2 = 0.01  # least squared distance from a lamp


@dataclass(frozen=True, slots=True, eq=False)
class _Night:
    """Light of a night, and what it falls on."""

    surfaces: SceneSurfaces
    relative: dict[str, Colors]
    albedo: _Albedo
    grid: OpacityGrid
    lamps: tuple[Lamp, ...]
    """Those mounted on the scene."""
    lenses: dict[str, list[SignalLens]]
    """Lit lenses of members by key."""
    eyes: Float64[np.ndarray, "e 3"]
    middle: Float64[np.ndarray, "3"]

    @classmethod
    def over(
        cls,
        scene: Scene,
        surfaces: SceneSurfaces,
        core: SceneCore,
        lamps: Sequence[Lamp],
        lenses: dict[str, list[SignalLens]],
    ) -> "_Night":
        relative = {key: reflectances(own, surfaces.light) for key, own in surfaces.members.items()}
        return cls(
            surfaces, relative, _Albedo.of(surfaces, relative), _grid(scene, surfaces),
            tuple(lamp for lamp in lamps if lamp.mount == "scene"), lenses, viewpoints(scene), core.middle,
        )  # fmt: skip

    def colors(self, scene: Scene, member: Layer | Actor) -> tuple[Harmonics, Harmonics]:
        """Dry and soaked harmonics of a member by night."""
        own = self.surfaces.members.get(member.key)
        if own is None:
            painted = self.surfaces.sky.painted(scene, member, night_sky)
            return painted, painted
        sky, share = np.zeros_like(own.color), np.zeros(len(own.points), np.float32)
        if isinstance(member, Layer):
            sky, share = self.surfaces.sky.behind(member.key, own, self.surfaces.above_m(own), night_sky)
        light = self._light(scene, member, own)
        albedo = self.albedo.on(self.relative[member.key], own)
        soaked = _soaked(albedo, own)
        linear = srgb_to_linear(own.color).astype(np.float32)
        lit = lamp_share(linear, own.broad.mean, own.vehicles) * own.vehicles
        gloss = MEAN_REFLECTANCE * (own.vehicles * own.up_facing)[:, None] * NIGHT.sky
        emitted, found = lit[:, None] * linear, list[Harmonics]()
        for lens in self.lenses.get(member.key, ()):
            emitted[lens.rows] = LENS_LIGHT * lens.color
        for reflectance, mirrored in ((albedo, 0.0), (soaked, gloss)):
            color = NIGHT.display(light * reflectance + mirrored + emitted).astype(np.float32)
            color = color + share[:, None] * (sky - color)
            changed = changed_harmonics(member.gaussians.sh, own.color, color)
            matte = (own.ground > 0.5) | (share > 0.5)  # without the glare of the sun
            changed[matte] = 0
            changed[matte, 0] = (color[matte] - np.float32(0.5)) / np.float32(SH_C0)
            found.append(changed)
        return found[0], found[1]

    def _light(self, scene: Scene, member: Layer | Actor, own: GaussianSurfaces) -> Float32[np.ndarray, "n 3"]:
        """Light on each Gaussian: times its reflectance, it is the light that leaves it."""
        points, turn = own.points, np.eye(3)
        to_world = scene.scene_to_world @ member.to_scene if isinstance(member, Layer) else np.eye(4)
        if isinstance(member, Actor):
            pose = _pose(scene, member)
            points = (points @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)
            to_world, turn = pose, pose[:3, :3]
        own_turn = to_world[:3, :3] / np.cbrt(np.linalg.det(to_world[:3, :3]))
        outward = self._outward(points, own, turn if isinstance(member, Actor) else None)
        normals = surface_normals(member.gaussians, own, own_turn, outward)
        if isinstance(member, Layer) and self.surfaces.heights is not None:
            ground = own.ground[:, None]
            level = self.surfaces.heights.normals(points)
            mixed = normals.directions + ground * (level - normals.directions)
            mixed /= np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-6)
            sure = normals.sureness + own.ground * (1 - normals.sureness)
            normals = SurfaceNormals(mixed.astype(np.float32), sure.astype(np.float32))
        light = light_of_lamps(scene, self.lamps, points, normals, own.plants, self.grid, self.surfaces.heights)
        light += _light_of_sky(points, normals, self.grid)
        return np.stack([own.near.mean(light[:, k].astype(np.float32)) for k in range(3)], axis=1)

    def _outward(
        self, points: Float32[np.ndarray, "n 3"], own: GaussianSurfaces, turn: Float64[np.ndarray, "3 3"] | None
    ) -> Float64[np.ndarray, "n 3"]:
        """Vectors to the side from which surfaces were seen: to cameras of a drive, else out of the grid's opacity."""
        if turn is not None:
            return (own.points - own.points.mean(axis=0)) @ turn.T
        if len(self.eyes):
            nearest: Any = KDTree(self.eyes).query(points, workers=-1)[1]
            return self.eyes[nearest] - points
        steps = 1.5 * self.grid.cell_m * np.eye(3)
        rising = [self.grid.sampled(points + step) - self.grid.sampled(points - step) for step in steps]
        gradient = np.stack(rising, axis=1).astype(np.float64)
        away = (points - self.middle) / max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-6)
        return away * max(float(np.abs(gradient).mean()), 1e-9) - gradient


def _pose(scene: Scene, actor: Actor) -> Float64[np.ndarray, "4 4"]:
    """Pose of an actor in the world in the middle of its time, without scale."""
    times = actor.track.times[actor.track.valid]
    pose = actor.pose_at(float(times[len(times) // 2])) if len(times) else None
    if pose is None:
        return np.eye(4)
    placed = scene.scene_to_world @ pose
    placed[:3, :3] /= np.cbrt(np.linalg.det(placed[:3, :3]))
    return placed


def _grid(scene: Scene, surfaces: SceneSurfaces) -> OpacityGrid:
    """Opacity of all layers but ground and sky: ground does not hide lamps from itself."""
    places, areas, widths = [np.zeros((0, 3), np.float32)], [np.zeros(0, np.float32)], [np.zeros(0, np.float32)]
    for layer in scene.layers:
        own = surfaces.members.get(layer.key)
        if own is None or not layer.visible:
            continue
        _, sky = surfaces.sky.behind(layer.key, own, surfaces.above_m(own), night_sky)
        rows = (own.opacities > _SOLID) & (own.ground < 0.5) & (sky < 0.5) & np.isfinite(own.points).all(axis=1)
        if layer.marks.left_out is not None:
            rows &= ~layer.marks.left_out.flags
        places.append(own.points[rows])
        areas.append((2 * own.area_m2 * own.opacities)[rows].astype(np.float32))
        widths.append(np.sqrt(own.area_m2[rows] / np.pi).astype(np.float32))
    return OpacityGrid.of(*(np.concatenate(each) for each in (places, areas, widths)))


def light_of_lamps(
    scene: Scene,
    lamps: Sequence[Lamp],
    points: Float32[np.ndarray, "n 3"],
    normals: SurfaceNormals,
    plants: Values,
    grid: OpacityGrid,
    heights: GroundHeights | None,
) -> Float64[np.ndarray, "n 3"]:
    """Light of lamps that are mounted on a scene, on surfaces at points of the world: irradiance over pi.

    I cos / d^2 times the lamp's cone and what the opacity on the way leaves; and what the ground below returns.
    """
    total = np.zeros((len(points), 3))
    lit = lit_lamps([(lamp, scene.scene_to_world) for lamp in lamps])
    for place, axis, intensity, inner, outer in zip(*lit, strict=True):
        near = np.flatnonzero(np.sum((points - place) ** 2, axis=1) < LAMP_REACH_M**2)
        away = place - points[near].astype(np.float64)
        squared = np.maximum(np.sum(away**2, axis=1), _NEAREST_M2)
        away /= np.sqrt(squared)[:, None]
        own = normals.directions[near].astype(np.float64), normals.sureness[near], plants[near]
        part = np.clip((-(away @ axis) - outer) / max(inner - outer, 1e-6), 0, 1) if outer > -1 else np.ones(len(near))
        share = part * part * (3 - 2 * part) * _facing(away, *own) / squared
        reached = np.flatnonzero(share * intensity.max() > _FAINTEST)
        left = grid.transmittance(place, points[near[reached]])
        total[near[reached]] += (share[reached] * left)[:, None] * intensity / np.pi
        if heights is not None and outer > -1:
            total[near] += _returned(place, points[near], own, heights)[:, None] * intensity / np.pi
    return total


_FAINTEST = 1e-3  # irradiance that is neglected; pi makes a white wall display white


def _facing(
    away: Float64[np.ndarray, "n 3"], directions: Float64[np.ndarray, "n 3"], sureness: Values, plants: Values
) -> Float64[np.ndarray, " n"]:
    """Cosine law by how sure the normal is; leaves let light through."""
    cosine = np.sum(away * directions, axis=1)
    solid = _ROUGH + sureness * (np.maximum(cosine, 0) - _ROUGH)
    leaf = facing_share(cosine, np.ones(len(cosine), np.bool_))
    return solid + plants * (leaf - solid)


def _returned(
    lamp: Float64[np.ndarray, "3"],
    points: Float32[np.ndarray, "n 3"],
    own: tuple[Float64[np.ndarray, "n 3"], Values, Values],
    heights: GroundHeights,
) -> Float64[np.ndarray, " n"]:
    """Irradiance of the disk of ground below a lamp over the lamp's intensity."""
    foot = np.array([lamp[0], lamp[1], float(heights.sampled(heights.smooth_m, lamp[None])[0])])
    height = float(lamp[2] - foot[2])
    if not 0.5 < height < 30:
        return np.zeros(len(points))
    away = foot - points
    squared = np.sum(away**2, axis=1)
    away /= np.sqrt(squared + 1e-6)[:, None]
    return _BOUNCE * np.maximum(-away[:, 2], 0) * _facing(away, *own) / (squared + (_BOUNCE_RADIUS * height) ** 2)


def _light_of_sky(
    points: Float32[np.ndarray, "n 3"], normals: SurfaceNormals, grid: OpacityGrid
) -> Float64[np.ndarray, "n 3"]:
    """Light of the dark clouds that surfaces around leave, and of the city below."""
    turns = 2 * np.pi * np.arange(_RAYS) / _RAYS
    level = np.sqrt(1 - _RAY_RISE**2)
    ways = [(0.0, 0.0, 1.0), *((level * np.cos(t), level * np.sin(t), _RAY_RISE) for t in turns)]
    open_sky = grid.openness(points, ways).mean(axis=1)
    tilt = normals.directions[:, 2] * normals.sureness
    above, below = open_sky * overcast_share(tilt), 0.5 - 0.5 * tilt
    return above[:, None] * NIGHT.sky + (open_sky * below)[:, None] * NIGHT.ground


def _soaked(albedo: Colors, own: GaussianSurfaces) -> Colors:
    """Reflectance of soaked surfaces."""
    found, settings = np.empty_like(albedo), WetSettings()
    for first in range(0, len(found), BLOCK):
        rows = slice(first, first + BLOCK)
        wet = wet_surfaces_color((albedo[None, rows] / WHITE).astype(np.float32), row_of(own, rows), settings)
        found[rows] = WHITE * wet[0]
    return found


# Sky

_DOME_GAUSSIANS, _DOME_M, _DOME_RADII = 6000, 400.0, 30.0
_BELOW_HORIZON, _LAND = (-0.3, 0.02), 0.1
"""Ramp of the rise of directions from dark land to the sky, and the light of that land relative to the horizon's."""


def night_sky(directions: Float64[np.ndarray, "n 3"]) -> Colors:
    """Display color of a city's cloudy night sky in unit directions."""
    return NIGHT.sky_display(directions, np.array([0.0, 0.0, 1.0]), 0).astype(np.float32)


def _dome(scene: Scene, core: SceneCore) -> Layer:
    """Sky all around a scene that has none, dark below the horizon."""
    directions = dome_directions(_DOME_GAUSSIANS)
    radius = max(_DOME_M, _DOME_RADII * core.radius_m)
    land = _LAND + (1 - _LAND) * smoothstep(*_BELOW_HORIZON, directions[:, 2])
    gaussians = dome_gaussians(directions, night_sky(directions) * land[:, None], core.middle, radius)
    return Layer("sky", gaussians, "sky", np.linalg.inv(scene.scene_to_world))
