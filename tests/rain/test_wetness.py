import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.rain.keyframes import KeyframeCurve, RainKeyframe, RainKeyframes
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.rain.wetness import WetnessCurve, overcast, water_depth_mm, wetness


def curve(*keys: tuple[float, float]) -> KeyframeCurve:
    times, rates = np.array(keys, np.float64).T
    return KeyframeCurve(times, rates[:, None])


def test_water_lies_as_deep_as_gallaway_says():
    """At 12 mm/h on 5 m of a 2 % slope, worked out by hand; twice the rain is 2^0.59 as deep."""
    assert water_depth_mm(12.0) == pytest.approx(0.01485 * 0.92659 * 1.99792 * 4.33218 * 5.17076, rel=1e-4)
    assert water_depth_mm(6.0) * 2**0.59 == pytest.approx(water_depth_mm(12.0))


def test_wetness_begins_at_zero_rises_and_saturates():
    rates = np.linspace(0, 100, 400)
    values = np.array([wetness(float(rate)) for rate in rates])
    assert (values[rates <= 0.3] == 0).all()
    assert (np.diff(values[rates > 0.3]) >= 0).all()
    assert (np.diff(values[rates > 0.5], 2) <= 1e-12).all()
    assert values[-1] > 0.99
    assert [round(wetness(rate), 2) for rate in (0.3, 0.5, 1.2, 2.5, 8.5)] == [0.0, 0.85, 0.96, 0.99, 1.0]


def test_the_sky_closes_at_once_and_stays_closed_while_anything_is_wet():
    """Overcast as soon as it rains, whatever the wetness; blue at a wetness of 0, which is as lit."""
    assert [overcast(rate) for rate in (0.0, 0.3, 0.4, 0.5, 149.0)] == pytest.approx([0, 0, 0.5, 1, 1])
    one = RainSimulation.start(RainSettings(intensity_mm_h=1.0))
    assert one.overcast_at(0.0) == 1 > one.wetness_at(0.0) == wetness(1.0) > 0.9
    assert RainSimulation.start(RainSettings(intensity_mm_h=1.0, wetness=0.2)).overcast_at(0.0) == 1
    assert RainSimulation.start(RainSettings(wetness=0.2)).overcast_at(0.0) == 0.2
    assert RainSimulation.start(RainSettings(intensity_mm_h=50.0, wetness=0.0)).overcast_at(0.0) == 0
    assert RainSimulation.start(load_preset("paper")).overcast_at(0.0) == 0
    keys = RainKeyframe(time_s=0, intensity_mm_h=12), RainKeyframe(time_s=60, intensity_mm_h=0)
    drying = RainSimulation.start(RainSettings(drying_s=60.0), weather=RainKeyframes(keys=keys))
    assert drying.overcast_at(90.0) == drying.wetness_at(90.0) > 0.3


@given(
    st.lists(st.tuples(st.floats(0.1, 50), st.floats(0, 100)), min_size=1, max_size=6),
    st.floats(0.5, 200),
    st.floats(-20, 400),
)
def test_what_dries_is_the_largest_of_all_moments_before(steps, drying_s, time_s):
    """Against a search of many moments, which finds a little less, and of the stretches between, which finds more."""
    times, rates = np.cumsum([step for step, _ in steps]), [rate for _, rate in steps]
    found = WetnessCurve(KeyframeCurve(times, np.array(rates)[:, None]), drying_s).at(time_s)
    moments = np.unique([*np.linspace(min(times[0], time_s) - 1, time_s, 301), *times[times < time_s]])
    wet = np.array([wetness(rate) for rate in np.interp(moments, times, rates).tolist()])
    dried = np.exp(-(time_s - moments) / drying_s)
    assert found >= np.max(wet * dried) - 1e-9
    assert found <= np.max(np.maximum(wet[:-1], wet[1:]) * dried[1:]) + 1e-9


def test_rain_that_stops_slowly_is_remembered_from_its_turning_point():
    """Falling from 12 mm/h to 0 within 60 s, drying in 20 s: the moment that wets most is found to 1e-9.

    ln w(R(s)) + s / 20 is concave on the way down: a fine search brackets its top.
    """
    course = WetnessCurve(curve((0, 12), (60, 0)), 20.0)
    moments = np.linspace(0, 60, 50_001)
    wet = np.array([wetness(rate) for rate in (12 - moments / 5).tolist()])
    for time_s in (30.0, 60.0, 75.0, 100.0):
        before = moments <= time_s
        expected = np.max(wet[before] * np.exp(-(time_s - moments[before]) / 20.0))
        assert course.at(time_s) == pytest.approx(expected, rel=1e-6)
    assert course.at(-5.0) == course.at(0.0) == pytest.approx(wetness(12))


def test_drizzle_under_a_sky_that_is_half_closed_is_remembered_too():
    course = WetnessCurve(curve((0, 0.4), (10, 0.4), (10.001, 0)), 20.0)
    assert course.at(15.0) == pytest.approx(wetness(0.4) * np.exp(-5 / 20), rel=1e-3) and wetness(0.4) > 0.4


def test_a_rainfall_knows_its_wetness():
    steady = RainSimulation.start(RainSettings(intensity_mm_h=8.5))
    assert steady.wetness_at(3.0) == wetness(8.5)
    assert RainSimulation.start(RainSettings()).wetness_at(0.0) == 0
    assert RainSimulation.start(RainSettings(wetness=0.4)).wetness_at(0.0) == 0.4
    assert RainSimulation.start(RainSettings(intensity_mm_h=8.5, wetness=0.0)).wetness_at(0.0) == 0
    keys = (RainKeyframe(time_s=0, intensity_mm_h=0), RainKeyframe(time_s=10, intensity_mm_h=12))
    weather = RainKeyframes(keys=(*keys, RainKeyframe(time_s=20, intensity_mm_h=0)))
    shower, slow = (RainSimulation.start(RainSettings(drying_s=s), weather=weather) for s in (0.0, 60.0))
    assert shower.wetness_at(5.0) == slow.wetness_at(5.0) == pytest.approx(wetness(6))
    assert shower.wetness_at(20.0) == 0
    assert slow.wetness_at(20.0) > 0.7
    assert slow.changed(RainSettings(), 20.0).wetness_at(20.0) == 0


@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan")])
def test_wetness_out_of_bounds_is_refused(value):
    with pytest.raises(ValueError, match=r"wetness must be within 0\.\.1"):
        RainSettings(wetness=value)
    with pytest.raises(ValueError, match="wetness"):
        msgspec.convert({"wetness": value}, RainSettings)
