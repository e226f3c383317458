"""A calibration from drops of a known law: numbers, intervals, refusals."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.disdrometer.fit import fit_calibration
from gsrain_engine.disdrometer.fit_models import FitOptions
from gsrain_engine.rain.properties import DropSizes, flux_mm_h
from measured_rain import measured_rain

LIGHT, HEAVY = (271.0, 9.705, 0.074), (1190.0, 7.132, 0.114)
OPTIONS = FitOptions(intensities_mm_h=(0.8, 6.6), half_width=0.5, resamples=200)


@pytest.fixture(scope="module")
def rain():
    return [
        measured_rain(*LIGHT, minutes=60, seed=1),
        measured_rain(*HEAVY, minutes=30, seed=2, start="2024-05-01T12:00"),
    ]


@pytest.fixture(scope="module")
def fitted(rain):
    return fit_calibration(rain, name="test", source="drawn", options=OPTIONS)


def test_laws_come_back_from_a_parsivels_counts(fitted):
    for row, (density, shape, scale) in zip(fitted.calibration.rows, (LIGHT, HEAVY), strict=True):
        assert row.density_m3 == pytest.approx(density, rel=0.03)
        assert row.shape == pytest.approx(shape, rel=0.05)
        assert row.scale_mm == pytest.approx(scale, rel=0.05)
        for name, true in (("density_m3", density), ("shape", shape), ("scale_mm", scale)):
            low, high = getattr(row.confidence, name)
            assert low < getattr(row, name) < high
            assert 0.9 * low < true < 1.1 * high
    assert [row.intensity_mm_h for row in fitted.calibration.rows] == pytest.approx([0.80, 6.59], rel=0.05)


def test_fall_speed_and_closure_come_back(fitted):
    velocity = fitted.calibration.velocity
    d = np.linspace(0.3, 2.5, 20)
    assert velocity(d) == pytest.approx(-0.342 * d**2 + 3.379 * d + 0.340, rel=0.03)  # a class is taken at its middle
    assert velocity.r2 > 0.99
    for row in fitted.rows:
        assert row.implied_mm_h == pytest.approx(row.row.intensity_mm_h, rel=0.03)
        assert row.moments_implied_mm_h == pytest.approx(row.row.intensity_mm_h, rel=0.03)
        assert row.moments_shape == pytest.approx(row.row.shape, rel=0.1)
    assert fitted.fitted_range_mm == (0.25, 8.0)


def test_speeds_of_a_class_have_a_mean_and_a_deviation():
    scattered = measured_rain(*HEAVY, minutes=5, seed=5, scatter=0.15)
    light = measured_rain(*LIGHT, minutes=5, seed=6, start="2024-05-01T12:00", scatter=0.15)
    options = msgspec.structs.replace(OPTIONS, resamples=0)
    speeds = fit_calibration([scattered, light], name="", source="", options=options).speeds
    counts = (scattered.counts.sum(axis=0) + light.counts.sum(axis=0)).astype(int)
    middles = scattered.velocities_m_s
    for diameter in (3, 7, 11):
        drawn = np.repeat(middles, counts[diameter])
        assert speeds.drops[diameter] == len(drawn)
        assert speeds.mean_m_s[diameter] == pytest.approx(drawn.mean())
        assert speeds.deviation_m_s[diameter] == pytest.approx(drawn.std(), rel=1e-6)
        assert 0.3 < speeds.deviation_m_s[diameter] < 1.5
    empty = counts.sum(axis=1) == 0
    assert np.isnan(speeds.mean_m_s[empty]).all() and empty.any()
    np.testing.assert_array_equal(speeds.fitted, (speeds.drops >= 10) & (scattered.diameters_mm < 8))


def test_intervals_of_the_fall_speed_hold_its_coefficients(fitted):
    intervals = fitted.velocity_confidence
    assert intervals is not None
    for (low, high), value in zip(intervals, fitted.calibration.velocity.coefficients, strict=True):
        assert low < high and low - 0.02 < value < high + 0.02
        assert 0.02 < high - low < 0.3


def test_too_few_minutes_or_no_resamples_give_no_interval_of_the_fall_speed(rain):
    def confidence(light_records: int, resamples: int):
        parts = [rain[0][:light_records], rain[1][:2]]
        heavy = replace(parts[1], counts=40 * parts[1].counts, area_m2=parts[1].area_m2)
        light = replace(parts[0], counts=40 * parts[0].counts)
        options = FitOptions(intensities_mm_h=(0.8 * 40, 6.6 * 40), half_width=0.6, resamples=resamples)
        return fit_calibration([light, heavy], name="", source="", options=options).velocity_confidence

    assert confidence(8, 50) is not None  # four light minutes and a heavy one
    assert confidence(6, 50) is None
    assert confidence(8, 0) is None


def test_a_class_that_one_minute_alone_has_does_not_widen_the_intervals(rain):
    """Minutes that are not drawn are replaced by the mean over all minutes."""
    counts = rain[1].counts.copy()
    counts[:, 16:] = 0
    counts[0, 19, 23] = 12  # 4.75 mm at 9.2 m/s, in one of thirty minutes
    fitted = fit_calibration([rain[0], replace(rain[1], counts=counts)], name="", source="", options=OPTIONS)
    assert fitted.speeds.fitted[19] and fitted.speeds.drops[19] == 12
    for (low, high), value in zip(fitted.velocity_confidence, fitted.calibration.velocity.coefficients, strict=True):
        assert high - low < 0.2 and low - 0.02 < value < high + 0.02


def test_figures_are_rounded_to_four_digits(fitted):
    velocity = fitted.calibration.velocity
    for value in (*velocity.coefficients, velocity.r2):
        assert value == float(f"{value:.4g}")


def test_what_is_measured_is_judged_and_what_is_trusted_is_fitted(rain):
    splashes = rain[0].counts.copy()
    splashes[:, 12, 3] += 50
    measured = [replace(rain[0], counts=splashes), rain[1]]
    options = msgspec.structs.replace(OPTIONS, resamples=0)
    fitted = fit_calibration(rain, measured=measured, name="", source="", options=options)
    assert fitted.rate_check.ratio > 1.3
    assert fitted.rows[0].row == fit_calibration(rain, name="", source="", options=options).rows[0].row


def test_minutes_keep_both_rates_for_plots(fitted, rain):
    assert len(fitted.minute_rate_mm_h) == len(fitted.minute_reported_mm_h) == 90
    first = rain[0].rate_mm_h[:2].mean(), rain[0].reported_mm_h[:2].mean()
    assert (fitted.minute_rate_mm_h[0], fitted.minute_reported_mm_h[0]) == pytest.approx(first)
    assert (fitted.calibration.name, fitted.calibration.source) == ("test", "drawn")
    assert [row.middle_mm_h for row in fitted.rows] == [0.8, 6.6]
    np.testing.assert_array_equal(fitted.diameter_edges_mm, rain[0].diameter_edges_mm)


def test_more_minutes_make_narrower_intervals(rain):
    narrow = fit_calibration(rain, name="", source="", options=OPTIONS).calibration.rows[0].confidence.density_m3
    wide = fit_calibration([rain[0][:20], rain[1]], name="", source="", options=OPTIONS)
    assert np.ptp(wide.calibration.rows[0].confidence.density_m3) > 1.5 * np.ptp(narrow)


def test_intervals_hold_the_truth_about_as_often_as_they_say():
    held = 0
    options = msgspec.structs.replace(OPTIONS, resamples=100)
    heavy = measured_rain(*HEAVY, minutes=5, seed=0)
    for seed in range(14):
        light = measured_rain(*LIGHT, minutes=10, seed=100 + seed)
        row = fit_calibration([light, heavy], name="", source="", options=options).calibration.rows[0]
        low, high = row.confidence.density_m3
        held += low < LIGHT[0] < high
    assert held >= 10


def test_counts_and_records_add_up(fitted, rain):
    assert fitted.records == sum(len(each) for each in rain) == 180
    assert fitted.records_used == sum(row.records for row in fitted.rows)
    assert fitted.records_used == 180  # at half width 0.5 every minute is in a bin
    assert [row.minutes for row in fitted.rows] == [60, 30]
    assert sum(row.drops for row in fitted.rows) == sum(each.counts.sum() for each in rain)


def test_the_instruments_own_rate_is_checked(fitted, rain):
    assert fitted.rate_check.ratio == pytest.approx(1, abs=0.03)
    assert fitted.rate_check.correlation > 0.99
    halved = [replace(each, reported_mm_h=2 * each.reported_mm_h) for each in rain]
    check = fit_calibration(rain, measured=halved, name="", source="", options=OPTIONS).rate_check
    assert check.ratio == pytest.approx(fitted.rate_check.ratio / 2, rel=0.01)
    silent = [replace(each, reported_mm_h=np.full(len(each), np.nan)) for each in rain]
    assert fit_calibration(silent, name="", source="", options=OPTIONS).rate_check is None


def test_the_same_seed_gives_the_same_intervals(fitted, rain):
    again = fit_calibration(rain, name="test", source="drawn", options=OPTIONS)
    assert again.calibration == fitted.calibration
    other = fit_calibration(
        rain, name="test", source="drawn", options=msgspec.structs.replace(OPTIONS, seed=1)
    ).calibration.rows[0]
    assert other.confidence != fitted.calibration.rows[0].confidence
    assert other.density_m3 == fitted.calibration.rows[0].density_m3


def test_without_speeds_the_fall_speed_is_assumed(rain):
    flat = [replace(each, velocity_edges_m_s=None, counts=each.counts.sum(axis=2, keepdims=True)) for each in rain]
    fitted = fit_calibration(flat, name="", source="", options=OPTIONS)
    assert fitted.speeds is None and fitted.velocity_confidence is None and fitted.calibration.velocity.r2 is None
    # Atlas's speeds are higher than those of these drops: the same counts are fewer drops in the air.
    assert 0.75 < fitted.calibration.rows[0].density_m3 / LIGHT[0] < 0.95


def test_small_drops_can_be_left_out(rain):
    fitted = fit_calibration(
        rain, name="", source="", options=msgspec.structs.replace(OPTIONS, smallest_mm=0.6, resamples=0)
    )
    assert fitted.fitted_range_mm == (0.625, 8.0)
    row = fitted.calibration.rows[0]
    assert row.confidence is None
    assert row.density_m3 == pytest.approx(LIGHT[0], rel=0.1)  # those below are known from the law
    assert fitted.rows[0].drops < 0.85 * rain[0].counts.sum()


def test_records_of_minutes_in_no_bin_are_not_used(rain):
    options = FitOptions(intensities_mm_h=(0.8, 6.6), half_width=0.1, resamples=0)
    fitted = fit_calibration(rain, name="", source="", options=options)
    assert fitted.records == 180
    assert 0 < fitted.records_used == sum(row.records for row in fitted.rows) < 180
    wide = FitOptions(intensities_mm_h=(0.7, 0.9, 6.6), half_width=0.3, resamples=0)
    overlapping = fit_calibration(rain, name="", source="", options=wide)
    assert sum(row.records for row in overlapping.rows) > overlapping.records_used <= 180


def test_the_refusal_says_how_much_rain_each_bin_has(rain):
    options = FitOptions(intensities_mm_h=(0.8, 3.0, 6.6), half_width=0.3, resamples=0)
    few = replace(rain[1][:2], counts=rain[1].counts[:2] * (np.arange(32) > 6)[:, None])
    with pytest.raises(ValueError) as caught:
        fit_calibration([rain[0], few], name="", source="", options=options)
    said = str(caught.value)
    assert "two intensities with 5000 drops, or 500 in 5 minutes: of 3 bins 1 have them (" in said
    assert "6.6 mm/h: 1 minutes with" in said and "3 mm/h: no rain" not in said


def test_bins_without_rain_are_named(rain):
    options = FitOptions(intensities_mm_h=(0.8, 3.0, 6.6, 50.0), half_width=0.3, resamples=0)
    fitted = fit_calibration(rain, name="", source="", options=options)
    assert fitted.passed_over == ("3 mm/h: no rain", "50 mm/h: no rain")
    assert len(fitted.rows) == 2


def test_a_bin_with_the_minutes_of_another_gives_no_second_row(rain):
    options = FitOptions(intensities_mm_h=(0.8, 0.81, 6.6), half_width=0.9, resamples=0)
    fitted = fit_calibration(rain, name="", source="", options=options)
    assert len(fitted.rows) == 2
    assert fitted.passed_over == ("0.81 mm/h: the same minutes as 0.8 mm/h",)


def test_one_intensity_is_no_calibration(rain):
    with pytest.raises(ValueError, match="of 2 bins 1 have them"):
        fit_calibration(rain[:1], name="", source="", options=OPTIONS)


def test_a_dry_file_is_refused(rain):
    dry = replace(rain[0], counts=np.zeros_like(rain[0].counts))
    with pytest.raises(ValueError, match="too few drops to fit"):
        fit_calibration([dry], name="", source="", options=OPTIONS)
    with pytest.raises(ValueError, match="too few drops to fit"):
        fit_calibration([dry[:0]], name="", source="", options=OPTIONS)


def test_files_of_other_classes_are_refused(rain):
    other = replace(rain[1], area_m2=2 * rain[1].area_m2)
    with pytest.raises(ValueError, match="differ in area_m2"):
        fit_calibration([rain[0], other], name="", source="", options=OPTIONS)


def test_implied_rates_are_those_of_the_rain_state(fitted):
    row = fitted.rows[1]
    sizes = DropSizes(row.row.shape, row.row.scale_mm)
    assert row.implied_mm_h == pytest.approx(
        flux_mm_h(row.row.density_m3, sizes, fitted.calibration.velocity), rel=0.002
    )
