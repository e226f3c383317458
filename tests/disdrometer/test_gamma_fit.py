"""The gamma law comes back from histograms that are cut off and noisy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize, stats

from gsrain_engine.disdrometer.fit_models import GammaLaws, class_shares, fit_by_likelihood, fit_by_moments

EDGES = np.concatenate([np.arange(2, 11) * 0.125, np.arange(6, 11) * 0.25, np.arange(6, 11) * 0.5, [6, 7, 8]])


def law(shape, scale):
    return GammaLaws(np.array([shape]), np.array([scale]))


def test_class_shares_are_scipys():
    shares = class_shares(GammaLaws(np.array([1.0, 9.7]), np.array([0.4, 0.074])), EDGES)
    for row, (shape, scale) in zip(shares, ((1.0, 0.4), (9.7, 0.074)), strict=True):
        assert row == pytest.approx(np.diff(stats.gamma.cdf(EDGES, shape, scale=scale)), abs=1e-14)
    assert shares[1, -1] == pytest.approx(stats.gamma.sf(7, 9.7, scale=0.074), rel=1e-6)
    assert 0 < shares[1, -1] < 1e-25  # a difference of lower tails would be 0 here


@given(shape=st.floats(1, 20), mean=st.floats(0.5, 2))
def test_likelihood_recovers_a_law_cut_at_both_ends(shape, mean):
    laws = law(shape, mean / shape)
    fitted = fit_by_likelihood(class_shares(laws, EDGES), EDGES)
    assert fitted.shape[0] == pytest.approx(shape, rel=1e-3)
    assert fitted.scale_mm[0] == pytest.approx(mean / shape, rel=1e-3)


def test_likelihood_sees_past_the_cut_and_moments_do_not():
    shares = class_shares(law(1.0, 0.4), EDGES)  # 46 % of these drops are below 0.25 mm
    assert fit_by_likelihood(shares, EDGES).shape[0] == pytest.approx(1.0, rel=1e-3)
    assert fit_by_moments(shares, EDGES).shape[0] > 2


def test_scoring_reaches_what_a_search_without_slopes_reaches():
    rng = np.random.default_rng(4)
    histograms = np.stack(
        [rng.poisson(80 * class_shares(law(*each), EDGES)[0]) for each in ((3.0, 0.3), (9.0, 0.09), (6.0, 0.2))]
    ).astype(np.float64)
    fitted = fit_by_likelihood(histograms, EDGES)
    for i, counts in enumerate(histograms):

        def loss(at, counts=counts):
            shares = class_shares(law(*np.exp(at)), EDGES)[0]
            return -np.sum(counts * np.log(np.maximum(shares / shares.sum(), 1e-300)))

        best = optimize.minimize(
            loss, np.log([5.0, 0.2]), method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10}
        )
        assert [fitted.shape[i], fitted.scale_mm[i]] == pytest.approx(np.exp(best.x), rel=1e-4)


@pytest.mark.parametrize(("true", "limit"), [((900.0, 0.0016), 200.0), ((250.0, 0.005), 200.0), ((0.02, 0.8), 0.2)])
def test_where_the_shape_stands_at_its_limit_the_scale_is_still_the_likeliest(true, limit):
    shares = class_shares(law(*true), EDGES)
    fitted = fit_by_likelihood(shares, EDGES)

    def loss(log_scale):
        own = np.maximum(class_shares(law(limit, np.exp(log_scale)), EDGES)[0], 1e-300)
        return -np.sum(shares[0] * np.log(own / own.sum()))

    bounds = np.log((0.5 * fitted.scale_mm[0], 2 * fitted.scale_mm[0]))
    best = optimize.minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 1e-9})
    assert fitted.shape[0] == pytest.approx(limit)
    assert fitted.scale_mm[0] == pytest.approx(np.exp(best.x), rel=1e-5)


def test_fits_do_not_depend_on_their_company():
    rng = np.random.default_rng(5)
    histograms = rng.poisson(200 * class_shares(law(7.0, 0.11), EDGES)[0], (5, len(EDGES) - 1)).astype(np.float64)
    together, alone = fit_by_likelihood(histograms, EDGES), fit_by_likelihood(histograms[3:4], EDGES)
    assert together.shape[3] == pytest.approx(alone.shape[0], rel=1e-6)
    assert np.ptp(together.shape) > 0.1


def test_moments_take_the_width_of_the_classes_out():
    wide = np.arange(0, 8.1, 0.4)
    fitted = fit_by_moments(class_shares(law(9.0, 0.1), wide), wide)
    assert fitted.shape[0] == pytest.approx(9.0, rel=0.02)
    assert fitted.scale_mm[0] == pytest.approx(0.1, rel=0.02)  # without Sheppard's correction 0.115


def test_two_classes_are_too_few_for_two_numbers():
    density = np.zeros((1, len(EDGES) - 1))
    density[0, 3:5] = 10
    with pytest.raises(ValueError, match="at least three diameter classes"):
        fit_by_likelihood(density, EDGES)
    density[0, 5] = 1
    assert np.isfinite(fit_by_likelihood(density, EDGES).shape[0])
