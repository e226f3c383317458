import msgspec
import numpy as np
import pytest

from evaluation.lidar.wall_beams import SENSOR
from gsrain_engine.datasets.capture import Capture, LidarSweep
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.evaluation.lidar.scan import (
    ROOF_M,
    ReturnOutcome,
    capture_turns,
    estimate_sensor_range,
    full_intensity,
    scan_in_rain,
    sweep_beams,
)
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.scene import PoseTrack

EGO = PoseTrack(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones(1, bool))


def sweep(points, intensities=None, origin=(0.0, 0.0, 0.4)):
    light = None if intensities is None else np.array(intensities, np.float32)
    return LidarSweep(0.0, np.array(points, np.float32), np.array(origin), light)


def test_reflectances_are_intensities_raised_to_what_is_just_detected():
    beams = sweep_beams(sweep([[10, 0, 0.4], [90, 0, 0.4]], [0.5, 0.01]), SENSOR)
    assert beams.reflectances[0] == pytest.approx(0.5)
    assert beams.reflectances[1] == SENSOR.detectable(np.array([90.0]))[0]


def test_placeholders_and_the_own_car_are_left_alone():
    beams = sweep_beams(sweep([[0, 0, 0.4], [0.3, 0, 0.4], [10, 0, 0]]), SENSOR)
    assert beams.untouched.tolist() == [True, True, False]
    assert np.isfinite(beams.directions).all()


def test_the_road_is_what_lies_at_its_height():
    beams = sweep_beams(sweep([[10, 0, -1.5], [10, 0, 0.4], [20, 0, -1.4]]), SENSOR, EGO)
    assert beams.road_cosines[0] == pytest.approx(1.9 / np.hypot(10, 1.9))
    assert beams.road_cosines[1] == 0
    assert beams.road_cosines[2] > 0


def test_a_sensor_on_the_road_is_lifted_to_the_roof_and_its_points_stay():
    flat = sweep([[10, 0, -1.5]], origin=(0.0, 0.0, -1.5))
    beams = sweep_beams(flat, SENSOR, EGO)
    assert beams.origin_m[2] == pytest.approx(ROOF_M - 1.5)
    assert beams.points_m.tobytes() == flat.points_m.tobytes()


def test_a_sweep_tells_how_far_its_sensor_sees():
    rng = np.random.default_rng(0)
    ranges, light = rng.uniform(2, 200, 20_000), rng.uniform(0.01, 1, 20_000)
    heard = light >= 0.1 * (ranges / 120) ** 2
    points = np.stack([ranges, np.zeros(20_000), np.full(20_000, 0.4)], axis=1)[heard]
    told = estimate_sensor_range(sweep(points, light[heard]), 1.0)
    assert 112 < told <= 120
    assert estimate_sensor_range(sweep(points), 1.0) is None


def test_the_scale_of_intensities_is_guessed():
    assert full_intensity(sweep([[1, 0, 0]], [0.9])) == 1
    assert full_intensity(sweep([[1, 0, 0]], [90])) == 100


def test_captures_without_a_sweep_or_without_metres_are_refused():
    with pytest.raises(ValueError, match="has no lidar sweeps"):
        list(capture_turns(Capture("bare", ()), SENSOR))
    with pytest.raises(ValueError, match="not in meters"):
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
    wanted = turn.beams.is_echo & (margin * np.exp(-2 * beta * turn.beams.ranges_m) < 1)
    np.testing.assert_array_equal(lost, wanted)


def test_a_estimates_range_can_be_overruled(test_data):
    capture = open_capture(test_data / "driving/nuscenes_sample")
    sensor = msgspec.structs.replace(SENSOR, range_m=70.0)
    assert next(iter(capture_turns(capture, sensor, estimates_range=False))).sensor.range_m == 70
