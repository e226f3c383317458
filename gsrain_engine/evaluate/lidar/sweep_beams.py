"""Beams of a sweep that a lidar measured in clear air: what its points and intensities tell of them."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsrain_engine.datasets.capture import EGO_HEIGHT_M, Sweep
from gsrain_engine.scene.track import Track

from .beams import Beams
from .sensor import STATED_REFLECTANCE, LidarSensor

RETROREFLECTING = 100.0
"""Where intensities go beyond 1, what is white and matt has this one; what has more is a reflector (as of Velodyne)."""

MATT = 0.2
"""Reflectance of all things, with the cosine of incidence, where a sweep has no intensities."""

ROOF_M = 1.9
"""Height over the road that a sensor is taken to have where its data set puts it on the road: on a car's roof."""

_ON_ROAD_M = 0.5
_ROAD_M = 0.25
"""What lies within this of the road's height is the road."""
_SMALLEST_STEPS = 0.5 / 255
"""Share of the scale that an intensity of 0 is taken for: it was rounded down."""
_SEEN_SHARE = 0.99


def full_intensity(sweep: Sweep) -> float:
    """Guess which intensity a sweep gives to what is white, matt and square to the beam: 1, or 100."""
    if sweep.intensities is None or not len(sweep.intensities) or sweep.intensities.max() <= 1:
        return 1.0
    return RETROREFLECTING


def range_told_by(sweep: Sweep, full: float) -> float | None:
    """Range in metres at which its sensor detects 10 %, as the sweep itself tells; None without intensities.

    Whoever sees the reflectance rho at r sees 10 % at r sqrt(0.1 / rho) at least: 99 % of a sweep's returns lie below
    the value that is taken, since the faintest of them are rounded.
    """
    if sweep.intensities is None:
        return None
    ranges = np.linalg.norm(sweep.points_m - sweep.origin_m, axis=1)
    seen = _reflectances(sweep, full)[ranges > 1]
    if not len(seen):
        return None
    return float(np.quantile(ranges[ranges > 1] * np.sqrt(STATED_REFLECTANCE / seen), _SEEN_SHARE))


def sweep_beams(sweep: Sweep, sensor: LidarSensor, ego: Track | None = None, full: float | None = None) -> Beams:
    """Turn each point of a sweep into a beam. Beams that met nothing are not in a sweep, and stay unknown.

    What was detected was detectable: reflectances, the intensities over `full`, are raised to what the sensor just
    detects where they lie below. Points nearer than the sensor sees (the own vehicle, placeholders at the origin) are
    left alone. With `ego`, the vehicle's track, what lies at its road's height is road; and a sensor that would stand
    on the road (data sets that give points in the vehicle's frame have lost its place) is lifted to `ROOF_M`.
    """
    full = full_intensity(sweep) if full is None else full
    sweep = replace(sweep, origin_m=_origin(sweep, ego))
    away = sweep.points_m.astype(np.float64) - sweep.origin_m
    ranges = np.linalg.norm(away, axis=1)
    untouched = ranges < max(sensor.clear_m, 1e-3)
    directions = away / np.maximum(ranges, 1e-9)[:, None]
    directions[ranges < 1e-9] = (1, 0, 0)
    least = sensor.detectable(np.where(untouched, sensor.clear_m, ranges))
    return Beams(
        time_s=sweep.time_s,
        origin_m=sweep.origin_m,
        directions=directions,
        ranges_m=ranges,
        points_m=sweep.points_m,
        reflectances=np.maximum(_reflectances(sweep, full), least),
        road_cosines=_road_cosines(sweep, ranges, ego),
        untouched=untouched,
        intensities=sweep.intensities,
        full_intensity=full,
    )


def _reflectances(sweep: Sweep, full: float) -> Float64[np.ndarray, " p"]:
    if sweep.intensities is None:
        return np.full(len(sweep.points_m), MATT)
    return np.maximum(sweep.intensities.astype(np.float64) / full, _SMALLEST_STEPS)


def _origin(sweep: Sweep, ego: Track | None) -> Float64[np.ndarray, "3"]:
    pose = None if ego is None else ego.pose(sweep.time_s)
    if pose is None:
        return sweep.origin_m
    up = pose[:3, 2]
    height = float((sweep.origin_m - pose[:3, 3]) @ up) + EGO_HEIGHT_M
    return sweep.origin_m if height > _ON_ROAD_M else sweep.origin_m + (ROOF_M - height) * up


def _road_cosines(sweep: Sweep, ranges_m: Float64[np.ndarray, " p"], ego: Track | None) -> Float64[np.ndarray, " p"]:
    pose = None if ego is None else ego.pose(sweep.time_s)
    if pose is None:
        return np.zeros(len(ranges_m))
    up = pose[:3, 2]  # of a vehicle that stands on a slope, that of the slope
    heights = (sweep.points_m - pose[:3, 3]) @ up + EGO_HEIGHT_M
    sensor_height = float((sweep.origin_m - pose[:3, 3]) @ up) + EGO_HEIGHT_M
    cosines = np.clip((sensor_height - heights) / np.maximum(ranges_m, 1e-9), 0, 1)
    return np.where(np.abs(heights) < _ROAD_M, cosines, 0.0)
