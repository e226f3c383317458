import msgspec
import numpy as np
import pytest

from evaluation.lidar.wall_beams import SENSOR
from gsrain_engine.evaluation.lidar.sensor import SENSORS, LidarSensor


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=list(SENSORS))
def test_ten_percent_is_just_detected_at_the_stated_range(sensor):
    assert sensor.signal(np.array([sensor.range_m]), np.array([0.1]), 0.0)[0] == pytest.approx(1, rel=1e-12)


def test_power_falls_with_the_square_and_twice_the_extinction():
    near, far = SENSOR.signal(np.array([20.0, 60.0]), np.array([0.3, 0.3]), 0.01)
    assert near / far == pytest.approx(9 * np.exp(2 * 0.01 * 40), rel=1e-12)


def test_nothing_is_detected_where_the_receiver_is_blind_or_too_little_comes():
    assert np.isinf(SENSOR.detectable(np.array([SENSOR.blind_m / 2]))[0])
    assert SENSOR.detectable(np.array([2.0]))[0] == SENSOR.least_reflectance
    assert SENSOR.detectable(np.array([0.95]))[0] == pytest.approx(2 * SENSOR.least_reflectance)


def test_a_beam_is_as_wide_as_its_window_and_then_as_its_divergence():
    width = SENSOR.beam_width_m(np.array([0.0, 100.0]))
    assert width[0] == pytest.approx(0.012)
    assert width[1] == pytest.approx(np.hypot(0.012, 0.3))


def test_the_range_noise_is_that_of_the_threshold_over_the_root_of_the_signal():
    assert SENSOR.range_sigma(np.array([1.0, 25.0])) == pytest.approx([0.05, 0.01])


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"elevations_deg": [70]}, "elevations_deg must be within -60..60"),
        ({"elevations_deg": [0], "blind_m": 2, "clear_m": 1}, "clear_m must be at least blind_m"),
        ({"elevations_deg": []}, "length >= 1"),
    ],
)
def test_a_sensor_that_cannot_be_is_refused(fields, said):
    with pytest.raises(msgspec.ValidationError, match=said):
        msgspec.convert({"name": "odd", **fields}, LidarSensor)
