"""Calibrations fitted to drops of a known law: the models, numbers with their intervals, refusals, and the figure."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy import optimize, stats

from gsrain_engine.disdrometer.fit import fit_calibration
from gsrain_engine.disdrometer.fit_models import (
    AxisRatios,
    FitOptions,
    GammaLaws,
    assumed_velocity,
    class_shares,
    fit_axis_ratio,
    fit_by_likelihood,
    fit_by_moments,
    fit_velocity,
    percentile_interval,
    sum_minutes,
)
from gsrain_engine.disdrometer.fit_plot import draw_calibration, write_plot
from gsrain_engine.disdrometer.spectra import DropSpectra, SingleDrops
from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
from gsrain_engine.rain.calibration import atlas_velocity, load_calibration
from gsrain_engine.rain.properties import DropSizes, flux_mm_h
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from measured_rain import measured_rain

LIGHT, HEAVY = (271.0, 9.705, 0.074), (1190.0, 7.132, 0.114)
OPTIONS = FitOptions(intensities_mm_h=(0.8, 6.6), half_width=0.5, resamples=200)


def fit(rain, measured=None, **changes):
    options = msgspec.structs.replace(OPTIONS, **changes)
    return fit_calibration(rain, name="test", source="drawn", options=options, measured=measured)


@pytest.fixture(scope="module")
def rain():
    return [
        measured_rain(*LIGHT, minutes=60, seed=1),
        measured_rain(*HEAVY, minutes=30, seed=2, start="2024-05-01T12:00"),
    ]


@pytest.fixture(scope="module")
def fitted(rain):
    return fit(rain)


def test_laws_and_speeds_come_back_from_a_parsivels_counts(fitted):
    calibration = fitted.calibration
    for row, law in zip(calibration.rows, (LIGHT, HEAVY), strict=True):
        for name, true, rel in zip(("density_m3", "shape", "scale_mm"), law, (0.03, 0.05, 0.05), strict=True):
            value, (low, high) = getattr(row, name), getattr(row.confidence, name)
            assert value == pytest.approx(true, rel=rel)
            assert low < value < high and 0.9 * low < true < 1.1 * high
    assert [row.intensity_mm_h for row in calibration.rows] == pytest.approx([0.80, 6.59], rel=0.05)
    d = np.linspace(0.3, 2.5, 20)  # a class is taken at its middle
    assert calibration.velocity(d) == pytest.approx(-0.342 * d**2 + 3.379 * d + 0.340, rel=0.03)
    for (low, high), value in zip(fitted.velocity_confidence, calibration.velocity.coefficients, strict=True):
        assert low - 0.02 < value < high + 0.02 and 0.02 < high - low < 0.3
    for value in (*calibration.velocity.coefficients, calibration.velocity.r2):
        assert value == float(f"{value:.4g}")  # rounded
    assert calibration.velocity.r2 > 0.99 and fitted.fitted_range_mm == (0.25, 8.0)


def test_implied_rates_and_counts_add_up(fitted, rain):
    for each in fitted.rows:
        sizes = DropSizes(each.row.shape, each.row.scale_mm)
        implied = flux_mm_h(each.row.density_m3, sizes, fitted.calibration.velocity)
        assert each.implied_mm_h == pytest.approx(implied, rel=0.002)
        assert [each.implied_mm_h, each.moments_implied_mm_h] == pytest.approx([each.row.intensity_mm_h] * 2, rel=0.03)
        assert each.moments_shape == pytest.approx(each.row.shape, rel=0.1)
    assert fitted.records == fitted.records_used == sum(map(len, rain)) == sum(row.records for row in fitted.rows)
    assert [(row.minutes, row.middle_mm_h) for row in fitted.rows] == [(60, 0.8), (30, 6.6)]
    assert sum(row.drops for row in fitted.rows) == sum(each.counts.sum() for each in rain)
    first = rain[0].rate_mm_h[:2].mean(), rain[0].reported_mm_h[:2].mean()
    assert (fitted.minute_rate_mm_h[0], fitted.minute_reported_mm_h[0]) == pytest.approx(first)
    assert len(fitted.minute_rate_mm_h) == 90


def test_intervals_need_minutes_and_follow_the_seed(fitted, rain):
    def confidence(light_records: int):
        light, heavy = (replace(each, counts=40 * each.counts) for each in (rain[0][:light_records], rain[1][:2]))
        middles = (0.8 * 40, 6.6 * 40)
        return fit([light, heavy], intensities_mm_h=middles, half_width=0.6, resamples=50).velocity_confidence

    assert confidence(8) is not None and confidence(6) is None  # four light minutes and a heavy one, or three
    assert fit(rain).calibration == fitted.calibration
    row, other = fitted.calibration.rows[0], fit(rain, seed=1).calibration.rows[0]
    assert other.confidence != row.confidence and other.density_m3 == row.density_m3


def test_a_class_that_one_minute_alone_has_does_not_widen_the_intervals(rain):
    """Minutes that are not drawn are replaced by the mean over all minutes."""
    counts = rain[1].counts.copy()
    counts[:, 16:] = 0
    counts[0, 19, 23] = 12  # 4.75 mm at 9.2 m/s, in one of thirty minutes
    found = fit([rain[0], replace(rain[1], counts=counts)])
    assert found.speeds.fitted[19]
    assert max(high - low for low, high in found.velocity_confidence) < 0.2


def test_the_instruments_own_rate_is_checked_on_all_measured_drops(fitted, rain):
    assert fitted.rate_check.ratio == pytest.approx(1, abs=0.03) and fitted.rate_check.correlation > 0.99
    silent = [replace(each, reported_mm_h=np.full(len(each), np.nan)) for each in rain]
    assert fit(silent, resamples=0).rate_check is None
    splashes = rain[0].counts.copy()
    splashes[:, 12, 3] += 50
    found = fit(rain, [replace(rain[0], counts=splashes), rain[1]])
    assert found.rate_check.ratio > 1.3 and found.rows[0].row == fitted.rows[0].row


def test_without_speeds_the_fall_speed_is_assumed_and_small_drops_can_be_left_out(rain):
    flat = [replace(each, velocity_edges_m_s=None, counts=each.counts.sum(axis=2, keepdims=True)) for each in rain]
    found = fit(flat, resamples=0)
    assert found.speeds is None and found.velocity_confidence is None and found.calibration.velocity.r2 is None
    # Atlas's speeds are higher than those of these drops: the same counts are fewer drops in the air.
    assert 0.75 < found.calibration.rows[0].density_m3 / LIGHT[0] < 0.95
    found = fit(rain, smallest_mm=0.6, resamples=0)
    row = found.calibration.rows[0]
    assert found.fitted_range_mm == (0.625, 8.0) and row.confidence is None
    assert row.density_m3 == pytest.approx(LIGHT[0], rel=0.1)  # those below are known from the law
    assert found.rows[0].drops < 0.85 * rain[0].counts.sum()


@pytest.mark.parametrize(
    ("middles", "half_width", "overlap", "passed_over"),
    [
        ((0.8, 6.6), 0.1, False, ()),
        ((0.7, 0.9, 6.6), 0.3, True, ()),
        ((0.8, 3.0, 6.6, 50.0), 0.3, False, ("3 mm/h: no rain", "50 mm/h: no rain")),
        ((0.8, 0.81, 6.6), 0.9, True, ("0.81 mm/h: the same minutes as 0.8 mm/h",)),
    ],
)
def test_bins_without_minutes_of_their_own_are_named(middles, half_width, overlap, passed_over, rain):
    found = fit(rain, intensities_mm_h=middles, half_width=half_width, resamples=0)
    assert len(found.rows) == len(middles) - len(passed_over) and found.passed_over == passed_over
    assert (sum(row.records for row in found.rows) > found.records_used) == overlap
    assert 0 < found.records_used <= found.records == 180 and (found.records_used < 180) == (half_width == 0.1)


@pytest.mark.parametrize(
    ("change", "names"),
    [
        (lambda light, heavy: [light, heavy[:2]], r"of 2 bins 1 have them \(6.6 mm/h: 1 minutes"),
        (lambda light, heavy: [replace(light, counts=0 * light.counts)], "too few drops"),
        (lambda light, heavy: [light[:0]], "too few drops"),
        (lambda light, heavy: [light, replace(heavy, area_m2=2 * heavy.area_m2)], "area_m2"),
    ],
)
def test_too_little_rain_and_other_classes_are_refused(change, names, rain):
    light, heavy = rain[0], replace(rain[1], counts=rain[1].counts * (np.arange(32) > 6)[:, None])
    with pytest.raises(ValueError, match=names):
        fit(change(light, heavy), resamples=0, half_width=0.3)


@pytest.mark.parametrize("calibration", ["locarno_2018", "marshall_palmer"])
def test_the_virtual_disdrometer_closes_the_loop(calibration):
    """Fits to its counts return the law that the drops were drawn from; tests/rain has that of the published table."""
    intensities = (1.2, 8.5, 12.0)
    paper = msgspec.to_builtins(load_preset("paper")) | {"calibration": calibration, "closure": "density"}
    rains = [msgspec.convert(paper | {"intensity_mm_h": each}, RainSettings) for each in intensities]
    counted = [
        VirtualDisdrometer(RainSimulation.start(each), area_m2=0.5).measure(np.arange(4) * 40.0) for each in rains
    ]
    found = fit([each.spectra for each in counted], intensities_mm_h=intensities, half_width=0.2, resamples=0)
    for row, each in zip(found.calibration.rows, counted, strict=True):
        for name, rel in (("density_m3", 0.03), ("shape", 0.05), ("scale_mm", 0.05), ("intensity_mm_h", 0.03)):
            assert getattr(row, name) == pytest.approx(getattr(each.state, name), rel=rel)
    d = np.linspace(0.5, 2, 7)
    assert found.calibration.velocity(d) == pytest.approx(load_calibration(calibration).velocity(d), rel=0.03)


def test_the_law_of_marshall_and_palmer():
    d, calibration = np.array([0.3, 1.0, 2.5]), load_calibration("marshall_palmer")
    for row in calibration.rows:
        slope = 4.1 * row.intensity_mm_h**-0.21
        inside = math.exp(-0.1 / row.scale_mm) - math.exp(-8 / row.scale_mm)
        spectrum = row.density_m3 * np.exp(-d / row.scale_mm) / (row.scale_mm * inside)
        assert row.shape == 1 and spectrum == pytest.approx(8000 * np.exp(-slope * d), rel=1e-3)


# Figure


def test_the_figure_shows_the_numbers_with_units(fitted):
    ratios = AxisRatios(
        diameters_mm=np.array([1.1, 2.0, 3.0]), medians=np.array([0.99, 0.93, 0.86]),
        quartiles=np.array([[0.9, 0.85, 0.8], [1.0, 0.98, 0.9]]), drops=300, offset=1.07, slope_per_mm=-0.07, r2=0.9,
    )  # fmt: skip
    bare = replace(fitted, axis_ratios=ratios, speeds=None, velocity_confidence=None)
    for each, letters in ((fitted, "abcde"), (bare, "abcdef")):
        panels = [axes for axes in draw_calibration(each).axes if axes.get_title(loc="left")]
        assert [axes.get_title(loc="left")[:3] for axes in panels] == [f"({letter})" for letter in letters]
        assert all("mm" in axes.get_xlabel() and axes.get_ylabel() and axes.get_legend() for axes in panels)
        points, law = panels[0].lines[2:4]  # of the second row
        row = fitted.rows[1]
        assert points.get_ydata() == pytest.approx(row.spectrum_m3_mm[row.spectrum_m3_mm > 0])
        assert np.trapezoid(law.get_ydata(), law.get_xdata()) == pytest.approx(row.row.density_m3, rel=0.01)


@pytest.mark.parametrize("kind", ["png", "svg"])
def test_the_same_fit_gives_the_same_bytes(kind, fitted, tmp_path):
    first, second = tmp_path / f"a.{kind}", tmp_path / f"b.{kind}"
    write_plot(fitted, first)
    write_plot(fitted, second)
    assert first.read_bytes() == second.read_bytes() and len(first.read_bytes()) > 20_000
    if kind == "png":
        with Image.open(first) as picture:
            assert picture.size == (1950, 1140)
    with pytest.raises(ValueError, match=r"plot\.bmp"):
        write_plot(fitted, tmp_path / "plot.bmp")
    assert set(tmp_path.iterdir()) == {first, second}


# Gamma laws

EDGES = np.concatenate([np.arange(2, 11) * 0.125, np.arange(6, 11) * 0.25, np.arange(6, 11) * 0.5, [6, 7, 8]])


def law(shape, scale):
    return GammaLaws(np.array([shape]), np.array([scale]))


def loss(counts, shape, scale):
    """Negative logarithm of the likelihood, up to a constant."""
    shares = np.maximum(class_shares(law(shape, scale), EDGES)[0], 1e-300)
    return -np.sum(counts * np.log(shares / shares.sum()))


def test_class_shares_are_scipys():
    shares = class_shares(GammaLaws(np.array([1.0, 9.7]), np.array([0.4, 0.074])), EDGES)
    for row, (shape, scale) in zip(shares, ((1.0, 0.4), (9.7, 0.074)), strict=True):
        assert row == pytest.approx(np.diff(stats.gamma.cdf(EDGES, shape, scale=scale)), abs=1e-14)
    assert shares[1, -1] == pytest.approx(stats.gamma.sf(7, 9.7, scale=0.074), rel=1e-6)
    assert 0 < shares[1, -1] < 1e-25  # a difference of lower tails would be 0 here


@given(shape=st.floats(1, 20), mean=st.floats(0.5, 2))
def test_likelihood_recovers_a_law_cut_at_both_ends(shape, mean):
    fitted = fit_by_likelihood(class_shares(law(shape, mean / shape), EDGES), EDGES)
    assert (fitted.shape[0], fitted.scale_mm[0]) == pytest.approx((shape, mean / shape), rel=1e-3)


def test_moments_correct_for_the_class_width_and_not_for_a_cut():
    wide = np.arange(0, 8.1, 0.4)
    fitted = fit_by_moments(class_shares(law(9.0, 0.1), wide), wide)
    assert (fitted.shape[0], fitted.scale_mm[0]) == pytest.approx((9.0, 0.1), rel=0.02)  # uncorrected 0.115
    assert fit_by_moments(class_shares(law(1.0, 0.4), EDGES), EDGES).shape[0] > 2  # 46 % are below 0.25 mm


def test_scoring_reaches_what_a_search_without_slopes_reaches_and_each_fit_is_its_own():
    rng = np.random.default_rng(4)
    laws = ((3.0, 0.3), (9.0, 0.09), (6.0, 0.2))
    histograms = np.stack([rng.poisson(80 * class_shares(law(*each), EDGES)[0]) for each in laws]).astype(np.float64)
    fitted = fit_by_likelihood(histograms, EDGES)
    for i, counts in enumerate(histograms):
        best = optimize.minimize(
            lambda at, counts=counts: loss(counts, *np.exp(at)),
            np.log([5.0, 0.2]), method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10},
        )  # fmt: skip
        assert [fitted.shape[i], fitted.scale_mm[i]] == pytest.approx(np.exp(best.x), rel=1e-4)


@pytest.mark.parametrize(("true", "limit"), [((900.0, 0.0016), 200.0), ((250.0, 0.005), 200.0), ((0.02, 0.8), 0.2)])
def test_at_the_limit_of_the_shape_the_scale_is_still_the_likeliest(true, limit):
    shares = class_shares(law(*true), EDGES)
    fitted = fit_by_likelihood(shares, EDGES)
    bounds = np.log((0.5 * fitted.scale_mm[0], 2 * fitted.scale_mm[0]))
    best = optimize.minimize_scalar(
        lambda log_scale: loss(shares[0], limit, np.exp(log_scale)), bounds=bounds, method="bounded",
        options={"xatol": 1e-9},
    )  # fmt: skip
    assert fitted.shape[0] == pytest.approx(limit)
    assert fitted.scale_mm[0] == pytest.approx(np.exp(best.x), rel=1e-5)


# Fall speed

D = np.linspace(0.3, 5, 20)
TRUE = np.polyval((-0.342, 3.379, 0.340), D)


def test_a_class_counts_by_the_standard_error_of_its_mean_and_scarce_ones_and_giants_not_at_all():
    """The weights: 0.8 m/s over the root of the drops, and 0.2 m/s that a quadratic misses."""
    diameters, drops = np.append(D, [5.5, 9.0]), np.append(np.geomspace(1e5, 20, 20), [9, 100])
    noisy = TRUE + 0.5 * np.random.default_rng(0).standard_normal(20)
    for speeds in (TRUE, noisy):
        fit = fit_velocity(diameters, np.append(speeds, [20.0, 1.0]), drops)
        squared = 1 / (0.64 / drops[:20] + 0.04)
        assert fit.coefficients == pytest.approx(np.polyfit(D, speeds, 2, w=np.sqrt(squared)), rel=1e-9)
        misfit = np.sum(squared * (speeds - np.polyval(fit.coefficients, D)) ** 2)
        assert fit.r2 == pytest.approx(
            1 - misfit / np.sum(squared * (speeds - np.average(speeds, weights=squared)) ** 2)
        )
    assert 0.8 < fit.r2 < 0.99
    d = np.linspace(0.4, 5, 50)
    assert np.abs(assumed_velocity()(d) - atlas_velocity(d)).max() < 0.4 and assumed_velocity().r2 is None


def test_too_few_classes_are_refused():
    density = np.zeros((1, len(EDGES) - 1))
    density[0, 3:5] = 10
    with pytest.raises(ValueError, match="three diameter classes"):
        fit_by_likelihood(density, EDGES)
    density[0, 5] = 1
    assert np.isfinite(fit_by_likelihood(density, EDGES).shape[0])
    with pytest.raises(ValueError, match="3 diameter classes"):
        fit_velocity(D[:3], TRUE[:3], np.full(3, 50.0))


# Axis ratio


def single_drops(n, speed_factor=1.0, largest=5.0):
    rng = np.random.default_rng(3)
    diameters = rng.uniform(0.3, largest, n)
    return SingleDrops(
        diameters_mm=diameters,
        speeds_m_s=speed_factor * atlas_velocity(diameters),
        axis_ratios=np.where(diameters > 1, 1.07 - 0.07 * diameters, 1.0) + 0.05 * rng.standard_normal(n),
        times=np.full(n, np.datetime64("2024-05-01", "ms")),
    )


def test_the_papers_line_of_axis_ratios_comes_back():
    fit = fit_axis_ratio(single_drops(20_000))
    assert (fit.offset, fit.slope_per_mm) == pytest.approx((1.07, -0.07), abs=0.006)
    assert fit.drops == pytest.approx(20_000, rel=0.01) and fit.r2 > 0.97
    assert fit.medians[0] == pytest.approx(1.0, abs=0.01)
    assert np.all(fit.quartiles[0] < fit.medians) and np.all(fit.medians < fit.quartiles[1])
    assert fit_axis_ratio(single_drops(20_000, speed_factor=0.3)) is None  # splashes
    assert fit_axis_ratio(single_drops(20_000, largest=1.4)) is None  # all small
    straight = single_drops(40_000)  # classes hold about as many drops each, so weights change little
    fit = fit_axis_ratio(replace(straight, axis_ratios=1 - 0.03 * (straight.diameters_mm - 0.5) ** 2))
    large = fit.diameters_mm > 1
    assert fit.r2 == pytest.approx(np.corrcoef(fit.diameters_mm[large], fit.medians[large])[0, 1] ** 2, abs=0.003)


# Intervals, spectra and minutes


def test_intervals_hold_95_percent_to_four_digits():
    assert percentile_interval(np.arange(1001) / 3) == (8.333, 325.0)


def spectra_of(times, seconds, counts, velocity_edges=(0.0, 2.0, 6.0)):
    return DropSpectra(
        instrument="test",
        times=np.array(times, "datetime64[ms]"),
        seconds=np.array(seconds, np.float64),
        diameter_edges_mm=np.array([0.5, 1.5, 2.5]),
        velocity_edges_m_s=None if velocity_edges is None else np.array(velocity_edges),
        counts=np.array(counts, np.float64),
        area_m2=np.array([0.005, 0.004]),
        reported_mm_h=np.array([6.0, 12.0, np.nan][: len(seconds)]),
    )


def test_rate_is_the_water_over_area_and_time():
    """One drop of 2 mm a second on 40 cm^2: 4.18879 mm^3 / 4000 mm^2 a second, 3600 times an hour."""
    found = spectra_of(["NaT", "NaT"], [60, 60], [[[0, 0], [60, 0]], [[0, 0], [0, 0]]])
    np.testing.assert_allclose(found.rate_mm_h, [np.pi / 6 * 8 / 4000 * 3600, 0])
    with pytest.raises(ValueError, match="area_m2"):
        found.concatenate([found, replace(found, area_m2=2 * found.area_m2)])
    with pytest.raises(ValueError, match="velocity classes"):
        replace(found, velocity_edges_m_s=None)


def test_records_of_a_minute_are_summed_and_those_without_a_time_are_alone():
    """A record that ends at 10:01:00 belongs to the minute from 10:00."""
    three = [[[1, 2], [0, 4]], [[3, 0], [0, 0]], [[0, 0], [0, 8]]]
    given = spectra_of(["2024-05-01T10:00:20", "2024-05-01T10:01:00", "2024-05-01T10:01:30"], [20, 40, 30], three)
    minutes = sum_minutes(given)
    assert minutes.seconds.tolist() == [60, 30]
    assert minutes.records.tolist() == [2, 1]
    assert minutes.drops.tolist() == [[6, 4], [0, 8]]
    assert minutes.density_seconds[0] == pytest.approx([(4 / 1 + 2 / 4) / 0.005, 4 / 4 / 0.004])
    assert minutes.speed_sum[0] == pytest.approx([4 * 1 + 2 * 4, 4 * 4])
    assert minutes.rate_mm_h[0] == pytest.approx((20 * given.rate_mm_h[0] + 40 * given.rate_mm_h[1]) / 60)
    assert minutes.reported_mm_h[0] == pytest.approx((20 * 6 + 40 * 12) / 60) and np.isnan(minutes.reported_mm_h[1])
    minutes = sum_minutes(spectra_of(["NaT", "NaT", "2024-05-01T10:00:30"], [30, 30, 30], three))
    assert minutes.records.tolist() == [1, 1, 1] and sorted(minutes.drops.sum(axis=1)) == [3, 7, 8]
    minutes = sum_minutes(spectra_of(["NaT"], [60], [[[5.0], [0.0]]], velocity_edges=None))  # falling as Atlas says
    assert minutes.density_seconds[0, 0] == pytest.approx(5 / (0.005 * float(atlas_velocity(np.array([1.0]))[0])))
