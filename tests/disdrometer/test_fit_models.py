"""Models fitted to drops: the gamma law, the fall speed, the axis ratio, and the sums that they are fitted to."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize, stats

from gsrain_engine.disdrometer.fit_models import (
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
from gsrain_engine.disdrometer.spectra import DropSpectra, SingleDrops
from gsrain_engine.rain.calibration import atlas_velocity

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


def drops(n, speed_factor=1.0, largest=5.0):
    rng = np.random.default_rng(3)
    diameters = rng.uniform(0.3, largest, n)
    return SingleDrops(
        diameters_mm=diameters,
        speeds_m_s=speed_factor * atlas_velocity(diameters),
        axis_ratios=np.where(diameters > 1, 1.07 - 0.07 * diameters, 1.0) + 0.05 * rng.standard_normal(n),
        times=np.full(n, np.datetime64("2024-05-01", "ms")),
    )


def test_the_papers_line_of_axis_ratios_comes_back():
    fit = fit_axis_ratio(drops(20_000))
    assert (fit.offset, fit.slope_per_mm) == pytest.approx((1.07, -0.07), abs=0.006)
    assert fit.drops == pytest.approx(20_000, rel=0.01) and fit.r2 > 0.97
    assert fit.medians[0] == pytest.approx(1.0, abs=0.01)
    assert np.all(fit.quartiles[0] < fit.medians) and np.all(fit.medians < fit.quartiles[1])
    assert fit_axis_ratio(drops(20_000, speed_factor=0.3)) is None  # splashes
    assert fit_axis_ratio(drops(20_000, largest=1.4)) is None  # all small
    straight = drops(40_000)  # classes hold about as many drops each, so weights change little
    fit = fit_axis_ratio(replace(straight, axis_ratios=1 - 0.03 * (straight.diameters_mm - 0.5) ** 2))
    large = fit.diameters_mm > 1
    assert fit.r2 == pytest.approx(np.corrcoef(fit.diameters_mm[large], fit.medians[large])[0, 1] ** 2, abs=0.003)


# Intervals, spectra and minutes


def test_intervals_hold_95_percent_to_four_digits():
    assert percentile_interval(np.arange(1001) / 3) == (8.333, 325.0)


def spectra(times, seconds, counts, velocity_edges=(0.0, 2.0, 6.0)):
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
    found = spectra(["NaT", "NaT"], [60, 60], [[[0, 0], [60, 0]], [[0, 0], [0, 0]]])
    np.testing.assert_allclose(found.rate_mm_h, [np.pi / 6 * 8 / 4000 * 3600, 0])
    with pytest.raises(ValueError, match="area_m2"):
        found.concatenate([found, replace(found, area_m2=2 * found.area_m2)])
    with pytest.raises(ValueError, match="velocity classes"):
        replace(found, velocity_edges_m_s=None)


def test_records_of_a_minute_are_summed_and_those_without_a_time_are_alone():
    """A record that ends at 10:01:00 belongs to the minute from 10:00."""
    three = [[[1, 2], [0, 4]], [[3, 0], [0, 0]], [[0, 0], [0, 8]]]
    given = spectra(["2024-05-01T10:00:20", "2024-05-01T10:01:00", "2024-05-01T10:01:30"], [20, 40, 30], three)
    minutes = sum_minutes(given)
    assert minutes.seconds.tolist() == [60, 30]
    assert minutes.records.tolist() == [2, 1]
    assert minutes.drops.tolist() == [[6, 4], [0, 8]]
    assert minutes.density_seconds[0] == pytest.approx([(4 / 1 + 2 / 4) / 0.005, 4 / 4 / 0.004])
    assert minutes.speed_sum[0] == pytest.approx([4 * 1 + 2 * 4, 4 * 4])
    assert minutes.rate_mm_h[0] == pytest.approx((20 * given.rate_mm_h[0] + 40 * given.rate_mm_h[1]) / 60)
    assert minutes.reported_mm_h[0] == pytest.approx((20 * 6 + 40 * 12) / 60) and np.isnan(minutes.reported_mm_h[1])
    minutes = sum_minutes(spectra(["NaT", "NaT", "2024-05-01T10:00:30"], [30, 30, 30], three))
    assert minutes.records.tolist() == [1, 1, 1] and sorted(minutes.drops.sum(axis=1)) == [3, 7, 8]
    minutes = sum_minutes(spectra(["NaT"], [60], [[[5.0], [0.0]]], velocity_edges=None))  # falling as Atlas says
    assert minutes.density_seconds[0, 0] == pytest.approx(5 / (0.005 * float(atlas_velocity(np.array([1.0]))[0])))
