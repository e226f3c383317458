import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special, stats

from gsrain_engine.rain.calibration import (
    VelocityFit,
    atlas_velocity,
    calibration_names,
    load_calibration,
    save_calibration,
)
from gsrain_engine.rain.properties import CLASSES, DropSizes, calibration_curves, spectrum_at

laws = st.builds(DropSizes, st.floats(1, 30), st.floats(0.02, 0.5))


@given(laws, st.floats(0, 1))
@settings(max_examples=50, deadline=None)
def test_quantiles_and_density_are_those_of_the_truncated_gamma(sizes, probability):
    diameter = sizes.quantile(np.array([probability]))
    gamma = stats.gamma(sizes.shape, scale=sizes.scale_mm)
    low, high = gamma.cdf([0.1, 8.0])
    assert 0.1 <= diameter[0] <= 8.0
    assert (gamma.cdf(diameter) - low) / (high - low) == pytest.approx(probability, abs=1e-6)
    shares = (gamma.cdf(sizes.class_diameters_mm[[0, 9000, -1]]) - low) / (high - low)
    assert CLASSES * shares == pytest.approx([0.5, 9000.5, CLASSES - 0.5], abs=0.01)
    expected = gamma.pdf(diameter) / (high - low)
    assert sizes.probability_per_mm(diameter) == pytest.approx(expected, rel=1e-9, abs=1e-300)


@given(laws)
@settings(max_examples=25, deadline=None)
def test_half_of_the_water_is_in_drops_smaller_than_the_median_volume_drop(sizes):
    diameters = np.linspace(0.1, 8.0, 400_001)
    water = np.cumsum(sizes.probability_per_mm(diameters) * diameters**3)
    assert np.interp(sizes.median_volume_diameter_mm, diameters, water / water[-1]) == pytest.approx(0.5, abs=1e-3)


def test_nearly_all_drops_of_the_paper_are_smaller_than_its_large_drop():
    assert DropSizes(7.132, 0.114).large_diameter_mm == pytest.approx(1.5, abs=0.02)  # "generally below 1.5 mm"


@given(laws, st.integers(1, 6))
@settings(max_examples=50, deadline=None)
def test_moments_are_those_of_the_truncated_gamma(sizes, power):
    """E[D^n] = theta^n Gamma(mu + n) / Gamma(mu) times the share that the law of shape mu + n has in 0.1..8 mm."""
    bounds = np.array([0.1, 8.0]) / sizes.scale_mm
    share = np.diff(special.gammainc(sizes.shape + power, bounds)) / np.diff(special.gammainc(sizes.shape, bounds))
    expected = sizes.scale_mm**power * special.poch(sizes.shape, power) * share[0]
    assert sizes.expectation(lambda d: d**power) == pytest.approx(expected, rel=1e-7)
    # Of mist e^-1000 is within 0.1..8 mm: a number that only exists as a logarithm.
    assert DropSizes(2.0, 1e-4).expectation(lambda d: d) == pytest.approx(0.1, abs=1e-3)


def test_published_velocity_stays_at_its_vertex():
    velocity = VelocityFit(coefficients=(-0.342, 3.379, 0.340))
    at_vertex = 0.340 + 3.379**2 / (4 * 0.342)
    assert velocity(np.array([4.94, 6.0, 8.0])) == pytest.approx(at_vertex, abs=1e-4)
    assert velocity(np.array([1.0]))[0] == pytest.approx(-0.342 + 3.379 + 0.340)


def test_atlas_velocity_agrees_with_gunn_and_kinzer():
    # Gunn and Kinzer (1949): 1 mm 4.03 m/s, 2 mm 6.49 m/s, 4 mm 8.83 m/s.
    assert atlas_velocity(np.array([1.0, 2.0, 4.0])) == pytest.approx([4.03, 6.49, 8.83], rel=0.03)
    assert atlas_velocity(np.array([0.0, 0.1])).tolist() == [0, 0]  # mist that the formula would lift


def test_a_calibration_comes_back_from_its_file_without_empty_fields(tmp_path):
    for name in calibration_names():
        save_calibration(load_calibration(name), tmp_path / "mine.yaml")
        assert load_calibration(str(tmp_path / "mine.yaml")) == load_calibration(name)
        text = (tmp_path / "mine.yaml").read_text()
        assert "null" not in text and text.index("source:") < text.index("rows:")


def test_curves_run_through_the_rows_and_spectra_add_up():
    published = load_calibration("published")
    curves = calibration_curves(published)
    for row, implied in zip(published.rows, (0.80, 6.59, 11.03), strict=True):
        at = np.log(row.intensity_mm_h), np.log(curves.intensities_mm_h)
        np.testing.assert_allclose(np.exp(np.interp(*at, np.log(curves.density_m3))), row.density_m3, rtol=0.01)
        np.testing.assert_allclose(np.interp(*at, curves.implied_share), implied / row.intensity_mm_h, rtol=0.02)
        spectrum = spectrum_at(published, row.intensity_mm_h)
        np.testing.assert_allclose(np.trapezoid(spectrum, curves.diameters_mm), row.density_m3, rtol=0.01)
    np.testing.assert_allclose(curves.fall_speed_m_s, published.velocity(curves.diameters_mm))
