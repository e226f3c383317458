"""A quadratic through mean fall speeds."""

import numpy as np
import pytest

from gsrain_engine.disdrometer.fit_models import assumed_velocity, fit_velocity, speed_weights
from gsrain_engine.rain.calibration import atlas_velocity

D = np.linspace(0.3, 5, 20)
TRUE = -0.342 * D**2 + 3.379 * D + 0.340


def test_an_exact_quadratic_comes_back():
    fit = fit_velocity(D, TRUE, np.geomspace(1e5, 20, 20))
    assert fit.coefficients == pytest.approx((-0.342, 3.379, 0.340), rel=1e-6)
    assert fit.r2 == pytest.approx(1)


def test_a_class_counts_by_the_standard_error_of_its_mean():
    """0.8 m/s over the root of its drops, and 0.2 m/s that a quadratic misses: 16 drops are worth 1 / sqrt(0.08)."""
    assert speed_weights(np.array([1.0, 16.0, 1e15])) == pytest.approx([1 / np.sqrt(0.68), 1 / np.sqrt(0.08), 5.0])


def test_scarce_classes_and_giants_are_left_out():
    diameters, drops = np.append(D, [5.5, 9.0]), np.append(np.full(20, 100.0), [9, 100])
    assert fit_velocity(diameters, np.append(TRUE, [20.0, 1.0]), drops).coefficients == pytest.approx(
        (-0.342, 3.379, 0.340), rel=1e-6
    )


def test_noise_lowers_r2_as_it_should():
    noise = 0.5 * np.random.default_rng(0).standard_normal(20)
    fit = fit_velocity(D, TRUE + noise, np.full(20, 1000.0))
    assert 0.9 < fit.r2 < 0.99
    residual = np.sum((TRUE + noise - np.polyval(fit.coefficients, D)) ** 2)
    assert fit.r2 == pytest.approx(1 - residual / np.sum((TRUE + noise - np.mean(TRUE + noise)) ** 2))


def test_three_classes_are_too_few():
    with pytest.raises(ValueError, match="3 diameter classes with at least 10 drops"):
        fit_velocity(D[:3], TRUE[:3], np.full(3, 50.0))


def test_assumed_speeds_are_near_atlas():
    d = np.linspace(0.4, 5, 50)
    assert np.abs(assumed_velocity()(d) - atlas_velocity(d)).max() < 0.4
    assert assumed_velocity().r2 is None
