"""Weather: keys, curves, plain values, and a disdrometer's series as one."""

import msgspec
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.rain_rates import keyframes_from_spectra
from gsrain_engine.disdrometer.spectra import DisdrometerReading
from gsrain_engine.rain.keyframes import (
    KeyframeCurve,
    RainKeyframe,
    RainKeyframes,
    keyframes_from_series,
    shower_keyframes,
)
from gsrain_engine.rain.settings import RainSettings
from measured_rain import measured_rain


def shower(*pairs, **fields):
    return RainKeyframes(keys=tuple(RainKeyframe(time_s=at, intensity_mm_h=rate) for at, rate in pairs), **fields)


TRIANGLE = shower((10.0, 0.0), (40.0, 12.0), (70.0, 0.0))


@pytest.mark.parametrize(
    ("at", "expected"), [(-100.0, 0.0), (10.0, 0.0), (25.0, 6.0), (40.0, 12.0), (62.5, 3.0), (1e6, 0.0)]
)
def test_straight_between_keys_and_held_beyond_them(at, expected):
    assert TRIANGLE.rain_at(RainSettings(intensity_mm_h=50.0), at).intensity_mm_h == pytest.approx(expected)


def test_each_field_has_keys_of_its_own_which_are_set_moved_and_removed():
    weather = TRIANGLE.with_key(20.0, wind_m_s=(2.0, 0.0)).with_key(40.0, wind_m_s=(4.0, -2.0), exposure_s=0.01)
    rain = weather.rain_at(RainSettings(seed=7), 30.0)
    assert rain == RainSettings(seed=7, intensity_mm_h=8.0, wind_m_s=(3.0, -1.0), exposure_s=0.01)
    assert weather.without("intensity_mm_h").rain_at(RainSettings(intensity_mm_h=1.0), 30.0).intensity_mm_h == 1.0
    assert weather.without("wind_m_s").key_times["wind_m_s"].tolist() == []
    moved = weather.moved_key(40.0, 80.0, "intensity_mm_h", intensity_mm_h=3.0)
    assert moved.key_times["intensity_mm_h"].tolist() == [10.0, 70.0, 80.0]
    assert moved.key_times["wind_m_s"].tolist() == [20.0, 40.0]
    assert moved.key_at(80.0).intensity_mm_h == 3.0
    assert moved.moved_key(40.0, 90.0, "intensity_mm_h") is moved.moved_key(11.0, 90.0, "wind_m_s") is moved
    assert weather.with_key(40.0, intensity_mm_h=5.0).key_at(40.0).intensity_mm_h == 5.0
    assert weather.without_key(10.0).key_times["intensity_mm_h"].tolist() == [40.0, 70.0]
    assert weather.without_key(11.0) is weather


def test_smooth_has_no_corners():
    """At its top a straight shower turns by 0.8 mm/h a second, the smooth one by less than a fifth of that."""
    smooth = msgspec.structs.replace(TRIANGLE, between="smooth")
    for weather, low, high in ((TRIANGLE, 0.39, 1), (smooth, 0, 0.16)):
        for at in (10.0, 40.0, 70.0):
            rates = [weather.rain_at(RainSettings(), at + step).intensity_mm_h for step in (-1.0, 0.0, 1.0)]
            assert low < abs(np.diff(rates, 2)[0]) < high


@given(
    st.lists(
        st.tuples(st.floats(-100, 100), st.floats(0, 100)), min_size=1, max_size=9, unique_by=lambda pair: pair[0]
    ),
    st.floats(-120, 120),
)
@example([(0.0, 0.0), (1.0, 1.1125369292536007e-308)], 0.0)
def test_smooth_goes_through_its_keys_and_never_beyond_its_neighbours(pairs, at):
    pairs = sorted((round(time, 3), rate) for time, rate in {round(t, 3): (t, r) for t, r in pairs}.values())
    weather = shower(*pairs, between="smooth")
    for key_s, rate in pairs:
        assert weather.rain_at(RainSettings(), key_s).intensity_mm_h == rate
    times, rates = zip(*pairs, strict=True)
    after = int(np.searchsorted(times, at, side="right"))
    near = rates[max(after - 1, 0) : after + 1]
    assert min(near) - 1e-9 <= weather.rain_at(RainSettings(), at).intensity_mm_h <= max(near) + 1e-9


def test_a_shower_rises_and_falls_as_the_squared_sine_of_its_time():
    keys = shower_keyframes(10.0, duration_s=40.0, peak_mm_h=8.0, steps=4).keys
    assert [(key.time_s, key.intensity_mm_h) for key in keys] == [(10, 0), (20, 4), (30, 8), (40, 4), (50, 0)]
    assert [key.intensity_mm_h for key in shower_keyframes().keys] == [0, 3, 9, 12, 9, 3, 0]


def test_weather_is_plain_values_and_comes_back():
    weather = shower_keyframes(5.0).with_key(3.0, wind_m_s=(1.0, -2.0), exposure_s=0.002)
    values = msgspec.json.decode(msgspec.json.encode(msgspec.to_builtins(weather)))
    assert msgspec.convert(values, RainKeyframes) == weather
    assert values["keys"][0] == {"time_s": 3.0, "wind_m_s": [1.0, -2.0], "exposure_s": 0.002}


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("intensity_mm_h", (149.5, float("nan"))),
        ("wind_m_s", ([0.0, 40.1], [-40.1, 0.0], [40.1, 0.0], [0.0, -40.1])),
        ("exposure_s", (0.9e-5, 1.1)),
        ("time_s", (float("inf"), 1.1e7, -1.1e7)),
        ("keys must rise in time", (-1.0,)),
    ],
)
def test_keys_out_of_bounds_are_reported(field, values):
    limits = {"time_s": 1e7, "intensity_mm_h": 149.0, "wind_m_s": (-40.0, 40.0), "exposure_s": 1.0}
    assert msgspec.to_builtins(msgspec.convert(limits, RainKeyframe)) == limits
    for value in values:
        key = {"time_s": 5.0, field if field in limits else "time_s": value}
        with pytest.raises(msgspec.ValidationError, match=field):
            msgspec.convert({"keys": [{"time_s": 0.0, "intensity_mm_h": 1.0}, key]}, RainKeyframes)


def test_a_series_is_cut_off_at_149_mm_h():
    weather = keyframes_from_series(np.array([0.0, 60.0]), np.array([250.0, 3.0]))
    assert [key.intensity_mm_h for key in weather.keys] == [149.0, 3.0]
    for rates in ([1.0, -1.0], [1.0, np.inf], [1.0, 1.0]):
        with pytest.raises(ValueError):
            keyframes_from_series(np.zeros(2) if rates == [1.0, 1.0] else np.arange(2.0), np.array(rates))


def test_a_disdrometers_day_becomes_a_weather(test_data):
    """Against the file's own records: rates, order, spacing, and the speed-up."""
    reading = read_disdrometer(test_data / "disdrometer" / "locarno_parsivel_20181029.dat.gz")
    measured, spectra = keyframes_from_spectra(reading, speed_up=60.0, start_s=5.0), reading.spectra
    assert measured.records + measured.left_out == len(spectra)
    assert measured.weather.keys[0].time_s == 5.0
    assert measured.duration_s == pytest.approx((spectra.times[-1] - spectra.times[0]) / np.timedelta64(1, "m"))
    rates = np.array([key.intensity_mm_h for key in measured.weather.keys])
    assert rates.max() == pytest.approx(min(100.0, np.nanmax(spectra.reported_mm_h)))
    assert f"{measured.records:,} records" in measured.summary
    with pytest.raises(ValueError, match="speed-up"):
        keyframes_from_spectra(reading, speed_up=0.0)


def test_records_without_time_or_rate_are_left_out():
    spectra = measured_rain(500.0, 5.0, 0.2, minutes=3, seed=1)
    spectra.times[2:5] = np.datetime64("NaT"), spectra.times[3], spectra.times[3]
    measured = keyframes_from_spectra(DisdrometerReading(spectra=spectra))
    assert (measured.records, measured.left_out, measured.weather.keys[2].time_s) == (4, 2, 90.0)
    spectra.times[:] = np.datetime64("NaT")
    with pytest.raises(ValueError, match="time"):
        keyframes_from_spectra(DisdrometerReading(spectra=spectra))


def test_integrals_of_a_curve_are_areas_under_its_lines():
    curve = KeyframeCurve(np.array([2.0, 4.0, 8.0]), np.array([[3.0, 0.0], [5.0, 0.0], [1.0, 8.0]]))
    areas = {0.0: (0, 0), 2.0: (6, 0), 3.0: (6 + 3.5, 0), 4.0: (14, 0), 6.0: (14 + 8, 4), 9.0: (14 + 12 + 1, 16 + 8)}
    for time_s, area in areas.items():
        assert curve.integral(time_s) == pytest.approx(area)
    assert curve.integral(-2.0) == pytest.approx([-6, 0])
