"""Spray: the water that tires throw from a wet road, as parcels of drops in the wake behind each vehicle.

Parcels leave the tires at fixed places of a lattice in time, along the past track of each vehicle. Their places, sizes
and floating shares later are closed forms of their age, so that any frame can be computed alone
(docs/physics/spray.md).
"""

import math
import zlib
from collections.abc import Sequence
from functools import cache
from itertools import product
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Float64, Int64
from scipy.special import ndtr, ndtri

from ..kernels import kernel, range_of
from ..rain.air import GRAVITY_M_S2, profile
from ..rain.frame import RainFrame
from ..rain.lamp_light import light_of_drops
from ..rain.pcg_hash import pcg4d
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..rain.wetness import TEXTURE_DEPTH_MM
from ..scene.gaussians import Gaussians, IdentityKey, scene_cache, sh_from_color
from ..scene.geometry import linear_to_srgb, matrices_from_quaternions
from ..scene.objects import coco_class, is_vehicle
from ..scene.scene import PoseTrack, Scene
from .films import WaterFilms, flooded_share

STILL_M_S, FULL_M_S = 40 / 3.6, 60 / 3.6
"""Speeds below which a tire lets water flow aside, and from which it throws all that it displaces."""

STEP_S = 0.02  # of the lattice of emissions
LONGEST_S, FADE_S = 3.0, 0.8  # age that parcels reach, and the end of it in which they fade

GROOVE_M = 0.008  # width of a tread's grooves, in the Weber number
_SURFACE_N_M, _WATER_KG_M3, _AIR_KG_M3, _AIR_PA_S = 0.0728, 998.0, 1.2, 1.8e-5
WEBER, WEBER_MEAN_MM = 2700.0, 0.8
"""Mean diameter of drops from a groove at a Weber number; falls with the root of that (Radovich and Plocher 2009)."""

SPREAD = 0.6  # standard deviation of ln D
_SMALLEST_MM, _LARGEST_MM = 0.05, 2.0
MASS_SHARES = (0.08, 0.17, 0.25, 0.5)
"""Shares of the mass in the classes of drop sizes, from fine to coarse."""

GUARD_DEG = 25.0  # steepest angle of drops that leave a tire below the edge of the mudguard or wheel arch

WAKE_DRAG, WAKE_SIDE, WAKE_UP, WAKE_RISE = 0.4, 0.16, 0.12, 0.1
"""Of a wake, in units of L = sqrt(width x height): initial speed over that of the vehicle, standard deviations of the
plume of a tire across and up at its origin, and its rise by each doubling of the growth; ours."""

OWN, APART = 0.6, 0.8  # standard deviations of a parcel, and of the places of parcels, in those of the plume
SWIRL_S = 0.7  # time in which a parcel turns by one radian around the middle of the plume
DRIFT_HEIGHT_M = 1.0  # at which wind carries spray
MERGED_S, MERGE_S = (0.5, 1.2), 0.4
"""Ages from which parcels of two neighboring cells merge to one, and the time that it takes."""

LOWEST_M = 2.5
"""Fall, in m, after which nothing of a class of drops floats any more."""

LIGHT = 0.55
"""Light of spray over the mean of the sky: half of what its drops refract forward is sky, half a wet road; ours."""

LEAST_ALPHA = 5e-4
_NOTHING = 1e-3  # floating share of a parcel that is left out

HEAVY_M = 2.8  # height above which a vehicle is a truck or a bus, whatever its class

EGO_SIZE_LWH, EGO_AXLE_M = (4.6, 1.85, 1.5), 1.5
"""Size of the ego vehicle in a scene, and height of its rig over the ground under the rear axle, in meters."""


class Wheels(NamedTuple):
    """Axles and tracks of a vehicle."""

    axles_m: tuple[float, ...]
    """Places of the axles, from its center forward."""
    axle_shares: tuple[float, ...]
    """Shares of the displaced water that each throws: what one has thrown the next can't."""
    tracks_m: tuple[float, ...]
    """Places of the tracks, from its center to the left."""
    width_m: float
    """Width of the tires of one track."""


class VehicleMotion(NamedTuple):
    """Past motion of one vehicle at the edges of the cells of the lattice. World frame, meters."""

    name: str
    size_lwh_m: tuple[float, float, float]
    wheels: Wheels
    positions_m: Float64[np.ndarray, "n 3"]
    """Bottom center."""
    forward: Float64[np.ndarray, "n 2"]
    """Horizontal heading, unit."""
    is_there: Bool[np.ndarray, " n"]


class SprayParcels(NamedTuple):
    """Parcels of floating drops at one time, each an isotropic Gaussian cloud. World frame, meters."""

    centers_m: Float64[np.ndarray, "n 3"]
    sigmas_m: Float64[np.ndarray, " n"]
    extinction_m2: Float64[np.ndarray, " n"]
    """Extinction cross-section: twice that of its drops."""
    masses_kg: Float64[np.ndarray, " n"]
    """Of the drops that float."""
    diameters_mm: Float64[np.ndarray, " n"]
    velocities_m_s: Float64[np.ndarray, "n 3"]

    def __len__(self) -> int:
        return len(self.sigmas_m)

    @classmethod
    def none(cls) -> "SprayParcels":
        zeros = np.zeros(0)
        return cls(np.zeros((0, 3)), zeros, zeros, zeros, zeros, np.zeros((0, 3)))


def spray_parcels(scene: Scene, rain: RainSettings, film_mm: float, time_s: float) -> SprayParcels:
    """Floating spray of all vehicles of a scene at a time: actors with tracks, and the ego vehicle.

    `film_mm` is the depth of the water that tires displace; `rain` gives wind and seed. What the ego's front wheels
    throw stays under it: all of its spray leaves the rear wheels.
    """
    cells = np.arange(int(np.floor((time_s - LONGEST_S) / STEP_S)), int(np.floor(time_s / STEP_S)) + 2)
    edges_s = np.minimum(cells * STEP_S, time_s)
    found: list[SprayParcels] = []
    for vehicle in vehicle_motions(scene, edges_s):
        emitted = emissions_of(vehicle, cells, edges_s, film_mm, rain.seed, time_s)
        if emitted is not None:
            found.append(_parcels(emitted, vehicle.size_lwh_m, rain))
    return SprayParcels(*(np.concatenate(column) for column in zip(SprayParcels.none(), *found, strict=True)))


def spray_of(scene: Scene, rainfall: RainSimulation, time_s: float) -> SprayParcels:
    """Spray in a scene at a time: of wet colors, while it rains, if the rain has `spray`; the last ones are cached."""
    return _spray_of(IdentityKey(scene), IdentityKey(rainfall), time_s)


@scene_cache(maxsize=4)
def _spray_of(scene_key: IdentityKey, rainfall_key: IdentityKey, time_s: float) -> SprayParcels:
    scene: Scene = scene_key.of  # pyright: ignore[reportAssignmentType]
    rainfall: RainSimulation = rainfall_key.of  # pyright: ignore[reportAssignmentType]
    now = rainfall.frozen_at(time_s).rain
    is_dry = now.intensity_mm_h == 0 or not scene.has_rainy_light or rainfall.wetness_at(time_s) <= 0
    if is_dry or not rainfall.rain.spray:
        return SprayParcels.none()
    film_mm = WaterFilms.of(rainfall, scene.water).at(time_s).film_mm
    return spray_parcels(scene, now, displaced_mm(film_mm), time_s)


def displaced_mm(film_mm: float) -> float:
    """Depth in mm of the water that tires displace, from the mean depth of a film: what stands over the texture.

    The mean of max(h - depth of the texture, 0) with the distribution of `flooded_share`. Dips in the tracks of tires
    hold no more: traffic empties them.
    """
    sigma = TEXTURE_DEPTH_MM / 2
    above = (film_mm - TEXTURE_DEPTH_MM) / sigma
    return sigma * (math.exp(-above * above / 2) / math.sqrt(2 * math.pi) + above * flooded_share(film_mm))


# Vehicles


def has_fast_vehicles(scene: Scene) -> bool:
    """Return whether a visible vehicle of a scene is ever fast enough to throw spray."""
    times = [each.track.times for each in scene.actors] + [scene.ego.times if scene.ego is not None else np.zeros(0)]
    times_s = np.unique(np.concatenate(times))
    if len(times_s) < 2:
        return False
    motions = [each for each in vehicle_motions(scene, times_s) if each.is_there.sum() > 1]
    speeds = [np.linalg.norm(np.diff(each.positions_m, axis=0), axis=1) / np.diff(times_s) for each in motions]
    return any(bool((each > STILL_M_S).any()) for each in speeds)


def vehicle_motions(scene: Scene, times_s: Float64[np.ndarray, " n"]) -> list[VehicleMotion]:
    """Motions of the visible vehicles of a scene at times."""
    unit, motions = scene.metres_per_unit, list[VehicleMotion]()
    for actor in scene.actors:
        wheels = wheels_of(actor.class_name, tuple(unit * side for side in actor.size_lwh)) if actor.visible else None
        if wheels is not None:
            length, width, height = (unit * side for side in actor.size_lwh)
            track = scene.motions.get(actor.id, actor.track)
            motions.append(_motion(actor.id, (length, width, height), wheels, track, scene, times_s))
    if scene.ego is not None and len(scene.ego.times):
        tracks_m = wheels_of("car", EGO_SIZE_LWH)
        assert tracks_m is not None
        wheels = Wheels((0.0,), (1.0,), tracks_m.tracks_m, tracks_m.width_m)
        motions.append(
            _motion("ego", EGO_SIZE_LWH, wheels, scene.motions.get("ego", scene.ego), scene, times_s, EGO_AXLE_M)
        )
    return [each for each in motions if each.is_there.any()]


def wheels_of(class_name: str, size_lwh_m: Sequence[float]) -> Wheels | None:
    """Wheels of a vehicle by its class and size; None for what has no tires that throw water.

    Trucks and buses, and what is as high, have twin tires; the outer edge of a tire is 5 cm inside the vehicle's. Front
    wheels throw less than those behind, which also throw what drips from the arches of the front ones.
    """
    length, width, height = size_lwh_m
    kind = coco_class(class_name)
    if kind in ("motorcycle", "bicycle"):
        return Wheels((0.3 * length, -0.3 * length), (0.5, 0.5), (0.0,), 0.12 if kind == "motorcycle" else 0.03)
    if not is_vehicle(class_name) or kind == "train":
        return None
    tire_m = 0.5 if kind in ("truck", "bus") or height > HEAVY_M else 0.2
    side = max(width / 2 - 0.05 - tire_m / 2, 0.0)
    return Wheels((0.3 * length, -0.3 * length), (0.3, 0.7), (side, -side), tire_m)


def _motion(
    name: str, size_lwh_m: tuple[float, float, float], wheels: Wheels, track: PoseTrack, scene: Scene,
    times_s: Float64[np.ndarray, " n"], above_m: float = 0.0,
) -> VehicleMotion:  # fmt: skip
    """Sample a track; `above_m` is the height of its origin over the ground."""
    lower = np.maximum(np.searchsorted(track.times, times_s, side="right") - 1, 0)
    upper = np.minimum(lower + 1, len(track.times) - 1)
    span = track.times[upper] - track.times[lower]
    part = np.clip(np.divide(times_s - track.times[lower], span, out=np.zeros(len(times_s)), where=span > 0), 0, 1)
    part = part[:, None]
    to_world = scene.scene_to_world
    places = (1 - part) * track.positions[lower] + part * track.positions[upper]
    turns = matrices_from_quaternions(track.quaternions_wxyz[np.concatenate([lower, upper])])
    before, after = np.split(turns[:, :, 0] @ to_world[:3, :3].T, 2)
    ahead = ((1 - part) * before + part * after)[:, :2]
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    positions = places @ to_world[:3, :3].T + to_world[:3, 3] - [0.0, 0.0, above_m]
    return VehicleMotion(name, size_lwh_m, wheels, positions, ahead, np.asarray(track.valid[lower], np.bool_))


# Drop sizes


class SizeClass(NamedTuple):
    """Drops of a class of sizes."""

    share: float
    """Of the mass."""
    diameter_mm: float
    """Mean for the extinction of a mass: the inverse of the mean of 1 / D."""
    fall_m_s: float


def mean_diameter_mm(speed_m_s: float) -> float:
    """Mean diameter of drops that leave the grooves of a tire: 0.8 mm sqrt(2700 / We), We = rho V^2 w / sigma.

    Radovich and Plocher 2009 (laboratory; We 2700, 10900, 24400): 80 um to 9 mm, mean 0.8 mm at 2700, about We^-1/2.
    """
    weber = _WATER_KG_M3 * max(speed_m_s, STILL_M_S) ** 2 * GROOVE_M / _SURFACE_N_M
    return WEBER_MEAN_MM * float(np.sqrt(WEBER / weber))


@cache
def size_classes(speed_m_s: float) -> tuple[SizeClass, ...]:
    """Classes of a log-normal distribution of sizes; their extinction adds up to that of the whole."""
    mass_median = mean_diameter_mm(speed_m_s) * np.exp(2.5 * SPREAD**2)
    bounds = ndtri(np.concatenate([[0.0], np.cumsum(MASS_SHARES[:-1]), [1.0]]))
    inverse = np.exp(SPREAD**2 / 2) / mass_median * np.diff(ndtr(bounds + SPREAD)) / MASS_SHARES
    diameters = np.clip(1 / inverse, _SMALLEST_MM, _LARGEST_MM)
    return tuple(map(SizeClass, MASS_SHARES, diameters.tolist(), terminal_speed_m_s(diameters).tolist()))


def terminal_speed_m_s(diameter_mm: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Fall speed of small drops in still air: drag of spheres after Schiller and Naumann (1933)."""
    d = 1e-3 * diameter_mm
    stokes = _WATER_KG_M3 * GRAVITY_M_S2 * d**2 / (18 * _AIR_PA_S)
    speed = stokes
    for _ in range(40):
        speed = 0.5 * (speed + stokes / (1 + 0.15 * (_AIR_KG_M3 * speed * d / _AIR_PA_S) ** 0.687))
    return speed


def thrown_share(speed_m_s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Share of the displaced water that tires throw: 0 up to 40, 1 from 60 km/h on, and a smooth step between."""
    return _smooth((speed_m_s - STILL_M_S) / (FULL_M_S - STILL_M_S))


# Parcels


class _Emissions(NamedTuple):
    """Water that leaves the tires of one vehicle: one parcel for each cell of time, axle, track and class of sizes."""

    wheel_m: Float64[np.ndarray, "n 3"]
    """Place on the ground."""
    forward: Float64[np.ndarray, "n 2"]
    speed_m_s: Float64[np.ndarray, " n"]
    age_s: Float64[np.ndarray, " n"]
    thrown_kg: Float64[np.ndarray, " n"]
    diameter_mm: Float64[np.ndarray, " n"]
    fall_m_s: Float64[np.ndarray, " n"]
    randoms: Float64[np.ndarray, "n 8"]


def emissions_of(
    vehicle: VehicleMotion, cells: Int64[np.ndarray, " cells"], edges_s: Float64[np.ndarray, " edges"], film_mm: float,
    seed: int, time_s: float,
) -> _Emissions | None:  # fmt: skip
    """Parcels that a vehicle has thrown up until a time, from the cells of its track; None if there is none."""
    moved = np.diff(vehicle.positions_m[:, :2], axis=0)
    length, lasts = np.hypot(*moved.T), np.diff(edges_s)
    speed = np.divide(length, lasts, out=np.zeros(len(length)), where=lasts > 1e-9)
    ahead = np.sum(moved * vehicle.forward[:-1], axis=1) > 0
    throws = thrown_share(speed) * (vehicle.is_there[:-1] & vehicle.is_there[1:] & ahead)
    if not throws.any():
        return None
    steps, of_cell = np.unique(np.rint(2 * speed), return_inverse=True)
    sizes = np.array([size_classes(each / 2) for each in steps.tolist()])[of_cell]  # cells, classes, numbers
    oldest = time_s - edges_s[:-1, None] - lasts[:, None]
    cell, size = np.nonzero((throws > 0)[:, None] & (oldest * sizes[:, :, 2] < LOWEST_M))
    wheels = vehicle.wheels
    axles = list(product(zip(wheels.axles_m, wheels.axle_shares, strict=True), wheels.tracks_m))
    places = np.array([(along, share, left) for (along, share), left in axles])
    place = np.repeat(np.arange(len(places)), len(cell))
    cell, size = np.tile(cell, len(places)), np.tile(size, len(places))
    randoms = _randoms(cells[cell], place * len(MASS_SHARES) + size, zlib.crc32(vehicle.name.encode()), seed)
    along, axle_share, left = places[place].T
    share, diameter_mm, fall = sizes[cell, size].T
    # Inside a cell the place follows from a random number, so that the lattice does not show.
    begins, forward = vehicle.positions_m[cell], vehicle.forward[cell]
    wheel = begins + randoms[0][:, None] * (vehicle.positions_m[cell + 1] - begins)
    wheel[:, :2] += along[:, None] * forward + left[:, None] * _left_of(forward)
    age = time_s - (edges_s[cell] + randoms[0] * lasts[cell])
    swept_m2 = wheels.width_m * length[cell] * throws[cell] * axle_share
    weight = merged_weight(cells[cell], time_s - edges_s[cell])
    thrown = 1e-3 * film_mm * _WATER_KG_M3 * swept_m2 * share * weight
    found = _Emissions(wheel, forward, speed[cell], age, thrown, diameter_mm, fall, randoms.T)
    return _Emissions(*(column[weight > 0] for column in found))


def merged_weight(cells: Int64[np.ndarray, " n"], age_s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Factor on parcels of cells: from each age of `MERGED_S` on every second one takes over the water of the next."""
    weight, odd = np.ones(len(cells)), 1
    for merged_s in MERGED_S:
        share = _smooth((age_s - merged_s) / MERGE_S)
        weight *= np.where(cells // odd % 2 == 0, 1 + share, np.where(cells % odd == 0, 1 - share, 1.0))
        odd *= 2
    return weight


def _smooth(share: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    share = np.clip(share, 0, 1)
    return share * share * (3 - 2 * share)


def _left_of(forward: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    return np.stack([-forward[:, 1], forward[:, 0]], axis=1)


def _parcels(emitted: _Emissions, size_lwh_m: tuple[float, float, float], rain: RainSettings) -> SprayParcels:
    """Move parcels to where they are at their age, in the wake of a vehicle and the wind."""
    wheel, forward, speed, age, thrown, diameter_mm, fall, randoms = emitted
    u = randoms.T
    scale = float(np.sqrt(size_lwh_m[1] * size_lwh_m[2]))
    grown = np.cbrt(1 + speed * age / scale)
    side, up = WAKE_SIDE * scale * grown, WAKE_UP * scale * grown
    normals = ndtri(np.clip(u[3:], 1e-6, 1 - 1e-6))
    turn = age / SWIRL_S
    offsets = APART * (normals[:3] * np.cos(turn) + normals[[3, 4, 0]] * np.sin(turn))
    height = _thrown_height(u[1], u[2], speed, age, diameter_mm, fall, size_lwh_m[2])
    height += WAKE_RISE * scale * (grown - 1) + offsets[2] * up
    drag = 3 * WAKE_DRAG * scale * (grown - 1) * (0.6 + 0.8 * u[1])
    wind = np.array(rain.wind_vector_m_s) * float(profile(np.array([DRIFT_HEIGHT_M]), rain.roughness_m)[0])
    center, velocity = wheel.copy(), np.zeros_like(wheel)
    center[:, :2] += (drag + offsets[0] * side)[:, None] * forward + (offsets[1] * side)[:, None] * _left_of(forward)
    center[:, :2] += wind * age[:, None]
    center[:, 2] += np.maximum(height, 0.0)
    velocity[:, :2] = wind + (WAKE_DRAG * speed / grown**2)[:, None] * forward
    velocity[:, 2] = -fall
    floats = ndtr(height / up) * _smooth((LONGEST_S - age) / FADE_S)
    masses = thrown * floats
    extinction = 3 * masses / (_WATER_KG_M3 * 1e-3 * diameter_mm)  # Q = 2
    sigma = OWN * np.sqrt(side * up)
    parcels = SprayParcels(center, sigma, extinction, masses, diameter_mm, velocity)
    return SprayParcels(*(column[floats > _NOTHING] for column in parcels))


def _thrown_height(
    of_angle: Float64[np.ndarray, " n"], of_wheel: Float64[np.ndarray, " n"], speed_m_s: Float64[np.ndarray, " n"],
    age_s: Float64[np.ndarray, " n"], diameter_mm: Float64[np.ndarray, " n"], fall_m_s: Float64[np.ndarray, " n"],
    tall_m: float,
) -> Float64[np.ndarray, " n"]:  # fmt: skip
    """Height of drops over the ground in still air.

    A drop leaves the tread at an angle up to `GUARD_DEG` with the speed of the tire. Drag stops it within the distance
    l ln(1 + w tau / l), l = 4/3 (rho_w / rho_a) D / 0.6 (of drag at high speed) and tau = V_fall / g; then it falls.
    """
    wheel_m = np.clip(0.22 * tall_m, 0.2, 0.5)  # radius of a wheel
    rise = speed_m_s * np.sin(np.radians(GUARD_DEG) * of_angle)
    stops_s = np.maximum(fall_m_s / GRAVITY_M_S2, 1e-3)
    path = 4 / 3 * _WATER_KG_M3 / _AIR_KG_M3 * 1e-3 * diameter_mm / 0.6
    risen = path * np.log1p(rise * stops_s / path) * -np.expm1(-age_s / stops_s)
    fallen = fall_m_s * (age_s + stops_s * np.expm1(-age_s / stops_s))
    return wheel_m * (0.2 + 0.8 * of_wheel) + risen - fallen


def _randoms(
    cells: Int64[np.ndarray, " n"], lane: Int64[np.ndarray, " n"], vehicle: int, seed: int
) -> Float64[np.ndarray, "8 n"]:
    """Eight uniform numbers in 0..1 for each parcel."""
    where = cells.astype(np.uint32)
    lanes = lane.astype(np.uint32)
    names, seeds = np.full_like(where, vehicle), np.full_like(where, seed)
    first = pcg4d(where, lanes, names, seeds)
    second = pcg4d(where, lanes + np.uint32(0x73707279), names, seeds)
    return (np.stack([*first, *second]) + 0.5) * 2.0**-32


# As Gaussians


def spray_gaussians(parcels: SprayParcels, rain: RainFrame) -> Gaussians:
    """Soft Gaussians of the parcels for a camera, to be drawn with the scene's.

    The alpha at the center is 1 - exp(-tau), tau = A / (2 pi sigma^2) the optical depth along a line through it, raised
    by what renderers cut off at 1/255: the integral stays. Light is that of the sky and of the road, which drops
    scatter forward, and of lamps.
    """
    depth = parcels.extinction_m2 / (2 * np.pi * parcels.sigmas_m**2)
    alpha = -np.expm1(-depth)
    drawn = np.flatnonzero(alpha > LEAST_ALPHA)
    means = parcels.centers_m[drawn].astype(np.float32)
    light = np.tile(LIGHT * rain.light_linear, (len(drawn), 1))
    if rain.lamp_light is not None and rain.is_linear:
        light += np.float32(0.5) * light_of_drops(rain.lamp_light, means, rain.view.camera)
    return Gaussians(
        means,
        np.repeat(parcels.sigmas_m[drawn].astype(np.float32)[:, None], 3, axis=1),
        np.tile(np.array([1, 0, 0, 0], np.float32), (len(drawn), 1)),
        np.minimum(alpha[drawn] + 1 / 255, 1).astype(np.float32),
        sh_from_color(linear_to_srgb(np.minimum(light, 1)).astype(np.float32)),
    )


# Along rays, and on panes


def water_kg_m3(parcels: SprayParcels, point_m: Float[np.ndarray, "3"]) -> Float64[np.ndarray, " n"]:
    """Mass of each parcel's drops per volume of air at a point."""
    away = np.sum((parcels.centers_m - point_m) ** 2, axis=1) / parcels.sigmas_m**2
    return parcels.masses_kg / ((2 * np.pi) ** 1.5 * parcels.sigmas_m**3) * np.exp(-0.5 * away)


def pane_flux_m_s(
    parcels: SprayParcels, point_m: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"],
    velocity_m_s: Float[np.ndarray, "3"],
) -> float:  # fmt: skip
    """Depth of water per second that spray leaves on a moving pane: the sum of w (v_pane - v_drop) n / rho.

    `normal` is outward; none lands from behind. Drops do not evade the pane: those of 0.1 mm and more are too heavy.
    """
    inward = np.maximum((np.asarray(velocity_m_s) - parcels.velocities_m_s) @ np.asarray(normal), 0.0)
    return float(water_kg_m3(parcels, point_m) @ inward) / _WATER_KG_M3


def depths_along(
    parcels: SprayParcels, origin_m: Float64[np.ndarray, "3"], directions: Float64[np.ndarray, "n 3"],
    step_m: float, steps: int,
) -> Float64[np.ndarray, "n steps"]:  # fmt: skip
    """Optical depth of spray in each of `steps` intervals of `step_m` along unit directions from a point."""
    depths = np.zeros((len(directions), steps))
    relative = np.ascontiguousarray(parcels.centers_m - origin_m)
    _depths_along(relative, parcels.sigmas_m, parcels.extinction_m2, np.ascontiguousarray(directions), step_m, depths)
    return depths


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _depths_along(portion, centers, sigmas, areas, directions, step_m, depths):
    """Add each parcel's integral over the intervals of a ray: a Gaussian across times that along it."""
    for i in range_of(portion, len(directions)):
        dx, dy, dz = directions[i]
        for n in range(len(sigmas)):
            x, y, z = centers[n]
            along = x * dx + y * dy + z * dz
            apart = (x * x + y * y + z * z - along * along) / (2 * sigmas[n] * sigmas[n])
            if apart > 9 or along < -4 * sigmas[n]:
                continue
            whole = areas[n] / (2 * np.pi * sigmas[n] * sigmas[n]) * np.exp(-apart)
            first = max(int((along - 4 * sigmas[n]) / step_m), 0)
            last = min(int((along + 4 * sigmas[n]) / step_m) + 1, depths.shape[1])
            before = _normal_share((first * step_m - along) / sigmas[n])
            for k in range(first, last):
                after = _normal_share(((k + 1) * step_m - along) / sigmas[n])
                depths[i, k] += whole * (after - before)
                before = after


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _normal_share(x):
    """Normal distribution function."""
    return 0.5 * math.erf(x / math.sqrt(2.0))
