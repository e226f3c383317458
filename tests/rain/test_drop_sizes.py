import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from gsrain_engine.rain.calibration import VelocityFit, atlas_velocity
from gsrain_engine.rain.drop_sizes import CLASSES, LARGEST_MM, SMALLEST_MM, DropSizes

laws = st.builds(DropSizes, st.floats(1, 30), st.floats(0.02, 0.5))


@given(laws, st.floats(0, 1))
@settings(max_examples=50, deadline=None)
def test_quantiles_are_those_of_the_truncated_gamma(sizes, probability):
    diameter = float(sizes.quantile(np.array([probability]))[0])
    gamma = stats.gamma(sizes.shape, scale=sizes.scale_mm)
    low, high = gamma.cdf([SMALLEST_MM, LARGEST_MM])
    assert SMALLEST_MM <= diameter <= LARGEST_MM
    assert (gamma.cdf(diameter) - low) / (high - low) == pytest.approx(probability, abs=1e-6)


@given(laws)
@settings(max_examples=25, deadline=None)
def test_classes_have_the_moments_of_the_law(sizes):
    diameters = sizes.class_diameters_mm
    assert len(diameters) == CLASSES
    assert np.all(np.diff(diameters) >= 0)
    assert diameters.mean() == pytest.approx(sizes.mean_mm, rel=1e-4)
    assert np.mean(diameters**3) == pytest.approx(sizes.expectation(lambda d: d**3), rel=5e-3)


def test_published_velocity_stays_at_its_vertex():
    velocity = VelocityFit(coefficients=(-0.342, 3.379, 0.340))
    at_vertex = 0.340 + 3.379**2 / (4 * 0.342)
    assert velocity(np.array([4.94, 6.0, 8.0])) == pytest.approx(at_vertex, abs=1e-4)
    assert velocity(np.array([1.0]))[0] == pytest.approx(-0.342 + 3.379 + 0.340)


def test_atlas_velocity_agrees_with_gunn_and_kinzer():
    # Gunn and Kinzer (1949): 1 mm 4.03 m/s, 2 mm 6.49 m/s, 4 mm 8.83 m/s.
    assert atlas_velocity(np.array([1.0, 2.0, 4.0])) == pytest.approx([4.03, 6.49, 8.83], rel=0.03)
