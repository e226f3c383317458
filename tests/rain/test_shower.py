"""Rain that changes over time: every frame alone as among others, no jumps, and as much water as was asked for."""

import msgspec
import numpy as np
import pytest

from given_rain import HERE, STILL, gaussians_of
from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.rain.properties import DropClassTable, rain_properties
from gsrain_engine.rain.settings import HEAVIEST_MM_H, RainSettings, RegionBox
from gsrain_engine.rain.simulation import RainSimulation
from oracles.drop_phases import displacement

SMALL = RegionBox(minimum_m=(0.0, 0.0, 0.0), maximum_m=(3.0, 2.0, 2.0))


def weather(*pairs, **fields):
    return RainKeyframes(keys=tuple(RainKeyframe(time_s=at, intensity_mm_h=rate) for at, rate in pairs), **fields)


TRIANGLE = weather((3.0, 0.0), (18.0, 12.0), (33.0, 0.0))
GUSTY = TRIANGLE.with_key(0.0, wind_m_s=(6.0, -2.0)).with_key(20.0, wind_m_s=(-3.0, 4.0))


def test_the_disdrometer_measures_the_integral_of_a_shower():
    """A triangle to 12 mm/h within 30 s carries 0.05 mm; within 3 standard errors of about 0.7 %.

    A shower that carries 4 % more is found in more than 99 of 100 cases, a right one refused 3 times in 1000.
    """
    shower = RainSimulation.start(RainSettings(seed=3, intensity_mm_h=50.0, streak_region=SMALL), weather=TRIANGLE)
    times = np.arange(0.0, 37.0)
    records = VirtualDisdrometer(shower, 0.5).records(times)
    water = sum(each.rate_mm_h for each in records)
    error = np.sqrt(sum(each.standard_error_mm_h**2 for each in records))
    assert error / water < 0.008
    assert abs(water - 12.0 * 30.0 / 2) < 3 * error
    assert sum(each.drops for each in records[:3]) == 0  # dry before the first key


def test_a_frame_alone_is_the_frame_among_others():
    """To the byte, forward, backward and alone."""
    times = [2.0, 9.99, 18.5, 17.6]

    def frame(rainfall, time_s):
        g = gaussians_of(rainfall.frame(time_s, HERE))
        return b"".join(each.tobytes() for each in (g.means, g.scales, g.quaternions, g.opacities, g.sh))

    rain = RainSettings(seed=5, gust_m_s=2.0, streak_region=SMALL, haze="gaussians")
    film = RainSimulation.start(rain, weather=GUSTY)
    forward = [frame(film, time_s) for time_s in times]
    backward = [frame(film, time_s) for time_s in reversed(times)][::-1]
    alone = [frame(RainSimulation.start(rain, weather=GUSTY), time_s) for time_s in times]
    assert forward == backward == alone
    assert len(set(forward)) == len(times)
    assert forward[0] == b""


@pytest.mark.parametrize("between", ["linear", "smooth"])
def test_displacement_is_the_integral_of_the_speeds(between):
    """Against a trapezoid sum in steps of 40 ms, to 5 mm after 30 s; a speed that is 0.01 % off would show."""
    changing = msgspec.structs.replace(GUSTY, between=between)
    rainfall = RainSimulation.start(RainSettings(seed=5, gust_m_s=3.0), weather=changing)
    times = np.arange(-2.0, 34.0, 0.04)
    some = np.array([0, 5_000, 11_000, 16_383])
    speeds = np.empty((len(times), len(some) + 2))
    for k, time_s in enumerate(times):
        motion = rainfall.frozen_at(float(time_s)).motion
        speeds[k] = *motion.wind.drift_m_s, *-motion.fall_speed_m_s[some]
    summed = np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * 0.04, axis=0)

    def place(time_s):
        moved = displacement(rainfall.frozen_at(time_s).motion, time_s)
        return np.concatenate([moved[0, :2], moved[some, 2]])

    for k in (50, 216, 499, 898):
        assert place(float(times[k + 1])) - place(-2.0) == pytest.approx(summed[k], abs=5e-3)
    assert place(0.0) == pytest.approx(np.zeros(len(some) + 2), abs=1e-12)


def test_no_drop_jumps_at_a_key_or_between():
    """From one thousandth of a second to the next no class moves farther than its speed, at keys and node crossings."""
    rainfall = RainSimulation.start(RainSettings(seed=5, gust_m_s=1.0), weather=GUSTY)
    straight = RainSimulation.start(RainSettings(model="paper", gust_m_s=2.0), weather=GUSTY)
    assert np.array_equal(straight.frozen_at(12.0).motion.drift(12.0), np.zeros(2))  # the paper's form, in any weather
    for at in (0.0, 3.0, 18.0, 20.0, 33.0, *np.random.default_rng(2).uniform(0, 35, 12)):
        before, after = (rainfall.frozen_at(float(at) + step).motion for step in (-5e-4, 5e-4))
        moved = displacement(after, float(at) + 5e-4) - displacement(before, float(at) - 5e-4)
        expected = -1e-3 * 0.5 * (before.fall_speed_m_s + after.fall_speed_m_s)
        assert np.abs(moved[:, 2] - expected).max() < 1e-6
        assert np.abs(moved[:, :2]).max() < 0.02


def test_haze_and_numbers_follow_the_intensity():
    rain = RainSettings(seed=1, roofs=False, haze="gaussians")
    rainfall = RainSimulation.start(rain, weather=TRIANGLE)
    for at, rate in ((10.5, 6.0), (18.0, 12.0)):
        state = rain_properties(msgspec.structs.replace(rain, intensity_mm_h=rate), rainfall.calibration)
        assert rainfall.state_at(at) == state
        field = rainfall.frame(at, HERE)
        assert field.count == round(state.density_m3 * np.prod(field.period_m))
        constant = RainSimulation.start(msgspec.structs.replace(rain, intensity_mm_h=rate))
        assert np.array_equal(field.haze.means, constant.frame(at, HERE).haze.means)
        assert field.diameters_mm == pytest.approx(constant.diameters_mm, rel=1e-3)
    assert rainfall.frame(40.0, HERE).count == rainfall.frame(40.0, HERE).haze_count == 0
    assert rainfall.can_rain
    assert not RainSimulation.start(RainSettings(intensity_mm_h=3.0), weather=weather((0.0, 0.0))).can_rain


@pytest.mark.parametrize("keys", [[(7.0, 8.5)], [(1.0, 8.5), (3.0, 8.5)]])
def test_keys_of_one_intensity_are_constant_rain(keys):
    """To the byte: offsets, sizes, number."""
    rain = RainSettings(seed=9, wind_m_s=(2.0, 1.0), gust_m_s=1.0)
    keyed = RainSimulation.start(rain, weather=weather(*keys)).frame(4.0, HERE)
    constant = RainSimulation.start(msgspec.structs.replace(rain, intensity_mm_h=8.5)).frame(4.0, HERE)
    assert keyed.count == constant.count
    assert np.array_equal(keyed.diameters_mm, constant.diameters_mm)
    assert np.array_equal(keyed.where.wraps, constant.where.wraps)
    apart = (keyed.where.fractions - constant.where.fractions).view(np.int32)
    assert np.abs(apart).max() <= 1  # of 2^32: the sums are rounded in another order


def test_a_keyed_exposure_lengthens_streaks():
    rain = RainSettings(intensity_mm_h=8.5, haze="none", streak_region=SMALL, **STILL)
    exposures = RainKeyframes(
        keys=(RainKeyframe(time_s=0.0, exposure_s=0.002), RainKeyframe(time_s=10.0, exposure_s=0.02))
    )
    rainfall = RainSimulation.start(rain, weather=exposures)
    assert rainfall.frame(5.0, HERE).shutter.exposure_s == pytest.approx(0.011)
    long, short = (gaussians_of(rainfall.frame(at, HERE)).scales.max() for at in (10.0, 0.0))
    assert long > 5 * short


def test_changing_the_weather_moves_no_drop():
    rainfall = RainSimulation.start(RainSettings(seed=5, intensity_mm_h=3.0, wind_m_s=(1.0, 0.0)))
    for changed in (GUSTY, TRIANGLE, RainKeyframes(), GUSTY):
        following = rainfall.changed(rainfall.rain, 12.0, changed)
        expected = displacement(rainfall.frozen_at(12.0).motion, 12.0)
        assert np.allclose(displacement(following.frozen_at(12.0).motion, 12.0), expected, atol=1e-9)
        rainfall = following
    unmoved = rainfall.changed(msgspec.structs.replace(rainfall.rain, haze="none"), 15.0)
    assert unmoved.frozen_at(15.0).rain.haze == "none"
    assert np.array_equal(unmoved.frozen_at(20.0).motion.fallen(20.0), rainfall.frozen_at(20.0).motion.fallen(20.0))


def test_between_the_nodes_diameters_are_within_the_promised_share():
    """At the geometric middles, against the law of each intensity itself."""
    rain = RainSettings()
    calibration = RainSimulation.start(rain).calibration
    table = DropClassTable.between(0.3, HEAVIEST_MM_H, rain, calibration)
    assert table.nodes_mm_h[-1] == HEAVIEST_MM_H
    middles = np.sqrt(table.nodes_mm_h[:-1] * table.nodes_mm_h[1:]).tolist()
    for rate in (middles[0], middles[-1], next(each for each in middles if each > 8.5)):
        alone = DropClassTable.between(rate, rate, rain, calibration)
        off = np.abs(table.at(table.diameters_mm, rate) / alone.diameters_mm[0] - 1)
        assert len(alone.nodes_mm_h) == 1
        if 1.2 < rate < 12:
            assert np.median(off) < 0.004 and off.max() < 0.03
        else:
            assert off.max() < 0.0005


@pytest.mark.parametrize(("start", "end"), [(0.0, 12.0), (11.0, 0.3), (5.0, 5.0), (0.0, 0.0), (12.0, 12.0)])
def test_mean_shares_are_exact(start, end):
    """Against the mean over 20,000 moments on the way."""
    rain = RainSettings()
    table = DropClassTable.between(0.0, 12.0, rain, RainSimulation.start(rain).calibration)
    mean = table.mean_shares(np.array([start]), np.array([end]))[0]
    rates = start + (end - start) * (np.arange(20_000) + 0.5) / 20_000
    expected = [np.interp(rates, table.nodes_mm_h, row).mean() for row in np.eye(len(table.nodes_mm_h))]
    assert mean == pytest.approx(expected, abs=1e-6)
    assert mean.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("gap_s", [5e-324, 7e-223, 1e-100])
@pytest.mark.parametrize("between", ["linear", "smooth"])
def test_keys_that_nearly_coincide_are_a_jump(gap_s, between):
    keys = tuple(RainKeyframe(time_s=t, intensity_mm_h=r) for t, r in ((-gap_s, 1.0), (0.0, 9.0), (3.0, 2.0)))
    rain = RainSimulation.start(RainSettings(), weather=RainKeyframes(keys=keys, between=between))
    for time_s in (-1.0, 0.0, 1e-9, 1.0, 4.0):
        now = rain.frozen_at(time_s)
        assert np.isfinite(now.motion.fallen(time_s)).all()
        assert now.rain.intensity_mm_h == pytest.approx(1.0 if time_s < 0 else 2.0 if time_s > 3 else 9.0, abs=3.6)
