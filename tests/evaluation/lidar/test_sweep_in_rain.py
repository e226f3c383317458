from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from evaluation.lidar.wall_beams import SENSOR, sky_beams, wall_beams
from gsrain_engine.evaluation.lidar.rain_echoes import wet_road_share
from gsrain_engine.evaluation.lidar.results import ReturnCounts
from gsrain_engine.evaluation.lidar.scan import ReturnOutcome, leveled_frame, scan_in_rain
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation

ANCHOR = np.eye(4)


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


@pytest.mark.parametrize("intensity", [1.2, 8.5, 50.0])
def test_a_wall_shows_the_transmission_of_two_ways(intensity):
    intensities = np.full(400, 0.5, np.float32)
    back = rained(wall_beams(np.full(400, 40.0), intensities=intensities), intensity)
    beta = RainSimulation.start(RainSettings(intensity_mm_h=intensity)).state.extinction_per_m
    np.testing.assert_allclose(back.sweep.intensities[~back.is_false], 0.5 * np.exp(-2 * beta * 40.0), rtol=1e-6)


@pytest.mark.parametrize("reflectance", [0.05, 0.1, 0.5])
def test_a_wall_vanishes_where_the_lidar_equation_has_it_at_the_threshold(reflectance):
    beta = RainSimulation.start(RainSettings(intensity_mm_h=30.0)).state.extinction_per_m
    reach = brentq(lambda r: reflectance / 0.1 * (100 / r) ** 2 * np.exp(-2 * beta * r) - 1, 10, 300)
    assert reach < 0.9 * 100 * np.sqrt(reflectance / 0.1)  # rain matters
    back = rained(wall_beams([reach - 0.01, reach + 0.01], reflectance), 30.0)
    assert back.fates.tolist() == [ReturnOutcome.KEPT, ReturnOutcome.DROPPED]


def test_more_rain_keeps_fewer_and_adds_drops():
    rng = np.random.default_rng(1)
    walls = wall_beams(rng.uniform(5, 100, 4000), directions=sky_beams(4000).directions)
    walls = replace(walls, reflectances=SENSOR.detectable(walls.ranges_m) * rng.uniform(1, 3, 4000))
    kept, false = [], []
    for intensity in (0.0, 1.2, 8.5, 12.0, 30.0):
        back = rained(walls, intensity)
        kept.append(set(np.flatnonzero(back.fates != ReturnOutcome.DROPPED).tolist()))
        false.append(int(rained(sky_beams(8000), intensity).is_false.sum()))
    for less, more in zip(kept[1:], kept[:-1], strict=True):
        assert less < more
    assert false[0] == 0 < false[2]
    assert false == sorted(false)


def test_the_seed_fixes_everything_and_another_one_changes_the_drops():
    first, again, other = (rained(sky_beams(5000), 20.0, seed) for seed in (3, 3, 4))
    assert first.sweep.points_m.tobytes() == again.sweep.points_m.tobytes()
    assert first.beams.tobytes() == again.beams.tobytes()
    assert len(first.beams) > 20
    assert first.sweep.points_m.tobytes() != other.sweep.points_m.tobytes()


def test_false_returns_are_as_many_as_beams_with_a_drop():
    """Beams into the open sky report a drop with the chance 1 - exp(-mean), each drop once in few beams."""
    from gsrain_engine.evaluation.lidar.rain_echoes import DropReturnModel

    beams, total, mean = sky_beams(3000), 0, 0.0
    for seed in range(8):
        total += int(rained(beams, 12.0, seed).is_false.sum())
        mean = DropReturnModel(SENSOR, RainSimulation.start(RainSettings(intensity_mm_h=12.0)).state).expected[-1]
    expected = 8 * 3000 * (1 - np.exp(-mean))
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


def test_a_levelled_frame_has_the_heading_and_no_tilt():
    frame = leveled_frame((0.0, 2.0, 0.5), np.array([1.0, 2, 3]))
    np.testing.assert_allclose(frame @ [1, 0, 0, 1], [1, 3, 3, 1])
    np.testing.assert_allclose(frame[:3, 2], [0, 0, 1])
