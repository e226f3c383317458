"""Beams of a sensor at the world's origin that hit what they are told to."""

import numpy as np

from gsrain_engine.evaluation.lidar.sensor import Beams, LidarSensor

SENSOR = LidarSensor(name="test", elevations_deg=(0.0,), range_m=100.0, farthest_m=200.0)


def wall_beams(ranges_m, reflectance=0.5, intensities=None, directions=None, road_cosines=0.0):
    ranges = np.asarray(ranges_m, float)
    n = len(ranges)
    if directions is None:
        directions = np.tile([0.6, 0.0, 0.8], (n, 1))
    hit = np.where(np.isfinite(ranges), ranges, 0)
    return Beams(
        time_s=0.0,
        origin_m=np.zeros(3),
        directions=directions,
        ranges_m=ranges,
        points_m=(directions * hit[:, None]).astype(np.float32),
        reflectances=np.full(n, reflectance),
        road_cosines=np.full(n, road_cosines),
        untouched=np.zeros(n, bool),
        intensities=intensities,
    )


def sky_beams(count, seed=0):
    """Beams into the upper half of the sky, in all directions, that hit nothing."""
    z = np.random.default_rng(seed).normal(size=(count, 3))
    directions = z / np.linalg.norm(z, axis=1, keepdims=True)
    directions[:, 2] = np.abs(directions[:, 2])
    return wall_beams(np.full(count, np.inf), directions=directions)
