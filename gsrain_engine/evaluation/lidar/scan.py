"""Lidar scans in rain: lost echoes, range noise and drop returns, for captured sweeps and virtual scans.

The lidar equation with rain as attenuation and as target: Rasshofer, Spies and Spies 2011 (Advances in Radio Science
9); Goodin, Carruth, Doude and Hudson 2019 (Electronics 8:89); Kilic et al. 2021 (LISA); Hasirlioglu and Riener 2017.
Unlike there, drops, sizes and extinction are those of the rain in the camera images.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any, no_type_check

import msgspec
import numba
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int8, Int64

from ...datasets.capture import EGO_HEIGHT_M, Capture, LidarSweep
from ...kernels import kernel, range_of
from ...rain.frame import RainCamera
from ...rain.simulation import RainSimulation
from ...rain.wetness import water_depth_mm
from ...render.cpu.projection import project
from ...render.cpu.tiles import TILE, bin_into_tiles
from ...render.view import leveled_frame
from ...safe_io.files import whole_file
from ...scene.camera import Camera
from ...scene.geometry import matrices_from_quaternions
from ...scene.scene import DrawItem, Layer, PoseTrack, Scene
from ...water.spray import SprayParcels
from .rain_echoes import DropReturnModel, RainReturns, box_span, drop_field_returns, sample_far_returns, wet_road_share
from .sensor import STATED_REFLECTANCE, Beams, LidarSensor
from .settings import Answer
from .spray_echoes import spray_in_beams

Pose = Float64[np.ndarray, "4 4"]


class ReturnOutcome(IntEnum):
    """Outcome of a beam's clear echo."""

    NOTHING = 0
    """No clear echo."""
    KEPT = 1
    DROPPED = 2
    """Too weak in rain."""
    MASKED = 3
    """Detectable, but replaced by a drop's return."""


@dataclass(frozen=True, slots=True, eq=False)
class RainyScan:
    """A sensor's output in rain, with the outcome of each clear echo."""

    sweep: LidarSweep
    """World, meters; intensities as in clear air, if known."""
    beams: Int64[np.ndarray, " m"]
    is_false: Bool[np.ndarray, " m"]
    """Mask of the points that are drops."""
    fates: Int8[np.ndarray, " n"]
    signals: Float64[np.ndarray, " m"]
    """Power of each point in multiples of the detection threshold; 0 for points unaffected by rain."""

    @property
    def false_ranges_m(self) -> Float64[np.ndarray, " k"]:
        return np.linalg.norm(self.sweep.points_m[self.is_false].astype(np.float64) - self.sweep.origin_m, axis=1)


def scan_in_rain(
    beams: Beams,
    sensor: LidarSensor,
    rainfall: RainSimulation,
    anchor_to_world: Pose,
    *,
    answer: Answer = "strongest",
    wet_road: bool = True,
    spray: SprayParcels | None = None,
) -> RainyScan:
    """Return a sensor's output in rain, given its beams in clear air.

    Extinction is beta(R) of `RainProperties`, for both directions. Drops are those of the rain's own field at the
    beams' time inside its streak region, which is placed in the frame `anchor_to_world`, and Poisson-sampled ones
    beyond. Of a beam's echoes the strongest (relative to the detection threshold at its range), the first or the last
    is reported. `spray` takes light from echoes behind it, and returns its own. Range noise is the increase over clear
    air. The rain's seed determines everything; without rain and wetness the points are unchanged, to the bit.
    """
    rainfall = rainfall.frozen_at(beams.time_s)
    state, seed = rainfall.state, rainfall.rain.seed
    ranges = np.where(beams.is_echo, beams.ranges_m, 1.0)
    faded = np.exp(-2 * state.extinction_per_m * ranges)
    if wet_road:
        faded *= _wet_road(beams, sensor, rainfall)
    clouds = None
    if spray is not None and len(spray):
        drawn = np.random.default_rng([seed, _moment(beams.time_s), 3]).integers(2**63)
        clouds = spray_in_beams(beams, sensor, spray, state.extinction_per_m, int(drawn))
        faded *= clouds.transmittance**2
    clear = np.where(beams.is_echo, sensor.signal(ranges, beams.reflectances, 0.0), 0.0)
    signals = clear * faded
    # Threshold returns stay detected without attenuation: rounding must not lose them.
    heard = beams.is_echo & ((signals >= 1) | (faded == 1))
    cloud_returns = RainReturns.none() if clouds is None else clouds.returns
    drops, drop_signals = _answering_drops(beams, sensor, rainfall, anchor_to_world, answer, cloud_returns)
    if answer == "first":
        answers = np.ones(len(drops.beams), bool)
    else:  # always if the echo behind is not detected
        answers = ~heard[drops.beams]
        if answer == "strongest":
            answers |= drop_signals > signals[drops.beams]
    drops, drop_signals = RainReturns(*(column[answers] for column in drops)), drop_signals[answers]
    by_drop = np.zeros(len(beams), bool)
    by_drop[drops.beams] = True
    fates = np.full(len(beams), ReturnOutcome.NOTHING, np.int8)
    fates[beams.is_echo] = ReturnOutcome.DROPPED
    fates[heard] = ReturnOutcome.KEPT
    fates[heard & by_drop] = ReturnOutcome.MASKED
    true = np.flatnonzero((fates == ReturnOutcome.KEPT) | beams.untouched)
    noise = np.random.default_rng([seed, _moment(beams.time_s), 1]).standard_normal(len(beams))
    # The points of a clear sweep already contain their own noise.
    before, after = (sensor.range_sigma(np.maximum(each, 1)) ** 2 for each in (clear, signals))
    moved = noise * np.sqrt(np.maximum(after - before, 0))
    moved[beams.untouched] = 0
    true_points = (beams.points_m + beams.directions * moved[:, None])[true]
    spread = drops.ranges_m + noise[drops.beams] * sensor.range_sigma(drop_signals)
    false_points = beams.origin_m + beams.directions[drops.beams] * np.maximum(spread, sensor.blind_m)[:, None]
    order = np.argsort(np.concatenate([true, drops.beams]), kind="stable")
    intensities = None
    if beams.intensities is not None:  # the sensor corrects for range but not for rain
        of_true = beams.intensities[true] * np.where(beams.untouched, 1, faded)[true]
        of_drops = beams.full_intensity * drops.reflectances * np.exp(-2 * state.extinction_per_m * drops.ranges_m)
        intensities = np.concatenate([of_true, of_drops]).astype(np.float32)[order]
    points = np.concatenate([true_points, false_points]).astype(np.float32)[order]
    return RainyScan(
        sweep=LidarSweep(beams.time_s, points, beams.origin_m, intensities),
        beams=np.concatenate([true, drops.beams])[order],
        is_false=(np.arange(len(order)) >= len(true))[order],
        fates=fates,
        signals=np.concatenate([signals[true], drop_signals])[order],
    )


def _wet_road(beams: Beams, sensor: LidarSensor, rainfall: RainSimulation) -> Float64[np.ndarray, " n"]:
    """Share of each echo that remains on a wet road; 1 for other surfaces."""
    shares, wetness = np.ones(len(beams)), rainfall.wetness_at(beams.time_s)
    road = np.flatnonzero(beams.is_echo & (beams.road_cosines > 0))
    if wetness > 0 and len(road):
        cosines = beams.road_cosines[road]
        matt = np.clip(beams.reflectances[road] / cosines, 0, 1)
        film = water_depth_mm(rainfall.state.intensity_mm_h)
        shares[road] = wet_road_share(cosines, matt, wetness, film, sensor.wavelength_nm)
    return shares


def _answering_drops(
    beams: Beams, sensor: LidarSensor, rainfall: RainSimulation, anchor_to_world: Pose, answer: Answer,
    spray: RainReturns,
) -> tuple[RainReturns, Float64[np.ndarray, " m"]]:  # fmt: skip
    """The drop or spray of each beam that would be reported without another echo, and its signal."""
    if rainfall.state.intensity_mm_h == 0:
        return RainReturns.none(), np.zeros(0)
    signals = DropReturnModel(sensor, rainfall.state)
    listened = np.where(beams.untouched, 0, np.minimum(beams.ranges_m - sensor.pulse_m, signals.reach_m))
    listened = np.maximum(listened, 0)
    view = RainCamera(Camera.from_fov(1, 1, 45.0, np.eye(4)), anchor_to_world, np.zeros(3))
    field = rainfall.frame(beams.time_s, view)
    simulated = box_span(beams, rainfall.rain.streak_region, anchor_to_world)
    seed = np.random.default_rng([rainfall.rain.seed, _moment(beams.time_s), 2]).integers(2**63)
    found = RainReturns.joined(
        drop_field_returns(field, beams, listened, signals),
        sample_far_returns(beams, listened, simulated, signals, int(seed)),
        spray,
    )
    strength = sensor.signal(found.ranges_m, found.reflectances, rainfall.state.extinction_per_m)
    first = {"strongest": -strength, "first": found.ranges_m, "last": -found.ranges_m}[answer]
    order = np.lexsort((first, found.beams))
    best = order[np.unique(found.beams[order], return_index=True)[1]]
    return RainReturns(*(column[best] for column in found)), strength[best]


def _moment(time_s: float) -> int:
    """A time in integer microseconds, as a random seed."""
    return round(time_s * 1e6) % 2**32


# Virtual scans
# Four rendered views around the sensor give the surfaces that the beams hit.

_FACE_DEG = 90.0
_MARGIN_PX = 4
_LARGEST_PX = 2048
_UNIT = 1e-3  # that the length of a direction may differ from 1
_ROAD_UP = 0.95
_ROAD_M = 0.3

MATT = 0.2  # default reflectance of all objects, times the cosine of incidence, for sweeps without intensities


def scan_scene(
    scene: Scene, time_s: float, sensor_to_world: Pose, sensor: LidarSensor, matt: float = MATT,
    own: Float64[np.ndarray, "n 3"] | None = None,
) -> Beams:  # fmt: skip
    """Send the sensor's beams into a scene. `sensor_to_world` is a pose: x forward, y left, z up, meters.

    `own` are unit directions in the sensor's frame between its lowest and highest beam; default: the sensor's own.
    Raises `ValueError` for directions of another length, and for a pose that is not finite.

    Everything has the same near-infrared reflectance `matt`, times the cosine of incidence, since colors do not
    determine it. All beams are sent at the same time. The sky returns no echo.
    """
    own = _own_directions(sensor) if own is None else own
    if not np.isfinite(sensor_to_world).all():
        raise ValueError("sensor_to_world: must be finite")
    if not (np.abs(np.linalg.norm(np.clip(own, -2, 2), axis=1) - 1) < _UNIT).all():
        raise ValueError("directions of a lidar's beams: must have the length 1")
    directions = own @ sensor_to_world[:3, :3].T
    origin = sensor_to_world[:3, 3].copy()
    ranges, normals = np.full(len(own), np.inf), np.zeros((len(own), 3))
    azimuths = np.degrees(np.arctan2(own[:, 1], own[:, 0]))
    parts, is_sky = _placed(scene, time_s)
    faces = np.round(azimuths / _FACE_DEG).astype(int) % 4
    for face in np.unique(faces).tolist():
        mine = np.flatnonzero(faces == face)
        camera = _face_camera(sensor, sensor_to_world, face)
        ranges[mine], normals[mine] = _surfaces_met(parts, is_sky, directions[mine], camera)
    cosines = np.abs(np.sum(normals * directions, axis=1))
    found = np.isfinite(ranges)
    points = np.where(found[:, None], origin + directions * np.where(found, ranges, 0)[:, None], origin)
    ego = scene.ego_to_world(time_s)
    road_m = scene.ground_m if ego is None else float(ego[2, 3]) - EGO_HEIGHT_M
    is_road = found & (normals[:, 2] > _ROAD_UP)
    if road_m is not None:
        is_road &= np.abs(points[:, 2] - road_m) < _ROAD_M
    return Beams(
        time_s=time_s,
        origin_m=origin,
        directions=directions,
        ranges_m=ranges,
        points_m=points.astype(np.float32),
        reflectances=matt * cosines,
        road_cosines=np.where(is_road, cosines, 0.0),
        untouched=np.zeros(len(own), bool),
    ).heard_by(sensor)


def _placed(scene: Scene, time_s: float) -> tuple[list[DrawItem], Bool[np.ndarray, " g"]]:
    """Visible parts at a time, and the mask of the sky's Gaussians among theirs."""
    placed = [(each, part) for each in scene.members if each.visible and (part := scene.part(each, time_s)) is not None]
    sky = [np.full(len(p.gaussians), isinstance(m, Layer) and m.kind == "sky") for m, p in placed]
    return [part for _, part in placed], np.concatenate([np.zeros(0, np.bool_), *sky])


def surface_depth(scene: Scene, time_s: float, camera: Camera) -> Float32[np.ndarray, "h w"]:
    """Meters along the view axis of a pinhole at the pixels' centers, of the surfaces that a lidar would meet.

    0 for the sky and where there is no surface. Flat Gaussians count as pieces of planes, so that a road is as far as
    it is also at a grazing angle, where the centers of its Gaussians are not.
    """
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    own = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1).reshape(-1, 3)
    lengths = np.linalg.norm(own, axis=1)
    directions = own @ camera.world_to_camera[:3, :3] / lengths[:, None]
    ranges, _ = _surfaces_met(*_placed(scene, time_s), directions, camera)
    depth = np.where(np.isfinite(ranges), ranges / lengths, 0.0)
    return depth.reshape(camera.height, camera.width).astype(np.float32)


def _own_directions(sensor: LidarSensor) -> Float64[np.ndarray, "n 3"]:
    """Unit directions in the sensor's own frame, ring by ring, each from right to left."""
    limit, step = sensor.azimuth_limit_deg, sensor.azimuth_step_deg
    azimuths = np.radians(-limit + step * (np.arange(round(2 * limit / step)) + 0.5))
    up, around = np.meshgrid(np.radians(sensor.elevations_deg), azimuths, indexing="ij")
    return np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1).reshape(-1, 3)


def _face_camera(sensor: LidarSensor, sensor_to_world: Pose, face: int) -> Camera:
    """A camera that covers a quarter of the beams, with pixels as wide as the azimuth step."""
    focal = min(1 / math.radians(sensor.azimuth_step_deg), _LARGEST_PX / 2)
    half = math.ceil(focal) + _MARGIN_PX
    steepest = math.sqrt(2) * focal  # at the image's sides, where rows of equal elevation rise
    top, bottom = (
        math.ceil(steepest * math.tan(math.radians(max(highest, 0.0)))) + _MARGIN_PX
        for highest in (max(sensor.elevations_deg), -min(sensor.elevations_deg))
    )
    turn = math.radians(_FACE_DEG * face)
    forward = np.array([math.cos(turn), math.sin(turn), 0.0])
    right = np.array([math.sin(turn), -math.cos(turn), 0.0])
    to_camera = np.eye(4)
    to_camera[:3, :3] = np.stack([right, (0.0, 0.0, -1.0), forward]) @ sensor_to_world[:3, :3].T
    to_camera[:3, 3] = -to_camera[:3, :3] @ sensor_to_world[:3, 3]
    return Camera(2 * half, top + bottom, focal, focal, float(half), float(top), to_camera)


# Ray-surface intersection
# Flat Gaussians act as pieces of planes. Blended depth of splat centers is too near on a road at a grazing angle, and
# lies between two surfaces where it mixes them. Instead, a ray passes through the splats until less than half of its
# light is left (median depth) and is intersected with the planes n . x = d of the splats around that depth (as in PGSR,
# Chen et al. 2024), which is exact for pieces of one plane.

_FLAT = 0.35
"""A Gaussian is flat if its shortest axis is less than this share of the next; a round one faces the camera."""

_FARTHEST_OFF = 0.5  # largest distance of a ray-plane intersection from the splat's center, as a share of the depth
_SAME_SHARE, _SAME_M = 0.03, 0.05  # splats within this distance of the median depth belong to the same surface


def _surfaces_met(
    parts: Sequence[DrawItem], is_sky: Bool[np.ndarray, " g"], directions: Float64[np.ndarray, "n 3"], camera: Camera
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, "n 3"]]:
    """Ranges in meters (infinite without a surface) and world normals that face the camera.

    Unit `directions` in the world start at the camera and fall into its image, whose pixel size sets the resolution
    of the Gaussians.
    """
    splats = project(parts, camera)
    tiles = bin_into_tiles(splats.shapes, splats.nearest_first(), camera.width, camera.height)
    turn = camera.world_to_camera[:3, :3]
    own = directions @ turn.T
    rays = own / own[:, 2:]
    planes = np.column_stack([_planes(parts, splats.indices, camera), splats.colors[:, 3]])
    places = np.stack([camera.cx + camera.fx * rays[:, 0], camera.cy + camera.fy * rays[:, 1]], axis=1)
    found = np.zeros((len(rays), 4))
    _meet(
        splats.shapes, tiles.starts, tiles.members, tiles.columns, planes, is_sky[splats.indices], rays, places, found
    )
    there = found[:, 0] > 0
    return np.where(there, found[:, 0] / own[:, 2], np.inf), found[:, 1:] @ turn


@kernel(parallel=True)
@no_type_check
def _meet(portion, shapes, starts, members, columns, planes, is_sky, rays, places, found):
    """Write the depth along the view axis, 0 without a surface, and the unit normal that each ray hits."""
    right, bottom = columns * TILE, (len(starts) - 1) // columns * TILE
    for i in range_of(portion, len(rays)):
        u, v, ray = places[i, 0], places[i, 1], rays[i]
        if not (0 <= u < right and 0 <= v < bottom):  # also NaN
            continue
        tile = int(v) // TILE * columns + int(u) // TILE
        left, hit = 1.0, -1
        for k in range(starts[tile], starts[tile + 1]):
            left *= 1 - _alpha(shapes[members[k]], u, v)
            if left < 0.5:
                hit = members[k]
                break
        if hit < 0 or is_sky[hit]:
            continue
        median = _depth(planes[hit], ray)
        left, weight, depth = 1.0, 0.0, 0.0
        normal = np.zeros(3)
        for k in range(starts[tile], starts[tile + 1]):
            m = members[k]
            alpha = _alpha(shapes[m], u, v)
            if alpha == 0 or is_sky[m]:
                continue
            own = _depth(planes[m], ray)
            if abs(own - median) <= _SAME_SHARE * median + _SAME_M:
                weight += left * alpha
                depth += left * alpha * own
                normal += left * alpha * planes[m, :3]
            left *= 1 - alpha
            if left < 1e-3:
                break
        if weight <= 0:  # a surface whose depth is no number
            continue
        length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        found[i, 0] = depth / weight
        found[i, 1:] = normal / max(length, 1e-9)


@numba.njit(inline="always")
@no_type_check
def _alpha(shape, u, v):
    """Alpha of a splat at a position in the image, see `Splats`."""
    dx = u - shape[0]
    if abs(dx) > shape[7]:
        return 0.0
    dy = v - shape[1] - shape[2] * dx
    log = shape[5] + shape[3] * dx * dx + shape[4] * dy * dy
    return np.exp(log) if log >= shape[6] else 0.0


@numba.njit(inline="always")
@no_type_check
def _depth(plane, ray):
    """Depth at which a ray meets a splat's plane; the center's depth if the intersection is too far from the splat."""
    towards = plane[0] * ray[0] + plane[1] * ray[1] + plane[2] * ray[2]
    if towards >= -1e-6:
        return plane[4]
    depth = plane[3] / towards
    return depth if abs(depth - plane[4]) < _FARTHEST_OFF * plane[4] else plane[4]


def _planes(parts: Sequence[DrawItem], indices: Int64[np.ndarray, " m"], camera: Camera) -> Float64[np.ndarray, "m 4"]:
    """Camera-facing unit normals, and n . x, of some Gaussians indexed over all parts; camera axes, meters."""
    planes = np.zeros((len(indices), 4))
    first = 0
    for part in parts:
        rows = slice(*np.searchsorted(indices, [first, first + len(part.gaussians)]).tolist())
        chosen = indices[rows] - first
        first += len(part.gaussians)
        to_camera = camera.world_to_camera @ part.to_world
        places = part.gaussians.means[chosen].astype(np.float64) @ to_camera[:3, :3].T + to_camera[:3, 3]
        planes[rows, :3] = _normals(part, chosen, places, to_camera)
        planes[rows, 3] = np.sum(planes[rows, :3] * places, axis=1)
    planes[planes[:, 3] > 0] *= -1
    return planes


def _normals(
    part: DrawItem, chosen: Int64[np.ndarray, " m"], places: Float64[np.ndarray, "m 3"], to_camera: Pose
) -> Float64[np.ndarray, "m 3"]:
    scales: Float32[np.ndarray, "m 3"] = part.gaussians.scales[chosen]
    rotations = matrices_from_quaternions(part.gaussians.quaternions[chosen].astype(np.float64))
    shortest = np.argmin(scales, axis=1)
    along = np.take_along_axis(rotations, shortest[:, None, None], axis=2)[:, :, 0] @ to_camera[:3, :3].T
    ordered = np.sort(scales, axis=1)
    flat = ordered[:, 0] < _FLAT * ordered[:, 1]
    normals = np.where(flat[:, None], along, places)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


# Beams of a measured sweep

RETROREFLECTING = 100.0
"""Intensity of a white Lambertian target on scales beyond 1; higher values are reflectors (as of Velodyne)."""

ROOF_M = 1.9  # assumed sensor height above the road, a car's roof, if the dataset's origin is on the road
_ON_ROAD_M = 0.5
_BEAM_ROAD_M = 0.25  # largest height difference from the road of road points
_SMALLEST_STEPS = 0.5 / 255  # share of the scale assumed for an intensity of 0, which was rounded down
_DETECTED_SHARE = 0.99
_FINE_STEPS, _FINE_SHARE = 256, 0.2  # different intensities in a sweep, beyond which they were computed, not rounded
_LIGHTEST_ROAD = 0.5  # reflectance of a matt road; asphalt has 0.1 to 0.3


def full_intensity(sweep: LidarSweep) -> float:
    """Guess a sweep's intensity of a white Lambertian target at normal incidence: 1, or 100."""
    if sweep.intensities is None or not len(sweep.intensities) or sweep.intensities.max() <= 1:
        return 1.0
    return RETROREFLECTING


def estimate_sensor_range(sweep: LidarSweep, full: float) -> float | None:
    """Range in meters at which the sensor detects 10 %, estimated from the sweep; None without intensities.

    A sensor that detects reflectance rho at range r detects 10 % at r sqrt(0.1 / rho) at least. The 99 % quantile over
    a sweep's returns is used, since the faintest intensities of real sensors are rounded to some 255 steps; the largest
    of all if they are not, as in recordings of virtual lidars.
    """
    if sweep.intensities is None:
        return None
    ranges = np.linalg.norm(sweep.points_m - sweep.origin_m, axis=1)
    reflectances, ranges = _reflectances(sweep, full)[ranges > 1], ranges[ranges > 1]
    if not len(ranges):
        return None
    share = 1.0 if _are_computed(reflectances) else _DETECTED_SHARE
    return float(np.quantile(ranges * np.sqrt(STATED_REFLECTANCE / reflectances), share))


def sweep_beams(
    sweep: LidarSweep, sensor: LidarSensor, ego: PoseTrack | None = None, full: float | None = None
) -> Beams:
    """Turn each point of a sweep into a beam. Beams without an echo are not in a sweep and stay unknown.

    Detected points must be detectable: reflectances, the intensities over `full`, are raised to the sensor's detection
    threshold where lower. Points nearer than `clear_m` (the own vehicle, placeholders at the origin) are unaffected.
    With `ego`, the vehicle's track, points at its road's height are road; and a sensor position on the road (in
    datasets with points in the vehicle's frame) is raised to `ROOF_M`. Surfaces of virtual lidars are matt: what is
    lighter than a road could be at its angle is a curb or the foot of a wall.
    """
    full = full_intensity(sweep) if full is None else full
    pose = None if ego is None else ego.pose(sweep.time_s)
    if pose is not None:
        height = float((sweep.origin_m - pose[:3, 3]) @ pose[:3, 2]) + EGO_HEIGHT_M
        if height <= _ON_ROAD_M:
            sweep = replace(sweep, origin_m=sweep.origin_m + (ROOF_M - height) * pose[:3, 2])
    away = sweep.points_m.astype(np.float64) - sweep.origin_m
    ranges = np.linalg.norm(away, axis=1)
    untouched = ranges < max(sensor.clear_m, 1e-3)
    directions = away / np.maximum(ranges, 1e-9)[:, None]
    directions[ranges < 1e-9] = (1, 0, 0)
    weakest = sensor.detectable(np.where(untouched, sensor.clear_m, ranges))
    reflectances = _reflectances(sweep, full)
    road_cosines = np.zeros(len(ranges))
    if pose is not None:
        up = pose[:3, 2]  # follows the slope under the vehicle
        heights = (sweep.points_m - pose[:3, 3]) @ up + EGO_HEIGHT_M
        sensor_height = float((sweep.origin_m - pose[:3, 3]) @ up) + EGO_HEIGHT_M
        cosines = np.clip((sensor_height - heights) / np.maximum(ranges, 1e-9), 0, 1)
        is_road = np.abs(heights) < _BEAM_ROAD_M
        if _are_computed(reflectances):
            is_road &= reflectances <= _LIGHTEST_ROAD * cosines
        road_cosines = np.where(is_road, cosines, 0.0)
    return Beams(
        time_s=sweep.time_s,
        origin_m=sweep.origin_m,
        directions=directions,
        ranges_m=ranges,
        points_m=sweep.points_m,
        reflectances=np.maximum(reflectances, weakest),
        road_cosines=road_cosines,
        untouched=untouched,
        intensities=sweep.intensities,
        full_intensity=full,
    )


def _reflectances(sweep: LidarSweep, full: float) -> Float64[np.ndarray, " p"]:
    if sweep.intensities is None:
        return np.full(len(sweep.points_m), MATT)
    return np.maximum(sweep.intensities.astype(np.float64) / full, _SMALLEST_STEPS)


def _are_computed(reflectances: Float64[np.ndarray, " p"]) -> bool:
    """Return whether reflectances have more steps than the 256 or so of a real sensor."""
    return len(np.unique(reflectances)) > max(_FINE_STEPS, _FINE_SHARE * len(reflectances))


# Turns


@dataclass(frozen=True, slots=True, eq=False)
class LidarTurn:
    """One turn of a lidar, with the frame of the rain's regions around it."""

    name: str
    beams: Beams
    anchor_to_world: Pose
    """Frame of the rain's regions: the vehicle's, leveled."""
    sensor: LidarSensor
    scene: Scene | None = None
    """Scene of a virtual turn, whose vehicles throw spray; None for a capture."""


def capture_turns(
    capture: Capture, sensor: LidarSensor, count: int = 1, *, full: float | None = None, estimates_range: bool = True
) -> Iterator[LidarTurn]:
    """Yield evenly spaced sweeps of a capture. With `estimates_range` the sensor's range is estimated from each sweep.

    Raises `ValueError` if there is no sweep, or the capture is not in meters with z up.
    """
    if not capture.sweeps:
        raise ValueError(f"{capture.name}: has no lidar sweeps")
    if not capture.is_metric or abs(capture.up[2] - 1) > 1e-6:
        raise ValueError(f"{capture.name}: its world is not in meters with z up, where rain falls")
    for number in evenly_spaced(len(capture.sweeps), count):
        turn = sweep_turn(capture.sweeps[number], sensor, capture.ego, full=full, estimates_range=estimates_range)
        yield replace(turn, name=f"sweep{number:04d}")


def sweep_turn(
    sweep: LidarSweep,
    sensor: LidarSensor,
    ego: PoseTrack | None,
    *,
    full: float | None = None,
    estimates_range: bool = True,
) -> LidarTurn:
    """Turn of a recorded sweep, with the rain's regions around the vehicle, or around the sensor without one."""
    scale = full_intensity(sweep) if full is None else full
    range_m = estimate_sensor_range(sweep, scale) if estimates_range else None
    own = sensor
    if range_m is not None:
        own = msgspec.structs.replace(sensor, range_m=min(max(range_m, 1.0), 1000.0))
    pose = None if ego is None else ego.pose(sweep.time_s)
    forward, origin = (np.array([1.0, 0.0, 0.0]), sweep.origin_m) if pose is None else (pose[:3, 0], pose[:3, 3])
    return LidarTurn("sweep", sweep_beams(sweep, own, ego, scale), leveled_frame(forward, origin), own)


def scene_turns(
    scene: Scene, sensor: LidarSensor, times_s: Sequence[float], *, matt: float = MATT
) -> Iterator[LidarTurn]:
    """Yield virtual turns of a level sensor `ROOF_M` over the road; raises ValueError without an ego vehicle."""
    for number, time_s in enumerate(times_s):
        ego = scene.ego_to_world(time_s)
        if ego is None:
            raise ValueError(
                f"scene {scene.name!r} has no ego vehicle at {time_s:g} s, whose roof a lidar could stand on"
            )
        frame = leveled_frame(ego[:3, 0], ego[:3, 3])
        pose = frame.copy()
        pose[2, 3] += ROOF_M - EGO_HEIGHT_M
        yield LidarTurn(f"scan{number:04d}", scan_scene(scene, time_s, pose, sensor, matt), frame, sensor, scene)


def evenly_spaced(total: int, count: int) -> list[int]:
    """Indices of `count` evenly spaced items, starting with the first."""
    count = min(count, total)
    return [i * total // count for i in range(count)]


# Sweep files


def write_sweep(path: Path, rainy: RainyScan) -> None:
    """Write `points_m` (world), `origin_m`, `time_s`, `is_false`, `beams`, `fates` and `signals`, and `intensities`.

    `beams` is the beam of each point (for a capture: its row in the clear sweep), `fates` the outcome of each beam's
    clear echo: 0 none, 1 kept, 2 dropped, 3 masked. The file is written atomically and deterministically.
    """
    columns: dict[str, Any] = {
        "points_m": rainy.sweep.points_m,
        "origin_m": rainy.sweep.origin_m,
        "time_s": np.float64(rainy.sweep.time_s),
        "is_false": rainy.is_false,
        "beams": rainy.beams,
        "fates": rainy.fates,
        "signals": rainy.signals.astype(np.float32),
    }
    if rainy.sweep.intensities is not None:
        columns["intensities"] = rainy.sweep.intensities
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **columns)
