"""Axis ratios of single drops."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.disdrometer.fit_models import fit_axis_ratio
from gsrain_engine.disdrometer.spectra import SingleDrops
from gsrain_engine.rain.calibration import atlas_velocity


def drops(n, speed_factor=1.0, largest=5.0):
    rng = np.random.default_rng(3)
    diameters = rng.uniform(0.3, largest, n)
    ratios = np.where(diameters > 1, 1.07 - 0.07 * diameters, 1.0) + 0.05 * rng.standard_normal(n)
    return SingleDrops(
        diameters_mm=diameters,
        speeds_m_s=speed_factor * atlas_velocity(diameters),
        axis_ratios=ratios,
        times=np.full(n, np.datetime64("2024-05-01", "ms")),
    )


def test_the_papers_line_comes_back():
    fit = fit_axis_ratio(drops(20_000))
    assert (fit.offset, fit.slope_per_mm) == pytest.approx((1.07, -0.07), abs=0.006)
    assert fit.r2 > 0.97
    assert fit.drops == pytest.approx(20_000, rel=0.01)
    assert fit.medians[0] == pytest.approx(1.0, abs=0.01)
    assert np.all(fit.quartiles[0] < fit.medians) and np.all(fit.medians < fit.quartiles[1])


def test_r2_of_medians_on_a_bow_is_the_square_of_their_correlation():
    """Classes hold about as many drops each, so weights change little."""
    straight = drops(40_000)
    bow = 1 - 0.03 * (straight.diameters_mm - 0.5) ** 2
    fit = fit_axis_ratio(replace(straight, axis_ratios=bow))
    large = fit.diameters_mm > 1
    expected = np.corrcoef(fit.diameters_mm[large], fit.medians[large])[0, 1] ** 2
    assert fit.r2 == pytest.approx(expected, abs=0.003) and 0.9 < expected < 0.99


def test_splashes_have_no_say():
    assert fit_axis_ratio(drops(20_000, speed_factor=0.3)) is None


def test_no_line_through_drops_that_are_all_small():
    assert fit_axis_ratio(drops(20_000, largest=1.4)) is None
