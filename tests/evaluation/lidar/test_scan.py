"""Lidars in rain: the sensor's equation, measured sweeps and virtual scans."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.optimize import brentq

from evaluation.lidar.wall_beams import SENSOR, sky_beams, wall_beams
from gsrain_engine.datasets.capture import LidarSweep
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.evaluation.lidar.rain_echoes import DropReturnModel, wet_road_share
from gsrain_engine.evaluation.lidar.results import ReturnCounts, lidar_figure, rain_runs
from gsrain_engine.evaluation.lidar.scan import (
    ROOF_M,
    ReturnOutcome,
    _meet,
    capture_turns,
    estimate_sensor_range,
    full_intensity,
    scan_in_rain,
    scan_scene,
    scene_turns,
    sweep_beams,
)
from gsrain_engine.evaluation.lidar.sensor import SENSORS, LidarSensor
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import Layer, PoseTrack
from small_scene import small_scene

# The sensor


def test_signals_follow_the_lidar_equation():
    for sensor in SENSORS.values():
        assert sensor.signal(np.array([sensor.range_m]), np.array([0.1]), 0.0)[0] == pytest.approx(1, rel=1e-12)
    near, far = SENSOR.signal(np.array([20.0, 60.0]), np.array([0.3, 0.3]), 0.01)
    assert near / far == pytest.approx(9 * np.exp(2 * 0.01 * 40), rel=1e-12)
    blind, overlap, clear = SENSOR.detectable(np.array([SENSOR.blind_m / 2, 0.95, 2.0])) / SENSOR.least_reflectance
    assert np.isinf(blind) and (overlap, clear) == pytest.approx((2, 1))
    assert SENSOR.beam_width_m(np.array([0.0, 100.0])) == pytest.approx([0.012, np.hypot(0.012, 0.3)])
    assert SENSOR.range_sigma(np.array([1.0, 25.0])) == pytest.approx([0.05, 0.01])
    for fields in ({"elevations_deg": [70]}, {"elevations_deg": [0], "blind_m": 2, "clear_m": 1}):
        with pytest.raises(msgspec.ValidationError, match=list(fields)[-1]):
            msgspec.convert({"name": "odd", **fields}, LidarSensor)


# Beams in rain


def rain_of(intensity, seed=0):
    return RainSimulation.start(RainSettings(intensity_mm_h=intensity, seed=seed))


def rained(beams, intensity, seed=0, **more):
    options = {"answer": "strongest", "wet_road": False} | more
    return scan_in_rain(beams, SENSOR, rain_of(intensity, seed), np.eye(4), **options)


def test_without_rain_the_bytes_are_the_same():
    rng = np.random.default_rng(0)
    ranges = rng.uniform(2, 90, 5000)
    directions = rng.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    intensities = rng.random(5000).astype(np.float32)
    just = SENSOR.detectable(ranges)  # echoes at the threshold must not be lost to rounding
    beams = replace(wall_beams(ranges, intensities=intensities, directions=directions), reflectances=just)
    back = rained(beams, 0.0, wet_road=True)
    assert back.sweep.points_m.tobytes() == beams.points_m.tobytes()
    assert back.sweep.intensities.tobytes() == intensities.tobytes()
    assert not back.is_false.any()
    np.testing.assert_array_equal(back.fates, ReturnOutcome.KEPT)


def test_walls_are_lost_beyond_the_threshold_of_the_lidar_equation():
    beta = rain_of(30.0).state.extinction_per_m
    ranges, reflectances = [], np.repeat([0.05, 0.1, 0.5], 2)
    for reflectance in reflectances[::2]:
        reach = brentq(lambda r, rho=reflectance: rho / 0.1 * (100 / r) ** 2 * np.exp(-2 * beta * r) - 1, 10, 300)
        assert reach < 0.9 * 100 * np.sqrt(reflectance / 0.1)  # rain matters
        ranges += [reach - 0.01, reach + 0.01]
    intensities, untouched = np.full(7, 0.5, np.float32), np.arange(7) == 6
    beams = wall_beams([*ranges, 0.5], intensities=intensities)
    back = rained(replace(beams, reflectances=np.append(reflectances, 1), untouched=untouched), 30.0)
    kept, dropped = ReturnOutcome.KEPT, ReturnOutcome.DROPPED
    assert back.fates.tolist() == [kept, dropped, kept, dropped, kept, dropped, ReturnOutcome.NOTHING]
    faded = [*np.exp(-2 * beta * np.array(ranges[::2])), 1]  # rain does not affect the own vehicle
    np.testing.assert_allclose(back.sweep.intensities, 0.5 * np.array(faded), rtol=1e-6)


def test_more_rain_loses_more_echoes_and_adds_drops():
    rng = np.random.default_rng(1)
    walls = wall_beams(rng.uniform(5, 100, 4000), directions=sky_beams(4000).directions)
    walls = replace(walls, reflectances=SENSOR.detectable(walls.ranges_m) * rng.uniform(1, 3, 4000))
    detected = [set(np.flatnonzero(rained(walls, rate).fates != ReturnOutcome.DROPPED)) for rate in (0.0, 8.5, 30.0)]
    assert detected[0] > detected[1] > detected[2]
    false = [int(rained(sky_beams(8000), rate).is_false.sum()) for rate in (0.0, 8.5, 30.0)]
    assert 0 == false[0] < false[1] < false[2]


def test_false_returns_are_as_many_as_beams_with_a_drop():
    """Beams into the open sky report a drop with the probability 1 - exp(-mean)."""
    total = sum(int(rained(sky_beams(3000), 12.0, seed).is_false.sum()) for seed in range(4))
    expected = 4 * 3000 * (1 - np.exp(-DropReturnModel(SENSOR, rain_of(12.0).state).expected[-1]))
    # Near drops are in several of so many beams: twice the Poisson spread is allowed.
    assert abs(total - expected) < 2 * 4 * np.sqrt(expected)


def test_answers_of_several_echoes():
    walls = wall_beams(np.full(4000, 30.0), 0.2, directions=sky_beams(4000).directions)
    first, strongest, last = (rained(walls, 50.0, answer=answer) for answer in ("first", "strongest", "last"))
    assert first.is_false.sum() > 50
    assert strongest.is_false.sum() < first.is_false.sum() / 2
    assert not last.is_false.any()
    assert np.sum(first.fates == ReturnOutcome.MASKED) == first.is_false.sum()
    assert np.all(first.false_ranges_m < 30)
    assert len(np.unique(first.beams)) == len(first.beams) == 4000


def test_noise_grows_by_what_rain_adds():
    added = []
    for r in (70.0, 20.0):
        back = rained(wall_beams(np.full(4000, r), 0.2), 30.0)
        true = ~back.is_false
        ranges = np.linalg.norm(back.sweep.points_m[true].astype(float), axis=1)
        clear = SENSOR.signal(np.array([r]), np.array([0.2]), 0.0)[0]
        sigma = np.sqrt(0.05**2 / back.signals[true][0] - 0.05**2 / clear)
        assert abs(np.std(ranges) / sigma - 1) < 4 / np.sqrt(2 * len(ranges))
        assert abs(np.mean(ranges) - r) < 4 * sigma / np.sqrt(len(ranges))
        added.append(sigma)
    assert added[0] > 5 * added[1]


def test_wet_road_loses_what_its_film_mirrors():
    cosine = 0.05
    beams = wall_beams(np.full(50, 38.0), 0.4 * cosine, np.full(50, 0.4, np.float32), road_cosines=cosine)
    dry, wet = (rained(beams, 8.5, wet_road=on).fates for on in (False, True))
    assert np.all(dry == ReturnOutcome.KEPT) and np.all(wet == ReturnOutcome.DROPPED)
    brighter = replace(beams, reflectances=beams.reflectances * 20)
    dry, wet = (rained(brighter, 8.5, wet_road=on).signals for on in (False, True))
    share = wet_road_share(np.array([cosine]), np.array([1.0]), rain_of(8.5).wetness_at(0.0), 0.0, 905)[0]
    assert wet[0] / dry[0] == pytest.approx(share, rel=0.02)


def test_every_beam_is_counted_once():
    beams = wall_beams(np.linspace(2, 140, 3000), 0.1, directions=sky_beams(3000).directions).heard_by(SENSOR)
    back = rained(beams, 50.0, answer="first")
    counts = ReturnCounts.of(beams, back)
    edges = [*counts.edges_m[:-1], 1e9]
    np.testing.assert_array_equal(counts.clear, np.histogram(beams.ranges_m[beams.is_echo], edges)[0])
    np.testing.assert_array_equal(counts.kept + counts.dropped + counts.masked, counts.clear)
    assert counts.false.sum() == back.is_false.sum() > 0
    assert counts.kept.sum() + counts.false.sum() == len(back.beams)
    assert 0 < counts.range_rmse_m < 0.05
    assert np.isnan(counts.return_share()[-1]) and counts.clear[-1] == 0


# Beams of a measured sweep

EGO = PoseTrack(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones(1, bool))


def sweep(points, intensities=None, origin=(0.0, 0.0, 0.4)):
    light = None if intensities is None else np.array(intensities, np.float32)
    return LidarSweep(0.0, np.array(points, np.float32), np.array(origin), light)


def test_reflectances_are_intensities_from_the_threshold_on():
    beams = sweep_beams(sweep([[10, 0, 0.4], [90, 0, 0.4]], [0.5, 0.01]), SENSOR)
    assert beams.reflectances == pytest.approx([0.5, SENSOR.detectable(np.array([90.0]))[0]])
    assert full_intensity(sweep([[1, 0, 0]], [0.9])) == 1 and full_intensity(sweep([[1, 0, 0]], [90])) == 100


def test_points_of_a_sweep_are_vehicle_road_or_others():
    beams = sweep_beams(sweep([[0, 0, 0.4], [0.3, 0, 0.4], [10, 0, 0]]), SENSOR)
    assert beams.untouched.tolist() == [True, True, False] and np.isfinite(beams.directions).all()
    beams = sweep_beams(sweep([[10, 0, -1.5], [10, 0, 0.4], [20, 0, -1.4]]), SENSOR, EGO)
    assert beams.road_cosines[:2] == pytest.approx([1.9 / np.hypot(10, 1.9), 0]) and beams.road_cosines[2] > 0
    flat = sweep([[10, 0, -1.5]], origin=(0.0, 0.0, -1.5))  # a sensor on the road is raised to the roof
    beams = sweep_beams(flat, SENSOR, EGO)
    assert beams.origin_m[2] == pytest.approx(ROOF_M - 1.5) and beams.points_m.tobytes() == flat.points_m.tobytes()


def test_range_of_a_sensor_is_estimated_from_its_sweep():
    rng = np.random.default_rng(0)
    ranges, light = rng.uniform(2, 200, 20_000), rng.uniform(0.01, 1, 20_000)
    heard = light >= 0.1 * (ranges / 120) ** 2
    points = np.stack([ranges, np.zeros(20_000), np.full(20_000, 0.4)], axis=1)[heard]
    assert 112 < estimate_sensor_range(sweep(points, light[heard]), 1.0) <= 120
    assert estimate_sensor_range(sweep(points), 1.0) is None


@pytest.mark.parametrize("capture", ["driving/dgp/scene_02", "driving/nuscenes_sample"])
def test_real_sweeps_lose_what_extinction_puts_below_the_threshold(test_data, capture):
    capture = open_capture(test_data / capture)
    turn = next(iter(capture_turns(capture, SENSOR)))
    assert 40 < turn.sensor.range_m < 250
    assert next(iter(capture_turns(capture, SENSOR, estimates_range=False))).sensor == SENSOR

    def rained(intensity, wet_road):
        return scan_in_rain(turn.beams, turn.sensor, rain_of(intensity), turn.anchor_to_world, wet_road=wet_road)

    clear = rained(0.0, True).sweep
    assert clear.points_m.tobytes() == capture.sweeps[0].points_m.tobytes()
    assert clear.intensities.tobytes() == capture.sweeps[0].intensities.tobytes()
    lost = rained(12.0, False).fates == ReturnOutcome.DROPPED
    assert 0.005 < lost.mean() < 0.2
    margin = turn.sensor.signal(np.maximum(turn.beams.ranges_m, 1.0), turn.beams.reflectances, 0.0)
    faded = margin * np.exp(-2 * rain_of(12.0).state.extinction_per_m * turn.beams.ranges_m)
    np.testing.assert_array_equal(lost, turn.beams.is_echo & (faded < 1))


# Virtual scans

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


def test_beams_meet_the_road(scan):
    assert len(scan) == len(np.unique(scan.directions.round(9), axis=0)) == 4 * 720
    np.testing.assert_allclose(np.linalg.norm(scan.directions, axis=1), 1)
    for elevation in (-12.0, -6.0):
        beams, down = ring(scan, elevation, 10.0), np.sin(np.radians(-elevation))
        np.testing.assert_allclose(scan.ranges_m[beams], 1.9 / down, rtol=0.005)
        np.testing.assert_allclose(scan.road_cosines[beams], down, rtol=0.01)
    assert scan_scene(thin_scene(), 0.0, POSE, RINGS).points_m.tobytes() == scan.points_m.tobytes()


def test_beams_meet_the_wall(scan):
    beams = ring(scan, 1.0, 12.0)
    np.testing.assert_allclose(scan.points_m[beams, 0], 40.0, rtol=0.002)
    np.testing.assert_array_equal(scan.road_cosines[beams], 0)
    middle = beams[np.abs(scan.directions[beams, 1]) < 0.1]
    np.testing.assert_allclose(scan.reflectances[middle], 0.2 * scan.directions[middle, 0], rtol=0.01)


def test_beams_into_the_sky_or_nothing_have_no_echo(scan):
    behind = scan.directions[:, 0] < -0.2
    assert behind.any() and np.isinf(scan.ranges_m[behind]).all()
    high = ring(scan, 10.0, 170.0)
    sky = high[(np.abs(scan.directions[high, 1]) < 0.2) & (scan.directions[high, 0] > 0.5)]  # over the wall
    assert len(sky) and np.isinf(scan.ranges_m[sky]).all()


def test_runs_of_turns_have_a_figure():
    (turn,) = scene_turns(thin_scene(), msgspec.structs.replace(RINGS, range_m=30.0), [0.0])
    np.testing.assert_allclose(turn.beams.origin_m, (0, 0, 1.9))
    runs = list(rain_runs(turn, RainSettings(), (0.0, 50.0), (0, 1), answer="strongest", wet_road=True))
    counts = [run.counts for run in runs]
    assert [(each.state.intensity_mm_h, each.seed) for each in counts] == [(0, 0), (0, 1), (50, 0), (50, 1)]
    assert counts[0].tally.clear.sum() == counts[0].tally.kept.sum() > counts[3].tally.kept.sum()
    assert 0 == counts[0].near.false.sum() < counts[3].near.false.sum()
    assert lidar_figure(runs[3], {0.0: counts[:2], 50.0: counts[2:]}).std() > 10


def test_beams_without_a_direction_are_refused_and_no_place_is_read_beyond_the_image():
    pose = np.eye(4)
    for wrong in (np.nan, np.inf, 0.0, 1e308):
        own = np.array([[1.0, 0, 0], [wrong, 0, 0]])
        with pytest.raises(ValueError, match="directions"):
            scan_scene(thin_scene(), 0.0, pose, SENSORS["64"], own=own)
    with pytest.raises(ValueError, match="sensor_to_world"):
        scan_scene(thin_scene(), 0.0, np.full((4, 4), np.nan), SENSORS["64"])
    hostile = np.array([np.nan, np.inf, -np.inf, -1.0, 16.0, 1e308, 5.0])
    places = np.stack([hostile, np.full(len(hostile), 5.0)], axis=1)
    found = np.zeros((len(places), 4))
    shapes = np.array([[5, 5, 0, -0.1, -0.1, 0, -6, 8]], np.float32)  # one splat, in one tile
    planes = np.array([[0.0, 0, -1, -3, 3]])
    lists = np.array([0, 1]), np.array([0], np.int32), 1
    _meet(shapes, *lists, planes, np.zeros(1, bool), np.tile([0.0, 0, 1], (len(places), 1)), places, found)
    np.testing.assert_array_equal(found[:, 0], [0, 0, 0, 0, 0, 0, 3])
    _meet(shapes, *lists, planes, np.zeros(1, bool), np.tile([0.0, 0, 1], (len(places), 1)), places[:, ::-1], found)
    np.testing.assert_array_equal(found[:, 0], [0, 0, 0, 0, 0, 0, 3])
