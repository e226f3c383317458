"""Ring waves: dispersion, damping, spectrum and energy of slopes, single rings, and what is left as roughness."""

import numpy as np
import pytest

from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.ground_water import GroundWater
from gsrain_engine.water.films import DIP_MM, WaterDepth
from gsrain_engine.water.impacts import GroundImpacts
from gsrain_engine.water.rings import (
    AGES_S,
    ENERGY_SHARE,
    RADII_M,
    STANDING_RINGS,
    WAVENUMBERS_PER_M,
    RingWaves,
    angular_frequency,
    damping_per_s,
    ring_slope,
    ring_table,
    slope_spectrum,
    slope_variance,
)

DEEP_MM = 100.0


def waves(rain=8.5, seed=0, standing=255, eye=(0.0, 0.0, 1.5), time_s=3.0, focal_px=1000.0):
    cover = np.zeros((60, 60, 2), np.uint8)
    cover[..., 1] = standing
    impacts = GroundImpacts(RainSimulation.start(RainSettings(intensity_mm_h=rain, seed=seed)))
    ground = GroundWater((-15.0, -15.0), 0.5, cover)
    ahead = np.array([1.0, 0.0])
    return RingWaves(impacts, time_s, WaterDepth(0.5, DIP_MM), ground, np.array(eye), ahead, 0.0, focal_px)


def slopes_on(field, points, footprint=(0.0, 0.0)):
    along, across = (np.float32(each) for each in footprint)
    arrays = field[:6]
    one, zero = np.float32(1), np.float32(0)
    return np.array([ring_slope(x, y, one, zero, along, across, *arrays) for x, y in points])


def test_waves_run_and_decay_as_theory_says():
    k = np.array([1.0, 20.0, 366.0, 1000.0])
    deep = angular_frequency(k, 10.0)
    np.testing.assert_allclose(deep**2, 9.81 * k + 7.29e-5 * k**3, rtol=1e-3)
    assert (deep / k).min() == pytest.approx(0.231, rel=0.01)  # slowest waves on water, 17 mm long
    shallow = angular_frequency(np.array([10.0]), 1e-3) / 10
    assert shallow[0] == pytest.approx(np.sqrt(9.81e-3), rel=0.01)
    np.testing.assert_allclose(damping_per_s(k[2:], 10.0), 2e-6 * k[2:] ** 2)
    assert damping_per_s(k[2:3], 0.5e-3)[0] > 10 * damping_per_s(k[2:3], 10.0)[0]


def test_the_slope_spectrum_peaks_at_0_2_per_mm_and_falls_on_both_sides():
    spectrum = slope_spectrum(1.0, 1.0)
    peak = WAVENUMBERS_PER_M[np.argmax(spectrum)]
    assert peak == pytest.approx(200.0, rel=0.05)
    half = np.interp([100.0, 400.0], WAVENUMBERS_PER_M, spectrum) / spectrum.max()
    np.testing.assert_allclose(half, np.exp(-0.5 * (np.log(2) / 0.42) ** 2), rtol=0.02)


def test_heights_over_frequency_are_those_of_rain_in_tanks_and_at_sea():
    f = angular_frequency(WAVENUMBERS_PER_M, 1.0) / (2 * np.pi)
    heights = slope_spectrum(1.0, 1.0) / WAVENUMBERS_PER_M**2 / np.gradient(f, WAVENUMBERS_PER_M)
    # Bliven et al. 1997: a log-normal over f with its peak at 5.8 Hz and 0.31.
    assert f[np.argmax(heights)] == pytest.approx(5.8, rel=0.15)
    shares = heights * np.gradient(f)
    shares /= shares.sum()
    spread = np.sqrt(shares @ np.log(f) ** 2 - (shares @ np.log(f)) ** 2)
    assert spread == pytest.approx(0.31, rel=0.1)
    # Braun et al. 2002: heavy rain adds to the spectrum above about 5 Hz, and takes from it below.
    assert shares[f > 5].sum() > 0.85
    # A radar of 3 GHz: the rings of 4 mm/h that it sees, 5 cm long or longer, live longer than 0.3 s (1998).
    seen = np.array([2 * np.pi / 0.05])
    assert (1 / damping_per_s(seen, 1.0))[0] > 0.3
    # A second of decay takes nothing from the peak in deep water, and all of it in a film.
    decayed = np.exp(-damping_per_s(np.array([200.0]), 1.0)), np.exp(-damping_per_s(np.array([200.0]), 5e-4))
    assert decayed[0][0] > 0.9 > 0.1 > decayed[1][0]


def test_energy_of_slopes_is_that_of_the_drops():
    """Twice the power, twice the variance; a ring carries its share of a drop's energy; it falls by viscosity."""
    fluxes = [GroundImpacts(RainSimulation.start(RainSettings(intensity_mm_h=r))).flux_at(0.0) for r in (2.5, 25.0)]
    power = [float(each.power_w_m2[-1]) for each in fluxes]
    variance = [slope_variance(each, 1.0) for each in power]
    assert variance[1] / variance[0] == pytest.approx(power[1] / power[0], rel=1e-6)
    table, k = ring_table(DEEP_MM).astype(float), WAVENUMBERS_PER_M
    step = RADII_M[1] - RADII_M[0]
    # Hankel transform of the slope: - a k^2 cos(w t) exp(-d t) / k dk
    from scipy.special import j1

    joules = []
    for age in range(20, 60, 2):  # before its front leaves the table; the mean of cos^2 is a half
        transform = (table[age] * RADII_M) @ j1(RADII_M[:, None] * k) * step
        potential = 0.5 * np.trapezoid((998 * 9.81 / k**2 + 0.0728) * transform**2 * k, k) * 2 * np.pi
        joules.append(2 * potential)
    assert np.mean(joules) == pytest.approx(ENERGY_SHARE, rel=0.1)
    squares = table**2 @ RADII_M
    assert squares[100:130].mean() < 0.9 * squares[20:50].mean()


@pytest.mark.parametrize("rain", [4.0, 16.0])
def test_rings_one_by_one_have_the_variance_that_roughness_gives_up(rain):
    """At the nadir of a camera, where pixels are small: followed and left variance are that of all rings."""
    x, y = np.meshgrid(np.linspace(1.0, 2.4, 30), np.linspace(-0.7, 0.7, 30))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    measured = np.mean([np.mean(slopes_on(waves(rain, seed).on_standing, points)[:, 0] ** 2) for seed in range(12)])
    of = waves(rain, focal_px=1e6)
    whole = slope_variance(float(of.impacts.flux_at(0.0).power_w_m2[-1]), 1e-3 * DIP_MM) / 2
    left = of.slopes_along(np.array([0.0, 1e3])) ** 2 - 1e-4
    assert left[1] == pytest.approx(whole, rel=1e-6)
    assert measured == pytest.approx(left[1] - left[0], rel=0.2)
    assert 0.03 * whole < measured < whole


def test_rings_turn_into_roughness_without_a_step():
    of = waves()
    distances = np.linspace(0.5, 30.0, 400)
    slopes = of.slopes_along(distances)
    assert np.abs(np.diff(slopes)).max() < 0.02 * slopes.max()
    assert slopes[0] < 0.99 * slopes[-1]
    assert slopes_on(of.on_standing, [(1.5, 0.1)], (0.0, 0.0)).any()
    assert np.abs(slopes_on(of.on_standing, [(1.5, 0.1)], (0.1, 0.1))).max() == 0  # far below a pixel


def test_a_ring_spreads_at_its_group_velocity():
    table = np.abs(ring_table(DEEP_MM).astype(float))
    front = [RADII_M[np.argmax(table[age] * np.sqrt(RADII_M))] for age in (50, 100, 150)]
    k = np.array([190.0, 210.0])
    speed = float(np.diff(angular_frequency(k, 1.0))[0] / 20)
    assert np.diff(front) / (50 * (AGES_S[1] - AGES_S[0])) == pytest.approx(speed, rel=0.35)


def test_rings_are_functions_of_seed_and_time_and_change_smoothly():
    points = np.random.default_rng(2).uniform((1, -1), (3, 1), (60, 2))
    now, same = slopes_on(waves().on_standing, points), slopes_on(waves().on_standing, points)
    np.testing.assert_array_equal(now, same)
    other_eye = slopes_on(waves(eye=(0.3, -0.2, 1.5)).on_standing, points)
    np.testing.assert_allclose(other_eye, now, atol=1e-5)  # from another camera the same water
    soon = slopes_on(waves(time_s=3.0 + 1e-3).on_standing, points)
    assert np.sqrt(np.mean((soon - now) ** 2)) < 0.2 * np.sqrt(np.mean(now**2)) > 0
    assert not slopes_on(waves(standing=0).on_standing, points).any()  # no puddle, no rings that last
    short = np.mean(slopes_on(waves().on_films, points) ** 2)
    assert 0 < short < np.mean(now**2)
    assert STANDING_RINGS.of_size(np.array([0.0, 1e4])).tolist() == [1, 0]
