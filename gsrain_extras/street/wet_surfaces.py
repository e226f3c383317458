"""Wet surfaces of the street under clouds: darker albedo, puddles, and what the wet ground reflects."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from gsrain_engine.scene.gaussians import sh_basis
from gsrain_engine.scene.ground_water import FILM_SLOPE, STANDING_SLOPE
from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.noise import lattice_noise, layered_noise, smooth_noise
from gsrain_engine.scene.skies import OVERCAST_ZENITH, overcast_luminance
from gsrain_engine.scene.water_surface import WATER_INDEX, reflectance, unshadowed, wet_albedo

from .buses import BUS_FORM
from .cars import CAR_FORMS, TRUCK_FORM
from .layout import CURB_HEIGHT_M, Color, House, StreetLayout
from .lighting import Illumination
from .mesh import Quads, panel
from .vegetation import crown_middle

# Materials

_SOAKED = {
    Label.ROAD: 1.0, Label.LANE_MARKING: 0.55, Label.PAVEMENT: 0.9, Label.TERRAIN: 0.8, Label.VEGETATION: 0.75,
    Label.PERSON: 0.5,
}  # fmt: skip
"""Share of the darkening of a soaked porous surface, by class; paint, metal and glass hold no water in them."""
_SOAKED_ROOF, _SOAKED_WALL = 0.95, 0.55
_SOAKED_LEAF, _GREENER = 0.55, 0.12
"""Leaves hold water on them; a film scatters less white light than their wax and dust, so that they get greener."""
_WALL_FOOT_M = 0.7  # height up to which splashes soak a wall
_WETTER_GLOSS = 1.3
_LAMP = 9.0  # light of a tail lamp, relative to what the dark lamp reflects


def wet_materials(quads: Quads, *, with_lamps: bool = False) -> Quads:
    """Quads with the albedo and gloss that they have when soaked; `with_lamps` lights red lamps, as drivers do."""
    soaked = np.zeros(len(quads))
    for label, share in _SOAKED.items():
        soaked[quads.labels == label] = share
    houses = np.flatnonzero(quads.labels == Label.BUILDING)
    soaked[houses] = _soaking_of_houses(quads.take(houses))
    leaf = (quads.labels == Label.VEGETATION) & (quads.albedo[:, 1] > 1.05 * quads.albedo[:, 0])
    soaked = np.where(leaf, _SOAKED_LEAF, soaked)[:, None]
    dry = quads.albedo.astype(np.float64)
    wet = dry + soaked * (wet_albedo(dry) - dry)
    gray = wet.mean(axis=1, keepdims=True)
    wet = np.where(leaf[:, None], np.maximum(wet + _GREENER * (wet - gray), 0), wet)
    if with_lamps:
        red = np.isin(quads.labels, (Label.CAR, Label.TRUCK, Label.BUS)) & (dry[:, 0] > 0.25) & (dry[:, 1] < 0.01)
        wet = np.where(red[:, None], _LAMP * dry, wet)
    return replace(quads, albedo=wet.astype(np.float32), gloss=np.minimum(_WETTER_GLOSS * quads.gloss, 0.9))


def _soaking_of_houses(quads: Quads) -> Float64[np.ndarray, " n"]:
    """Roofs are soaked; walls in streaks from above, and at their foot; glass and doors not at all."""
    center, rise = quads.centers.astype(np.float64), quads.normals[:, 2]
    along = center[:, :2] @ np.array([0.83, 0.77])
    streaks = smooth_noise(np.stack([along, center[:, 2]], axis=1), (0.55, 7.0), 311)
    broad = smooth_noise(np.stack([along, center[:, 2]], axis=1), (3.1, 4.5), 312)
    foot = np.exp(-np.maximum(center[:, 2] - CURB_HEIGHT_M, 0) / _WALL_FOOT_M)
    wall = np.clip(_SOAKED_WALL + 0.5 * (0.5 * streaks + 0.5 * broad - 0.5) + 0.4 * foot, 0, 1)
    share = np.where(rise > 0.3, _SOAKED_ROOF, wall)
    return np.where(quads.gloss > 0.03, 0.0, share)


# Water on the ground

_FILM_COVER = (0.03, 0.85)
"""Share of the road that a thin and a thick film cover: stones stick out of it."""
_THROUGH_PUDDLE = 0.62  # share of the ground's own light that leaves standing water
_TRACK_M, _TRACK_WIDTH_M = 0.75, 0.24  # of wheel tracks, from the middle of a lane


def reflecting(quads: Quads) -> Bool[np.ndarray, " n"]:
    """Mask of level ground, which holds a film of water; shadows on it are not ground."""
    ground = np.isin(quads.labels, (Label.ROAD, Label.LANE_MARKING, Label.PAVEMENT))
    return ground & (quads.normals[:, 2] > 0.9) & (quads.opacity > 0.9)


def puddles(layout: StreetLayout, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Share of standing water, 0..1: in hollows of wheel tracks, along curbs, and here and there on the pavement."""
    edge = np.clip((_water_depth(layout, points) - 0.61) / 0.05, 0, 1)
    return edge * edge * (3 - 2 * edge)


def film_cover(layout: StreetLayout, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Share of the ground that a film covers, 0..1: patches, more of it near puddles, with grain."""
    seed, flat = layout.parameters.seed, points[:, :2]
    patches = layered_noise(flat, (2.6, 0.8), seed + 411, 4) - 0.5
    grain = lattice_noise(np.floor(points * 50).astype(np.int64), seed + 412) - 0.5
    thick = np.clip(0.36 + 2.0 * patches + 1.8 * (_water_depth(layout, points) - 0.5) + 0.22 * grain, 0, 1)
    thin, full = _FILM_COVER
    return thin + (full - thin) * thick


def _water_depth(layout: StreetLayout, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Relative depth of water on the ground, about 0.5 on average."""
    p = layout.parameters
    x, y = points[:, 0], points[:, 1]
    from_lane = np.abs(np.abs(y) - 0.5 * p.lane_width_m)
    track = np.exp(-(((from_lane - _TRACK_M) / _TRACK_WIDTH_M) ** 2))
    gutter = np.exp(-np.maximum(p.curb_y_m - np.abs(y), 0) / 0.22) * (np.abs(y) < p.curb_y_m)
    long = layered_noise(np.stack([x, y], axis=1), (5.2, 1.1), p.seed + 401, 3)
    fine = smooth_noise(np.stack([x, y], axis=1), (0.9, 0.35), p.seed + 402)
    return long + 0.12 * (fine - 0.5) + 0.13 * track * (np.abs(y) < p.lane_width_m) + 0.18 * gutter


# Harmonics

GROUND_COEFFICIENTS = 16
"""Harmonics of wet ground, whose reflections change quickly with the viewing direction."""
_CHUNK = 6000


def wet_harmonics(
    quads: Quads,
    light: Illumination,
    coefficients: int,
    matte: Float32[np.ndarray, "n k 3"],
    arriving: Float64[np.ndarray, "n 3"],
) -> Float32[np.ndarray, "n k 3"]:
    """Add reflections of wet ground to harmonics of soaked quads without them, `matte`, in the light on them."""
    sh = matte
    layout, ground = light.layout, np.flatnonzero(reflecting(quads))
    if layout is None or coefficients < GROUND_COEFFICIENTS or not len(ground):
        return sh
    fronts = FrontLight.of(light) if light.lighting.lamps else None
    for first in range(0, len(ground), _CHUNK):
        own = ground[first : first + _CHUNK]
        part = quads.take(own)
        points = part.centers.astype(np.float64)
        diffuse = (arriving[own] * part.albedo).astype(np.float32)[:, None]
        standing = puddles(layout, points).astype(np.float32)[:, None, None]
        around = _surroundings(light, points, fronts)
        film, film_share = _reflected(around, FILM_SLOPE)
        pool, pool_share = _reflected(around, STANDING_SLOPE)
        cover = (1 - standing) * film_cover(layout, points).astype(np.float32)[:, None, None]
        share = cover * film_share + standing * pool_share
        through = 1 - standing * (1 - _THROUGH_PUDDLE)
        seen = (1 - share) * through * diffuse + cover * film + standing * pool
        sh[own] = np.matmul(_fit(), light.lighting.display(seen) - np.float32(0.5))
    return sh


# Viewing directions that are fitted: those of vehicles on the street first, which look along it at small angles.
_TURNS_DEG = np.array([0.0, 6, 13, 22, 34, 52, 76])
_TURN_WEIGHTS = np.array([1.0, 1.0, 0.9, 0.7, 0.5, 0.35, 0.25])
_DROPS = np.array([0.02, 0.045, 0.08, 0.13, 0.2, 0.32, 0.55, 0.95])
_DROP_WEIGHTS = np.array([0.8, 1.0, 1.0, 1.0, 1.0, 0.9, 0.6, 0.3])
_RISES_DEG = np.array([0.7, 2.2, 4.5, 7.5, 11.5, 17, 26, 40, 62])
_SMOOTHING = 2e-3


@lru_cache(maxsize=1)
def _azimuths() -> tuple[Float32[np.ndarray, " a"], Float32[np.ndarray, " a"]]:
    """Azimuths of viewing directions in radians, and their weights."""
    ahead = np.concatenate([-_TURNS_DEG[:0:-1], _TURNS_DEG])
    weights = np.concatenate([_TURN_WEIGHTS[:0:-1], _TURN_WEIGHTS])
    return np.radians(np.concatenate([ahead, ahead + 180])).astype(np.float32), np.tile(weights, 2).astype(np.float32)


@lru_cache(maxsize=1)
def _fit() -> Float32[np.ndarray, "k s"]:
    """Linear map from display colors in all viewing directions (eye to ground) to harmonics."""
    azimuths, weights = _azimuths()
    level = np.sqrt(1 - _DROPS**2)
    directions = np.stack(
        np.broadcast_arrays(
            np.cos(azimuths)[:, None] * level, np.sin(azimuths)[:, None] * level, np.broadcast_to(-_DROPS, (1, 8))
        ),
        axis=2,
    ).reshape(-1, 3)
    basis = sh_basis(directions.astype(np.float64), GROUND_COEFFICIENTS)
    weight = (weights[:, None] * _DROP_WEIGHTS).reshape(-1, 1)
    degree = np.repeat(np.arange(4), 2 * np.arange(4) + 1)
    damped = (basis * weight).T @ basis + _SMOOTHING * weight.sum() * np.diag(degree.astype(float) ** 2) / (4 * np.pi)
    return np.linalg.solve(damped, (basis * weight).T).astype(np.float32)


def _reflected(
    around: Float32[np.ndarray, "n a e 3"], slope: float
) -> tuple[Float32[np.ndarray, "n s 3"], Float32[np.ndarray, "1 s 1"]]:
    """Light that rough water reflects in the fitted directions, and the share of light that it reflects."""
    weights = _facet_weights(slope)
    share = np.tile(weights.sum(axis=1), around.shape[1])
    return np.matmul(weights, around).reshape(len(around), -1, 3), share[None, :, None].astype(np.float32)


@lru_cache(maxsize=4)
def _facet_weights(slope: float) -> Float32[np.ndarray, "d e"]:
    """Share of light from each elevation that water with Gaussian slopes reflects in each viewing direction.

    Facets that tilt along the line of sight, weighted by their visible area, with Fresnel's law and Smith's shadowing
    of both rays. A ray that goes down again meets the ground, and is lost.
    """
    weights = np.zeros((len(_DROPS), len(_RISES_DEG)))
    tilts = np.linspace(-3, 3, 49)
    density = np.exp(-0.5 * tilts**2)
    for row, drop in enumerate(_DROPS):
        view, total, found = np.arcsin(drop), 0.0, np.zeros(len(_RISES_DEG))
        for tilt, part in zip(np.arctan(slope * tilts), density, strict=True):
            cosine = np.sin(view + tilt)
            if cosine <= 0:
                continue
            visible = part * cosine / np.cos(tilt)
            total += visible
            rise = view + 2 * tilt
            if rise > 0:
                gain = visible * reflectance(cosine, WATER_INDEX) * unshadowed(np.sin(min(rise, np.pi / 2)), slope)
                at = np.interp(np.degrees(rise), _RISES_DEG, np.arange(len(_RISES_DEG)))
                low = min(int(at), len(_RISES_DEG) - 2)
                found[low] += gain * (low + 1 - at)
                found[low + 1] += gain * (at - low)
        weights[row] = found / total
    return weights.astype(np.float32)


# What is around a point of the ground: walls, crowns and vehicles by azimuth and elevation

_WALL_LIGHT, _VEHICLE_LIGHT, _LEAF_LIGHT = 0.30, 0.34, 0.30
"""Light on walls, vehicles and leaves in the street, relative to the open sky on level ground."""
_GLASS = 0.10  # light of the sky that the windows of a wall reflect, relative to the zenith
_LEAF: Color = (0.05, 0.11, 0.018)
_NEAR_M = 45.0  # maximum distance of trees and vehicles that are reflected


def _surroundings(
    light_of: Illumination, points: Float64[np.ndarray, "n 3"], fronts: "FrontLight | None"
) -> Float32[np.ndarray, "n a e 3"]:
    """Light that arrives at points of the ground, by azimuth and elevation; by night with `fronts`."""
    layout = light_of.layout
    assert layout is not None
    azimuths, _ = _azimuths()
    c, s = np.cos(azimuths)[None], np.sin(azimuths)[None]
    p = points.astype(np.float32)
    rises = np.radians(_RISES_DEG).astype(np.float32)
    top, wall, reach = _houses(layout, p, c, s)
    if fronts is None:
        sky = (OVERCAST_ZENITH * overcast_luminance(np.sin(rises))).astype(np.float32)[:, None]
        wall, dim = wall[:, :, None], np.float32(1)
    else:
        assert light_of.lighting.reflected_sky is not None and light_of.lighting.reflected_dim is not None
        sky, dim = (np.float32(each) for each in (light_of.lighting.reflected_sky, light_of.lighting.reflected_dim))
        wall = fronts.at(p, c, s, reach, rises)
    covered = np.clip((top[..., None] - rises) / np.radians(1.5) + 0.5, 0, 1)[..., None].astype(np.float32)
    light = covered * wall + (1 - covered) * sky
    for tree in layout.trees:
        middle, half = crown_middle(tree)
        near = np.flatnonzero(np.abs(p[:, 0] - tree.x) < _NEAR_M)
        away = p[near, :2] - np.array([tree.x, tree.y], np.float32)
        along, aside = -(away[:, :1] * c + away[:, 1:] * s), np.abs(away[:, :1] * s - away[:, 1:] * c)
        i, k = np.nonzero((along > 0.3) & (aside < tree.radius) & (along < reach[near]))
        if not len(i):
            continue
        h, t = half * np.sqrt(1 - (aside[i, k] / tree.radius) ** 2), along[i, k]
        low, high = np.arctan2(middle - h, t)[:, None], np.arctan2(middle + h, t)[:, None]
        inside = np.clip((rises - low) / 0.05 + 0.5, 0, 1) * np.clip((high - rises) / 0.05 + 0.5, 0, 1)
        _cover(light, near[i], k, 0.85 * inside, dim * _lit(_LEAF, _LEAF_LIGHT))
    for box in _vehicles(layout):
        near = np.flatnonzero(np.abs(p[:, 0] - box[0]) < _NEAR_M)
        t0, t1 = _crossed(p[near], c, s, *box[:4])
        i, k = np.nonzero((t1 > np.maximum(t0, 0)) & (t0 < reach[near]))
        if not len(i):
            continue
        top_of_it = np.arctan2(np.float32(box[4]), np.maximum(t0[i, k], 0.05))[:, None]
        inside = np.clip((top_of_it - rises) / 0.03 + 0.5, 0, 1)
        _cover(
            light, near[i], k, 0.95 * inside, dim * (_lit(box[5], _VEHICLE_LIGHT) + np.float32(0.04 * OVERCAST_ZENITH))
        )
    return light


# By night: fronts by lanterns and lit rooms

_FRONT_CELL_M = 0.75
_FRONT_ROWS = 18
_END_LIGHT = np.array([0.022, 0.016, 0.010], np.float32)  # of the houses across both ends, with their windows


@dataclass(frozen=True, slots=True, eq=False)
class FrontLight:
    """Light of the house fronts on both sides by night, in cells along the street and upwards."""

    start_x_m: float
    cells: Float32[np.ndarray, "side nx nz 3"]
    """Left side first."""

    @classmethod
    def of(cls, light: Illumination) -> "FrontLight":
        """Light walls of each house's color as the street's are, and add its lit rooms."""
        layout, windows = light.layout, light.windows
        assert layout is not None and windows is not None
        a = layout.parameters
        count = int(np.ceil(a.length_m / _FRONT_CELL_M))
        x, z = a.start_x_m + _FRONT_CELL_M * np.arange(count + 1), _FRONT_CELL_M * np.arange(_FRONT_ROWS + 1)
        cells = np.zeros((2, count, _FRONT_ROWS, 3))
        for k, (row, side) in enumerate(((layout.left, 1), (layout.right, -1))):
            wall = panel((0, side * a.front_y_m, 0), (1, 0, 0), (0, 0, 1), x, z, 1.0, Label.BUILDING)
            wall = replace(wall, normals=np.full_like(wall.normals, [0, -side, 0]))
            starts = np.array([house.origin[0] - (house.width if side < 0 else 0) for house in row])
            house = np.clip(np.searchsorted(starts, wall.centers[:, 0], side="right") - 1, 0, len(row) - 1)
            albedo = np.array([wet_albedo(np.array(each.color)) for each in row])[house]
            lit = 0.85 * albedo * light.light_on(wall, wall.centers)
            cells[k] = lit.reshape(count, _FRONT_ROWS, 3)
            own = np.flatnonzero(side * windows.centers[:, 1] > a.front_y_m - 0.5)
            own = own[np.abs(windows.normals[own, 1]) > 0.5]
            i = np.clip(((windows.centers[own, 0] - a.start_x_m) / _FRONT_CELL_M).astype(int), 1, count - 2)
            j = np.clip((windows.centers[own, 2] / _FRONT_CELL_M).astype(int), 1, _FRONT_ROWS - 2)
            for di in (-1, 0, 1):  # over 2.25 m, about the size of a shop window
                for dj in (-1, 0, 1):
                    np.add.at(cells[k], (i + di, j + dj), windows.intensities[own] / (9 * _FRONT_CELL_M**2))
        return cls(a.start_x_m, cells.astype(np.float32))

    def at(
        self,
        p: Float32[np.ndarray, "n 3"],
        c: Float32[np.ndarray, "1 a"],
        s: Float32[np.ndarray, "1 a"],
        reach: Float32[np.ndarray, "n a"],
        rises: Float32[np.ndarray, " e"],
    ) -> Float32[np.ndarray, "n a e 3"]:
        """Light of the wall that ends the view from points in each azimuth (`reach` meters away) and elevation."""
        x, y = p[:, :1] + reach * c, p[:, 1:2] + reach * s
        i = np.floor((x - self.start_x_m) / _FRONT_CELL_M).astype(np.int64)
        is_front = (i >= 0) & (i < self.cells.shape[1])
        j = np.floor(reach[..., None] * np.tan(rises) / _FRONT_CELL_M).astype(np.int64)
        side = np.broadcast_to((y < 0)[..., None], j.shape).astype(np.int64)
        i = np.broadcast_to(np.clip(i, 0, self.cells.shape[1] - 1)[..., None], j.shape)
        found = self.cells[side, i, np.clip(j, 0, _FRONT_ROWS - 1)]
        return np.where(is_front[..., None, None], found, _END_LIGHT)


def _cover(
    light: Float32[np.ndarray, "n a e 3"],
    i: np.ndarray,
    k: np.ndarray,
    share: Float[np.ndarray, "m e"],
    color: Float32[np.ndarray, "3"],
) -> None:
    light[i, k] += share[..., None].astype(np.float32) * (color - light[i, k])


def _lit(albedo: Color, light: float) -> Float32[np.ndarray, "3"]:
    return np.float32(light * 7 / 9 * OVERCAST_ZENITH) * np.array(albedo, np.float32)


def _houses(
    layout: StreetLayout,
    p: Float32[np.ndarray, "n 3"],
    c: Float32[np.ndarray, "1 a"],
    s: Float32[np.ndarray, "1 a"],
) -> tuple[Float32[np.ndarray, "n a"], Float32[np.ndarray, "n a 3"], Float32[np.ndarray, "n a"]]:
    """Elevation of the eaves that end the view in each azimuth, light of the wall below, and its distance."""
    a = layout.parameters
    end_x = np.where(c > 0, a.end_x_m + 13.0, a.start_x_m - 13.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(np.abs(c) > 1e-4, (end_x - p[:, :1]) / c, np.float32(1e4)).astype(np.float32)
        to_front = np.where(np.abs(s) > 1e-4, (np.sign(s) * a.front_y_m - p[:, 1:2]) / s, np.float32(1e4))
    reach = np.where(reach > 0, reach, 60.0).astype(np.float32)
    height = np.full(reach.shape, 13.0, np.float32)
    color = np.broadcast_to(_wall_light(layout.ends), (*reach.shape, 3)).copy()
    x = p[:, :1] + to_front * c
    for row, side in ((layout.left, 1), (layout.right, -1)):
        starts = np.array([house.origin[0] - (house.width if side < 0 else 0) for house in row])
        stop = starts[-1] + row[-1].width
        met = (np.sign(s) == side) & (to_front > 0) & (to_front < reach) & (x >= starts[0]) & (x < stop)
        index = np.clip(np.searchsorted(starts, x[met], side="right") - 1, 0, len(row) - 1)
        height[met] = np.array([h.eaves + 0.3 * (h.ridge - h.eaves) for h in row], np.float32)[index]
        color[met] = np.array([_wall_light((h,)) for h in row], np.float32)[index]
        reach = np.where(met, to_front, reach).astype(np.float32)
    return np.arctan2(height, reach), color.astype(np.float32), reach


def _wall_light(houses: tuple[House, ...]) -> Float32[np.ndarray, "3"]:
    colors = np.mean([wet_albedo(np.array(house.color)) for house in houses], axis=0)
    light: Color = (float(colors[0]), float(colors[1]), float(colors[2]))
    return np.float32(0.8) * _lit(light, _WALL_LIGHT) + np.float32(_GLASS * OVERCAST_ZENITH * 0.4)


def _vehicles(layout: StreetLayout) -> Iterator[tuple[float, float, float, float, float, Color]]:
    """Boxes of parked vehicles: middle, half length and width, height (m), and paint."""
    for car in layout.cars:
        form = CAR_FORMS[car.shape]
        yield car.x, car.y, 0.5 * form.length, 0.5 * form.width, form.height, car.paint
    for truck in layout.trucks:
        yield truck.x, truck.y, 0.5 * TRUCK_FORM.length, 0.5 * TRUCK_FORM.width, TRUCK_FORM.height, truck.body
    for bus in layout.buses:
        yield bus.x, bus.y, 0.5 * BUS_FORM.length, 0.5 * BUS_FORM.width, BUS_FORM.height, bus.paint


def _crossed(
    p: Float32[np.ndarray, "n 3"],
    c: Float32[np.ndarray, "1 a"],
    s: Float32[np.ndarray, "1 a"],
    x: float,
    y: float,
    half_length: float,
    half_width: float,
) -> tuple[Float32[np.ndarray, "n a"], Float32[np.ndarray, "n a"]]:
    """Distances at which level rays enter and leave a box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        xa, xb = ((x + side * half_length - p[:, :1]) / c for side in (-1, 1))
        ya, yb = ((y + side * half_width - p[:, 1:2]) / s for side in (-1, 1))
    enter = np.fmax(np.fmin(xa, xb), np.fmin(ya, yb))
    leave = np.fmin(np.fmax(xa, xb), np.fmax(ya, yb))
    return enter.astype(np.float32), leave.astype(np.float32)
