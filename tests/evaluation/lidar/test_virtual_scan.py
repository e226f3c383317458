from dataclasses import replace

import msgspec
import numpy as np
import pytest

from evaluation.lidar.wall_beams import SENSOR
from gsrain_engine.evaluation.lidar.scan import evenly_spaced, scan_scene, scene_turns
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import Layer
from small_scene import small_scene

RINGS = msgspec.structs.replace(
    SENSOR, elevations_deg=(-12.0, -6.0, 1.0, 10.0), azimuth_step_deg=0.5, range_m=400.0, farthest_m=500.0
)


POSE = np.eye(4)
POSE[:3, 3] = (0.0, 0.0, 1.9)


def sheet(first, second, place, scales):
    """Thin Gaussians on a rectangle."""
    grid = np.stack([each.ravel() for each in np.meshgrid(first, second)], axis=1)
    n = len(grid)
    means = np.array([place(*each) for each in grid], np.float32)
    return Gaussians(
        means,
        np.tile(np.array(scales, np.float32), (n, 1)),
        np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        np.full(n, 0.95, np.float32),
        sh_from_color(np.full((n, 3), 0.4, np.float32)),
    )


def thin_scene():
    """A road at z = 0 and a wall at x = 40 m, both a centimetre thick, before the small scene's sky."""
    road = sheet(np.arange(2, 40, 0.3), np.arange(-8, 8, 0.3), lambda x, y: (x, y, 0), (0.2, 0.2, 0.005))
    wall = sheet(np.arange(-12, 12, 0.3), np.arange(0, 6, 0.3), lambda y, z: (40, y, z), (0.005, 0.2, 0.2))
    scene = small_scene()
    return replace(scene, layers=(Layer("road", road), Layer("wall", wall), scene.layers[2]))


@pytest.fixture(scope="module")
def scan():
    return scan_scene(thin_scene(), 0.0, POSE, RINGS)


def ring(scan, elevation_deg, within_deg):
    directions = scan.directions
    level = np.abs(np.degrees(np.arcsin(directions[:, 2])) - elevation_deg) < 0.01
    return np.flatnonzero(level & (np.abs(np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))) < within_deg))


def test_every_beam_is_there_once(scan):
    assert len(scan) == 4 * 720
    assert len(np.unique(scan.directions.round(9), axis=0)) == len(scan)
    np.testing.assert_allclose(np.linalg.norm(scan.directions, axis=1), 1)


def test_the_road_is_where_beams_meet_the_ground(scan):
    for elevation in (-12.0, -6.0):
        beams = ring(scan, elevation, 10.0)
        wanted = 1.9 / np.sin(np.radians(-elevation))
        np.testing.assert_allclose(scan.ranges_m[beams], wanted, rtol=0.005)
        np.testing.assert_allclose(scan.road_cosines[beams], np.sin(np.radians(-elevation)), rtol=0.01)


def test_the_wall_is_where_beams_meet_it_and_is_no_road(scan):
    beams = ring(scan, 1.0, 12.0)
    np.testing.assert_allclose(scan.ranges_m[beams] * scan.directions[beams, 0], 40.0, rtol=0.002)
    np.testing.assert_array_equal(scan.road_cosines[beams], 0)
    middle = beams[np.abs(scan.directions[beams, 1]) < 0.1]
    np.testing.assert_allclose(scan.reflectances[middle], 0.2 * scan.directions[middle, 0], rtol=0.01)
    np.testing.assert_allclose(scan.points_m[beams, 0], 40.0, rtol=0.002)


def test_the_sky_and_what_is_behind_are_nothing(scan):
    behind = scan.directions[:, 0] < -0.2
    assert behind.any() and np.isinf(scan.ranges_m[behind]).all()
    high = ring(scan, 10.0, 170.0)
    beyond_wall = high[np.abs(scan.directions[high, 1]) < 0.2]  # over the wall's top, where the sky is
    sky = beyond_wall[scan.directions[beyond_wall, 0] > 0.5]
    assert len(sky) and np.isinf(scan.ranges_m[sky]).all()


def test_a_weak_sensor_hears_less():
    weak = msgspec.structs.replace(RINGS, range_m=15.0)
    turns = [next(iter(scene_turns(thin_scene(), sensor, [0.0]))) for sensor in (RINGS, weak)]
    assert 0 < turns[1].beams.is_echo.sum() < turns[0].beams.is_echo.sum()
    np.testing.assert_allclose(turns[0].beams.origin_m, (0, 0, 1.9))


def test_a_scan_is_the_same_each_time(scan):
    assert scan_scene(thin_scene(), 0.0, POSE, RINGS).points_m.tobytes() == scan.points_m.tobytes()


def test_some_are_chosen_evenly():
    assert evenly_spaced(10, 3) == [0, 3, 6]
    assert evenly_spaced(2, 5) == [0, 1]


def test_rings_that_all_point_down_or_up_are_in_the_picture(scan):
    down = msgspec.structs.replace(RINGS, elevations_deg=(-12.0, -6.0))
    wanted = np.isin(np.degrees(np.arcsin(scan.directions[:, 2])).round(6), (-12.0, -6.0))
    np.testing.assert_allclose(scan_scene(thin_scene(), 0.0, POSE, down).ranges_m, scan.ranges_m[wanted], rtol=1e-4)
    up = msgspec.structs.replace(RINGS, elevations_deg=(1.0, 10.0))
    wanted = scan.directions[:, 2] > 0
    np.testing.assert_allclose(scan_scene(thin_scene(), 0.0, POSE, up).ranges_m, scan.ranges_m[wanted], rtol=1e-4)
