"""Spray in lidar beams: echoes inside of the cloud, light that is lost behind it, and no change where there is none."""

import numpy as np
import pytest

from evaluation.lidar.wall_beams import SENSOR, wall_beams
from gsrain_engine.evaluation.lidar.scan import ReturnOutcome, scan_in_rain
from gsrain_engine.evaluation.lidar.spray_echoes import spray_in_beams
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.water.spray import SprayParcels

RAY = np.array([0.6, 0.0, 0.8])


def cloud(distance_m, depth, sigma=0.5):
    """A cloud of an optical depth in the middle of the beams of `wall_beams`."""
    one = np.ones(1)
    area = depth * 2 * np.pi * sigma**2
    return SprayParcels(distance_m * RAY[None], sigma * one, area * one, 1e-3 * one, 0.2 * one, np.zeros((1, 3)))


def scanned(beams, spray, **options):
    rainfall = RainSimulation.start(RainSettings(intensity_mm_h=1.0, seed=4))
    return scan_in_rain(beams, SENSOR, rainfall, np.eye(4), wet_road=False, spray=spray, **options)


def test_light_is_lost_behind_a_cloud_both_ways_and_not_before_it():
    beams = wall_beams(np.array([5.0, 10.0, 40.0]), 0.5)
    through = spray_in_beams(beams, SENSOR, cloud(10.0, 0.8), 0.0, 0).transmittance
    assert through == pytest.approx([1.0, np.exp(-0.4), np.exp(-0.8)], rel=0.02)
    alone, behind = (scanned(beams, each).signals[-1] for each in (None, cloud(10.0, 0.8)))
    assert behind / alone == pytest.approx(np.exp(-1.6), rel=1e-3)


def test_a_thick_near_cloud_answers_and_hides_a_faint_wall():
    beams = wall_beams(np.full(400, 60.0), 0.1)
    clear, hidden = scanned(beams, None), scanned(beams, cloud(6.0, 2.5))
    assert (clear.fates == ReturnOutcome.KEPT).mean() > 0.99
    assert (hidden.fates == ReturnOutcome.KEPT).mean() < 0.05 and hidden.is_false.mean() > 0.5
    assert np.all(np.abs(hidden.false_ranges_m - 6.0) < 2.5)
    far = scanned(beams, cloud(50.0, 0.5))
    assert not (far.false_ranges_m > 10).any()  # too faint from there
    near = wall_beams(np.full(400, 30.0), 0.1)
    first, last = (scanned(near, cloud(6.0, 0.8), answer=each) for each in ("first", "last"))
    assert first.is_false.sum() > last.is_false.sum()


def test_no_spray_leaves_the_bytes_and_a_seed_gives_the_same_ones():
    beams = wall_beams(np.full(50, 30.0), 0.3)
    none, empty = (scanned(beams, each).sweep.points_m for each in (None, SprayParcels.none()))
    assert none.tobytes() == empty.tobytes()
    one, other = (scanned(beams, cloud(6.0, 1.0)).sweep.points_m for _ in range(2))
    assert one.tobytes() == other.tobytes() != none.tobytes()
