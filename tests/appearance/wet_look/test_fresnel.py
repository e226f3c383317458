"""Fresnel's law and Smith's shadowing against values known from elsewhere."""

import numpy as np
import pytest

from gsrain_engine.appearance.wet_look.materials import WATER_INDEX, reflectance, unshadowed


@pytest.mark.parametrize(("degrees", "share"), [(0, 0.0204), (30, 0.0212), (60, 0.0597), (80, 0.3479), (90, 1.0)])
def test_water_mirrors_what_optics_tables_say(degrees, share):
    assert reflectance(np.cos(np.radians(degrees)), WATER_INDEX) == pytest.approx(share, abs=4e-4)


def test_light_of_one_polarization_is_not_mirrored_at_brewsters_angle():
    # There the mean is half the share of the other polarization: sin^2(a - b) / sin^2(a + b), with a + b = 90 degrees.
    angle = np.arctan(WATER_INDEX)
    assert reflectance(np.cos(angle), WATER_INDEX) == pytest.approx(0.5 * np.cos(2 * angle) ** 2, rel=1e-9)


def test_more_is_mirrored_the_flatter_the_ray():
    shares = [reflectance(c, WATER_INDEX) for c in np.linspace(1, 0, 50)]
    assert (np.diff(shares) > 0).all()


def test_smith_shadowing_hides_all_at_grazing_and_nothing_from_above():
    assert unshadowed(1.0, 0.2) == 1
    assert unshadowed(0.5, 0.0) == 1
    shares = [unshadowed(np.sin(a), 0.2) for a in np.radians([1, 3, 6, 12, 25, 60])]
    assert (np.diff(shares) >= 0).all()
    assert shares[0] < 0.25
    assert shares[-1] == pytest.approx(1, abs=1e-3)


def test_smith_shadowing_is_that_of_a_random_profile():
    """A ray at an elevation meets a Gaussian facet unhindered as often as Smith's integral over its slopes says.

    G1 is defined by this: the area of facets that a direction sees, weighted by how it sees them, is the area of the
    mean surface, so that the sum over slopes of pdf * (cos facet)+ * G1 is cos of the direction.
    """
    slope, elevation = 0.3, np.radians(10)
    tilts = np.linspace(-3, 3, 20001)
    weights = np.exp(-0.5 * (tilts / slope) ** 2) / (slope * np.sqrt(2 * np.pi)) * (tilts[1] - tilts[0])
    seen = np.sum(weights * np.maximum(np.sin(elevation) + tilts * np.cos(elevation), 0))
    assert seen * unshadowed(np.sin(elevation), slope) == pytest.approx(np.sin(elevation), rel=1e-4)
