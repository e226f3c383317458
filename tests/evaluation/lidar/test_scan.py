"""Lidars in rain: the sensor's equation, measured sweeps, virtual scans, and what rain makes of them."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.optimize import brentq

from evaluation.lidar.wall_beams import SENSOR, sky_beams, wall_beams
from gsrain_engine.datasets.capture import Capture, LidarSweep
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.evaluation.lidar.rain_echoes import DropReturnModel, wet_road_share
from gsrain_engine.evaluation.lidar.results import ReturnCounts
from gsrain_engine.evaluation.lidar.scan import (
    ROOF_M,
    ReturnOutcome,
    capture_turns,
    estimate_sensor_range,
    evenly_spaced,
    full_intensity,
    scan_in_rain,
    scan_scene,
    scene_turns,
    sweep_beams,
)
from gsrain_engine.evaluation.lidar.sensor import SENSORS, LidarSensor
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.draw import leveled_frame
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import Layer, PoseTrack
from small_scene import small_scene

ANCHOR = np.eye(4)

# The sensor


def test_ten_percent_is_just_detected_at_the_stated_range_and_power_falls_by_the_lidar_equation():
    for sensor in SENSORS.values():
        assert sensor.signal(np.array([sensor.range_m]), np.array([0.1]), 0.0)[0] == pytest.approx(1, rel=1e-12)
    near, far = SENSOR.signal(np.array([20.0, 60.0]), np.array([0.3, 0.3]), 0.01)
    assert near / far == pytest.approx(9 * np.exp(2 * 0.01 * 40), rel=1e-12)
    blind, overlap, clear = SENSOR.detectable(np.array([SENSOR.blind_m / 2, 0.95, 2.0])) / SENSOR.least_reflectance
    assert np.isinf(blind) and (overlap, clear) == pytest.approx((2, 1))
    assert SENSOR.beam_width_m(np.array([0.0, 100.0])) == pytest.approx([0.012, np.hypot(0.012, 0.3)])
    assert SENSOR.range_sigma(np.array([1.0, 25.0])) == pytest.approx([0.05, 0.01])


@pytest.mark.parametrize(
    ("fields", "names"),
    [
        ({"elevations_deg": [70]}, "elevations_deg"),
        ({"elevations_deg": [0], "blind_m": 2, "clear_m": 1}, "clear_m"),
        ({"elevations_deg": []}, "elevations_deg"),
    ],
)
def test_a_sensor_that_cannot_be_is_refused(fields, names):
    with pytest.raises(msgspec.ValidationError, match=names):
        msgspec.convert({"name": "odd", **fields}, LidarSensor)


# Beams in rain


def rained(beams, intensity, seed=0, sensor=SENSOR, **more):
    options = {"answer": "strongest", "wet_road": False} | more
    return scan_in_rain(
        beams, sensor, RainSimulation.start(RainSettings(intensity_mm_h=intensity, seed=seed)), ANCHOR, **options
    )


def test_without_rain_the_same_bytes_come_back():
    rng = np.random.default_rng(0)
    ranges = rng.uniform(2, 90, 5000)
    directions = rng.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    intensities = rng.random(5000).astype(np.float32)
    just = SENSOR.detectable(ranges)  # what is just detected must not be lost to rounding
    beams = replace(wall_beams(ranges, intensities=intensities, directions=directions), reflectances=just)
    back = rained(beams, 0.0, wet_road=True)
    assert back.sweep.points_m.tobytes() == beams.points_m.tobytes()
    assert back.sweep.intensities.tobytes() == intensities.tobytes()
    assert not back.is_false.any()
    np.testing.assert_array_equal(back.fates, ReturnOutcome.KEPT)


@pytest.mark.parametrize("intensity", [1.2, 50.0])
def test_a_wall_shows_the_transmission_of_two_ways(intensity):
    intensities = np.full(400, 0.5, np.float32)
    back = rained(wall_beams(np.full(400, 40.0), intensities=intensities), intensity)
    beta = RainSimulation.start(RainSettings(intensity_mm_h=intensity)).state.extinction_per_m
    np.testing.assert_allclose(back.sweep.intensities[~back.is_false], 0.5 * np.exp(-2 * beta * 40.0), rtol=1e-6)


def test_walls_vanish_where_the_lidar_equation_has_them_at_the_threshold():
    beta = RainSimulation.start(RainSettings(intensity_mm_h=30.0)).state.extinction_per_m
    ranges, reflectances = [], np.repeat([0.05, 0.1, 0.5], 2)
    for reflectance in reflectances[::2]:
        reach = brentq(lambda r, rho=reflectance: rho / 0.1 * (100 / r) ** 2 * np.exp(-2 * beta * r) - 1, 10, 300)
        assert reach < 0.9 * 100 * np.sqrt(reflectance / 0.1)  # rain matters
        ranges += [reach - 0.01, reach + 0.01]
    back = rained(replace(wall_beams(ranges), reflectances=reflectances), 30.0)
    assert back.fates.tolist() == [ReturnOutcome.KEPT, ReturnOutcome.DROPPED] * 3


def test_more_rain_keeps_fewer_and_adds_drops():
    rng = np.random.default_rng(1)
    walls = wall_beams(rng.uniform(5, 100, 4000), directions=sky_beams(4000).directions)
    walls = replace(walls, reflectances=SENSOR.detectable(walls.ranges_m) * rng.uniform(1, 3, 4000))
    detected, false = [], []
    for intensity in (0.0, 8.5, 30.0):
        back = rained(walls, intensity)
        detected.append(set(np.flatnonzero(back.fates != ReturnOutcome.DROPPED).tolist()))
        false.append(int(rained(sky_beams(8000), intensity).is_false.sum()))
    for less, more in zip(detected[1:], detected[:-1], strict=True):
        assert less < more
    assert false[0] == 0 < false[1]
    assert false == sorted(false)


def test_the_seed_fixes_everything_and_another_one_changes_the_drops():
    first, second, other = (rained(sky_beams(5000), 20.0, seed) for seed in (3, 3, 4))
    assert first.sweep.points_m.tobytes() == second.sweep.points_m.tobytes()
    assert first.beams.tobytes() == second.beams.tobytes()
    assert len(first.beams) > 20
    assert first.sweep.points_m.tobytes() != other.sweep.points_m.tobytes()


def test_false_returns_are_as_many_as_beams_with_a_drop():
    """Beams into the open sky report a drop with the chance 1 - exp(-mean), each drop once in few beams."""
    beams = sky_beams(3000)
    total = sum(int(rained(beams, 12.0, seed).is_false.sum()) for seed in range(4))
    mean = DropReturnModel(SENSOR, RainSimulation.start(RainSettings(intensity_mm_h=12.0)).state).expected[-1]
    expected = 4 * 3000 * (1 - np.exp(-mean))
    # Near drops are in several of so many beams: twice the Poisson spread is allowed for.
    assert abs(total - expected) < 2 * 4 * np.sqrt(expected)


def test_which_echo_answers():
    walls = wall_beams(np.full(4000, 30.0), 0.2, directions=sky_beams(4000).directions)
    first, strongest, last = (rained(walls, 50.0, answer=answer) for answer in ("first", "strongest", "last"))
    assert first.is_false.sum() > 50
    assert strongest.is_false.sum() < first.is_false.sum() / 2
    assert not last.is_false.any()
    assert np.sum(first.fates == ReturnOutcome.MASKED) == first.is_false.sum()
    assert np.all(first.false_ranges_m < 30)
    assert len(np.unique(first.beams)) == len(first.beams) == 4000


def test_noise_grows_as_the_signal_gets_weaker_and_only_by_what_rain_adds():
    far, near = (rained(wall_beams(np.full(4000, r), 0.2), 30.0) for r in (70.0, 20.0))
    added = []
    for back, r in ((far, 70.0), (near, 20.0)):
        true = ~back.is_false
        ranges = np.linalg.norm(back.sweep.points_m[true].astype(float), axis=1)
        clear = SENSOR.signal(np.array([r]), np.array([0.2]), 0.0)[0]
        rainy = back.signals[true][0]
        sigma = np.sqrt(0.05**2 / rainy - 0.05**2 / clear)
        assert abs(np.std(ranges) / sigma - 1) < 4 / np.sqrt(2 * len(ranges))
        assert abs(np.mean(ranges) - r) < 4 * sigma / np.sqrt(len(ranges))
        added.append(sigma)
    assert added[0] > 5 * added[1]


def test_a_wet_road_loses_what_its_film_mirrors():
    cosine = 0.05
    beams = wall_beams(np.full(50, 38.0), 0.4 * cosine, np.full(50, 0.4, np.float32), road_cosines=cosine)
    rainfall = RainSimulation.start(RainSettings(intensity_mm_h=8.5))
    dry = rained(beams, 8.5)
    wet = rained(beams, 8.5, wet_road=True)
    share = wet_road_share(np.array([cosine]), np.array([0.4]), rainfall.wetness_at(0.0), 0.0, 905)[0]
    assert np.all(dry.fates == ReturnOutcome.KEPT) and np.all(wet.fates == ReturnOutcome.DROPPED)
    np.testing.assert_allclose(wet.signals, [])
    brighter = replace(beams, reflectances=beams.reflectances * 20)
    both = [rained(brighter, 8.5, wet_road=on).signals for on in (False, True)]
    limit = wet_road_share(np.array([cosine]), np.array([1.0]), rainfall.wetness_at(0.0), 0.0, 905)[0]
    assert share < limit  # brighter ground lights its film more
    assert both[1][0] / both[0][0] == pytest.approx(limit, rel=0.02)


def test_what_rain_leaves_alone_is_left_alone():
    beams = wall_beams([0.0, 0.5, 30.0], intensities=np.array([7, 8, 9], np.float32))
    beams = replace(beams, untouched=np.array([True, True, False]))
    back = rained(beams, 50.0)
    np.testing.assert_array_equal(back.sweep.points_m[:2], beams.points_m[:2])
    np.testing.assert_array_equal(back.sweep.intensities[:2], [7, 8])
    assert back.sweep.intensities[2] < 9


def test_a_tally_counts_every_beam_once():
    beams = wall_beams(np.linspace(2, 140, 3000), 0.1, directions=sky_beams(3000).directions).heard_by(SENSOR)
    back = rained(beams, 50.0, answer="first")
    tally = ReturnCounts.of(beams, back)
    np.testing.assert_array_equal(
        tally.clear, np.histogram(beams.ranges_m[beams.is_echo], [*tally.edges_m[:-1], 1e9])[0]
    )
    np.testing.assert_array_equal(tally.kept + tally.dropped + tally.masked, tally.clear)
    assert tally.false.sum() == back.is_false.sum() > 0
    assert tally.kept.sum() + tally.false.sum() == len(back.beams)
    assert 0 < tally.range_rmse_m < 0.05
    assert np.isnan(tally.return_share()[-1]) and tally.clear[-1] == 0


# Beams of a measured sweep

EGO = PoseTrack(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones(1, bool))


def sweep(points, intensities=None, origin=(0.0, 0.0, 0.4)):
    light = None if intensities is None else np.array(intensities, np.float32)
    return LidarSweep(0.0, np.array(points, np.float32), np.array(origin), light)


def test_reflectances_are_intensities_raised_to_what_is_just_detected():
    beams = sweep_beams(sweep([[10, 0, 0.4], [90, 0, 0.4]], [0.5, 0.01]), SENSOR)
    assert beams.reflectances == pytest.approx([0.5, SENSOR.detectable(np.array([90.0]))[0]])
    assert full_intensity(sweep([[1, 0, 0]], [0.9])) == 1 and full_intensity(sweep([[1, 0, 0]], [90])) == 100


def test_the_own_car_is_left_alone_and_the_road_is_what_lies_at_its_height():
    beams = sweep_beams(sweep([[0, 0, 0.4], [0.3, 0, 0.4], [10, 0, 0]]), SENSOR)
    assert beams.untouched.tolist() == [True, True, False] and np.isfinite(beams.directions).all()
    beams = sweep_beams(sweep([[10, 0, -1.5], [10, 0, 0.4], [20, 0, -1.4]]), SENSOR, EGO)
    assert beams.road_cosines[:2] == pytest.approx([1.9 / np.hypot(10, 1.9), 0]) and beams.road_cosines[2] > 0
    flat = sweep([[10, 0, -1.5]], origin=(0.0, 0.0, -1.5))  # a sensor on the road is lifted to the roof
    beams = sweep_beams(flat, SENSOR, EGO)
    assert beams.origin_m[2] == pytest.approx(ROOF_M - 1.5) and beams.points_m.tobytes() == flat.points_m.tobytes()


def test_a_sweep_shows_how_far_its_sensor_detects():
    rng = np.random.default_rng(0)
    ranges, light = rng.uniform(2, 200, 20_000), rng.uniform(0.01, 1, 20_000)
    heard = light >= 0.1 * (ranges / 120) ** 2
    points = np.stack([ranges, np.zeros(20_000), np.full(20_000, 0.4)], axis=1)[heard]
    assert 112 < estimate_sensor_range(sweep(points, light[heard]), 1.0) <= 120
    assert estimate_sensor_range(sweep(points), 1.0) is None


def test_captures_without_a_sweep_or_without_metres_are_refused():
    with pytest.raises(ValueError, match="bare: "):
        list(capture_turns(Capture("bare", ()), SENSOR))
    with pytest.raises(ValueError, match="free: "):
        list(capture_turns(Capture("free", (), sweeps=(sweep([[1, 0, 0]]),), is_metric=False), SENSOR))


@pytest.mark.parametrize("capture", ["driving/dgp/scene_02", "driving/nuscenes_sample"])
def test_real_sweeps_in_rain(test_data, capture):
    """0 mm/h gives the points back to the bit; in rain the far ones are lost, and no near one to extinction."""
    capture = open_capture(test_data / capture)
    turn = next(iter(capture_turns(capture, SENSOR)))
    own = capture.sweeps[0]
    assert 40 < turn.sensor.range_m < 250

    def rained(intensity):
        rainfall = RainSimulation.start(RainSettings(intensity_mm_h=intensity))
        return scan_in_rain(turn.beams, turn.sensor, rainfall, turn.anchor_to_world, wet_road=intensity == 0)

    clear = rained(0.0)
    assert clear.sweep.points_m.tobytes() == own.points_m.tobytes()
    assert clear.sweep.intensities.tobytes() == own.intensities.tobytes()
    lost = rained(12.0).fates == ReturnOutcome.DROPPED
    assert 0.005 < lost.mean() < 0.2
    # Extinction takes exp(-2 beta r) <= 1 - 1/e^(1/6) up to 33 m: only what was within that of the threshold can go.
    margin = turn.sensor.signal(np.maximum(turn.beams.ranges_m, 1.0), turn.beams.reflectances, 0.0)
    beta = RainSimulation.start(RainSettings(intensity_mm_h=12.0)).state.extinction_per_m
    expected = turn.beams.is_echo & (margin * np.exp(-2 * beta * turn.beams.ranges_m) < 1)
    np.testing.assert_array_equal(lost, expected)


def test_a_estimates_range_can_be_overruled(test_data):
    capture = open_capture(test_data / "driving/nuscenes_sample")
    sensor = msgspec.structs.replace(SENSOR, range_m=70.0)
    assert next(iter(capture_turns(capture, sensor, estimates_range=False))).sensor.range_m == 70


ROSETTE = LidarSensor(
    name="narrow rosette", elevations_deg=(0.0,), blind_m=1.0, clear_m=3.0, beam_mm=30.0, divergence_mrad=1.0
)


def test_its_receiver_holds_its_gain_back_and_ours_does(test_data):
    capture = open_capture(test_data / "weather/rainsense/torriential_rain/scene_6/case_000")
    turn = next(iter(capture_turns(capture, ROSETTE)))
    ranges = turn.beams.ranges_m[~turn.beams.untouched]
    assert len(ranges) > 6000 and np.min(ranges) > 6  # it saw no drop before the road begins
    rainfall = RainSimulation.start(RainSettings(intensity_mm_h=9.245))

    def false_returns(least):
        sensor = msgspec.structs.replace(turn.sensor, least_reflectance=least)
        return int(scan_in_rain(turn.beams, sensor, rainfall, turn.anchor_to_world).is_false.sum())

    assert false_returns(0.0) > 200
    assert false_returns(1e-4) < 10
    assert false_returns(ROSETTE.least_reflectance) == 0


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


def test_every_beam_is_there_once_and_the_road_is_where_it_meets_the_ground(scan):
    assert len(scan) == len(np.unique(scan.directions.round(9), axis=0)) == 4 * 720
    np.testing.assert_allclose(np.linalg.norm(scan.directions, axis=1), 1)
    for elevation in (-12.0, -6.0):
        beams, down = ring(scan, elevation, 10.0), np.sin(np.radians(-elevation))
        np.testing.assert_allclose(scan.ranges_m[beams], 1.9 / down, rtol=0.005)
        np.testing.assert_allclose(scan.road_cosines[beams], down, rtol=0.01)
    assert scan_scene(thin_scene(), 0.0, POSE, RINGS).points_m.tobytes() == scan.points_m.tobytes()


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


def test_frames_are_level_and_some_are_chosen_evenly():
    frame = leveled_frame(np.array([0.0, 2.0, 0.5]), np.array([1.0, 2, 3]))
    np.testing.assert_allclose(frame @ [1, 0, 0, 1], [1, 3, 3, 1])
    np.testing.assert_allclose(frame[:3, 2], [0, 0, 1])
    assert evenly_spaced(10, 3) == [0, 3, 6] and evenly_spaced(2, 5) == [0, 1]


def test_rings_that_all_point_down_or_up_are_in_the_picture(scan):
    down = msgspec.structs.replace(RINGS, elevations_deg=(-12.0, -6.0))
    expected = np.isin(np.degrees(np.arcsin(scan.directions[:, 2])).round(6), (-12.0, -6.0))
    np.testing.assert_allclose(scan_scene(thin_scene(), 0.0, POSE, down).ranges_m, scan.ranges_m[expected], rtol=1e-4)
    up = msgspec.structs.replace(RINGS, elevations_deg=(1.0, 10.0))
    expected = scan.directions[:, 2] > 0
    np.testing.assert_allclose(scan_scene(thin_scene(), 0.0, POSE, up).ranges_m, scan.ranges_m[expected], rtol=1e-4)
