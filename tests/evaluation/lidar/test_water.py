import numpy as np
import pytest

from gsrain_engine.evaluation.lidar.rain_echoes import (
    REFRACTIVE_INDEX,
    drop_reflectance,
    fresnel_reflectance,
    wet_road_share,
)

N = REFRACTIVE_INDEX[905]


def traced_reflectance(n):
    """Light that a sphere sends back near its axis, per solid angle, by tracing rays: front, and once inside.

    A ray of the impact parameter b (radius 1) leaves at the angle theta from straight back: dsigma/dOmega =
    b db / (sin theta dtheta). A matt disc of reflectance rho and radius 1 has rho.
    """
    b = np.linspace(1e-4, 2e-4, 3)
    outside, inside = np.arcsin(b), np.arcsin(b / n)
    mirrored = fresnel_reflectance(np.cos(outside), n)
    total = 0.0
    for turned, share in ((2 * outside, mirrored), (4 * inside - 2 * outside, (1 - mirrored) ** 2 * mirrored)):
        density = b[1] * (b[2] - b[0]) / (np.sin(turned[1]) * (turned[2] - turned[0]))
        total += share[1] * abs(density)
    return total


def test_a_drop_sends_back_what_traced_rays_say():
    assert drop_reflectance(np.array([1e-6]), 905)[0] == pytest.approx(traced_reflectance(N), rel=1e-3)


def test_at_1550_nm_large_drops_keep_the_front_alone():
    front = ((1.318 - 1) / (1.318 + 1)) ** 2 / 4
    assert drop_reflectance(np.array([5.0]), 1550)[0] == pytest.approx(front, rel=1e-3)
    assert drop_reflectance(np.array([0.2]), 1550)[0] > 3 * front
    assert drop_reflectance(np.array([5.0]), 905)[0] > 4 * front


@pytest.mark.parametrize("wavelength", [905, 1550])
def test_larger_drops_send_back_more(wavelength):
    diameters = np.linspace(0.1, 8, 4000)
    assert np.all(np.diff(diameters**2 * drop_reflectance(diameters, wavelength)) > 0)


def test_fresnel_mirrors_two_percent_straight_and_all_at_grazing():
    assert fresnel_reflectance(np.array([1.0]), N)[0] == pytest.approx(((N - 1) / (N + 1)) ** 2)
    assert fresnel_reflectance(np.array([1e-6]), N)[0] == pytest.approx(1, abs=1e-4)
    brewster = np.cos(np.arctan(N))
    across = np.sin(np.arctan(N) - np.arcsin(np.sin(np.arctan(N)) / N)) ** 2  # all that is left there, half of it
    assert fresnel_reflectance(np.array([brewster]), N)[0] == pytest.approx(across / 2)


def test_a_dry_road_keeps_its_echo_and_a_wet_one_loses_grazing_ones_first():
    cosines = np.array([1.0, 0.3, 0.1, 0.03])
    matt = np.full(4, 0.2)
    np.testing.assert_array_equal(wet_road_share(cosines, matt, 0.0, 0.0, 905), 1)
    soaked = wet_road_share(cosines, matt, 1.0, 0.0, 905)
    assert np.all(np.diff(soaked) < 0)
    straight = (1 - ((N - 1) / (N + 1)) ** 2) ** 2 / (N**2 * (1 - 0.472 * 0.2))
    assert soaked[0] == pytest.approx(straight, rel=1e-6)
    np.testing.assert_allclose(wet_road_share(cosines, matt, 0.4, 0.0, 905), 0.6 + 0.4 * soaked)
    assert np.all(wet_road_share(cosines, matt, 1.0, 0.5, 1550) < 0.5 * soaked)
