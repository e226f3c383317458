"""Wet surfaces of the street under clouds: darker albedo, puddles, and what the wet ground reflects."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float32, Float64

from gsrain_engine.scene.gaussians import sh_basis
from gsrain_engine.scene.ground_water import FILM_SLOPE, STANDING_SLOPE
from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.noise import lattice_noise, layered_noise, smooth_noise
from gsrain_engine.scene.water_surface import WATER_INDEX, reflectance, unshadowed, wet_albedo

from .layout import CURB_HEIGHT_M, StreetLayout
from .lighting import Illumination
from .mesh import Quads
from .reflections import Surroundings

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
    return _standing(_water_depth(layout, points))


def water_shares(
    layout: StreetLayout, points: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Shares of the ground that a film and standing water (`puddles`) cover, 0..1.

    The film is in patches, more of it near puddles, with grain.
    """
    depth, seed = _water_depth(layout, points), layout.parameters.seed
    standing = _standing(depth)
    patches = layered_noise(points[:, :2], (2.6, 0.8), seed + 411, 4) - 0.5
    grain = lattice_noise(np.floor(points * 50).astype(np.int64), seed + 412) - 0.5
    thick = np.clip(0.36 + 2.0 * patches + 1.8 * (depth - 0.5) + 0.22 * grain, 0, 1)
    thin, full = _FILM_COVER
    return (1 - standing) * (thin + (full - thin) * thick), standing


def _standing(depth: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    edge = np.clip((depth - 0.61) / 0.05, 0, 1)
    return edge * edge * (3 - 2 * edge)


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
_CHUNK = 1000  # points whose surroundings fit into the processor's cache


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
    azimuths, rises = _azimuths()[0], np.radians(_RISES_DEG).astype(np.float32)
    around = Surroundings.of(light, rises)
    points = quads.centers[ground].astype(np.float64)
    film, standing = (each.astype(np.float32) for each in water_shares(layout, points))
    diffuse = (arriving[ground] * quads.albedo[ground]).astype(np.float32)
    diffuse *= (1 - standing * (1 - _THROUGH_PUDDLE))[:, None]
    weights = [_facet_weights(slope) for slope in (FILM_SLOPE, STANDING_SLOPE)]
    film_reflects, pool_reflects = (np.tile(each.sum(axis=1), len(azimuths)) for each in weights)
    fit = np.ascontiguousarray(_fit().T)
    for first in range(0, len(ground), _CHUNK):
        own = slice(first, first + _CHUNK)
        cover, pool = film[own, None], standing[own, None]
        arrives = around.light_around(points[own], azimuths, rises)
        seen, from_pool = (
            np.matmul(arrives.reshape(len(arrives), -1, len(rises)), each.T).reshape(len(arrives), 3, -1)
            for each in weights  # a product for each point: BLAS shares larger ones among threads, at more time in all
        )
        seen *= cover[:, None]
        from_pool *= pool[:, None]
        seen += from_pool
        seen += (1 - cover * film_reflects - pool * pool_reflects)[:, None] * diffuse[own, :, None]
        fitted = np.matmul(light.lighting.display(seen) - np.float32(0.5), fit)
        sh[ground[own]] = fitted.transpose(0, 2, 1)
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
