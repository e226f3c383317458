"""Rain and water under a lidar: returns against the integral of the spectrum, optics against traced rays.

Poisson tests allow 4 standard errors: one in 16,000 fails.
"""

import numpy as np
import pytest

from evaluation.lidar.wall_beams import SENSOR, sky_beams, wall_beams
from gsrain_engine.evaluation.lidar.rain_echoes import (
    REFRACTIVE_INDEX,
    DropReturnModel,
    box_span,
    drop_field_returns,
    drop_reflectance,
    fresnel_reflectance,
    sample_far_returns,
    wet_road_share,
)
from gsrain_engine.rain.frame import RainCamera
from gsrain_engine.rain.settings import STREAK_REGION, RainSettings, RegionBox
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.camera import Camera

RAINFALL = RainSimulation.start(RainSettings(intensity_mm_h=12.0))
SIGNALS = DropReturnModel(SENSOR, RAINFALL.state)
ANCHOR = np.eye(4)
HERE = RainCamera(Camera.from_fov(1, 1, 45.0, np.eye(4)), ANCHOR, np.zeros(3))


def integrated(sensor, state, start_m, end_m):
    """N times the integral of beam area x density over range and diameter, where the lidar equation says detected."""
    ranges = np.linspace(start_m, end_m, 3001)
    diameters = np.linspace(0.1, 8.0, 4001)
    density = state.sizes.probability_per_mm(diameters)
    strength = 1e-6 * diameters**2 * drop_reflectance(diameters, sensor.wavelength_nm)
    per_m = np.zeros(len(ranges))
    for k, r in enumerate(ranges):
        if r <= sensor.blind_m:
            continue
        width = np.hypot(1e-3 * sensor.beam_mm, 1e-3 * sensor.divergence_mrad * r)
        overlap = min((r - sensor.blind_m) / (sensor.clear_m - sensor.blind_m), 1)
        least = max(0.1 * (r / sensor.range_m) ** 2, sensor.least_reflectance) / overlap
        heard = strength / width**2 * np.exp(-2 * state.extinction_per_m * r) >= least
        per_m[k] = np.pi / 4 * width**2 * np.trapezoid(density * heard, diameters)
    return state.density_m3 * np.trapezoid(per_m, ranges)


@pytest.mark.parametrize("intensity", [1.2, 12.0, 50.0])
def test_the_expected_number_is_the_integral_of_the_spectrum(intensity):
    state = RainSimulation.start(RainSettings(intensity_mm_h=intensity)).state
    found = DropReturnModel(SENSOR, state).expected_up_to(np.array([2.0, 4.0, 50.0]))
    integrals = [integrated(SENSOR, state, 0.0, end) for end in (2.0, 4.0, 12.0)]
    assert integrals[0] > 1e-5
    np.testing.assert_allclose(found, integrals, rtol=0.03)  # 16,384 classes are coarse for the few largest drops


def test_far_drops_are_as_many_as_the_integral_and_where_it_says():
    beams = sky_beams(40_000)
    nowhere, listened = (np.zeros(len(beams)), np.zeros(len(beams))), np.full(len(beams), 50.0)
    found = sample_far_returns(beams, listened, nowhere, SIGNALS, seed=1)
    for end in (1.5, 2.0, 3.0, 50.0):
        mean = len(beams) * float(SIGNALS.expected_up_to(np.array([end]))[0])
        assert abs(np.sum(found.ranges_m < end) - mean) < 4 * np.sqrt(mean)
    assert np.all(SENSOR.signal(found.ranges_m, found.reflectances, RAINFALL.state.extinction_per_m) >= 1 - 1e-6)
    beyond = np.array([SIGNALS.reach_m + 0.02, SIGNALS.reach_m - 0.02])
    assert (SIGNALS.first_detected(beyond) == 16384).tolist() == [True, False]

    span = np.full(len(beams), 1.5), np.full(len(beams), 2.5)  # the simulated field is there
    found = sample_far_returns(beams, listened, span, SIGNALS, seed=1)
    assert not np.any((found.ranges_m > 1.505) & (found.ranges_m < 2.495))
    whole, start, end = SIGNALS.expected_up_to(np.array([50.0, 1.5, 2.5]))
    mean = len(beams) * (whole - end + start)
    assert abs(len(found.beams) - mean) < 4 * np.sqrt(mean)


def test_the_field_has_as_many_drops_in_beams_as_the_integral():
    """Beams from the region's middle far enough apart that no drop is in two of them, over three seeds."""
    z = np.linspace(-0.9, 0.9, 400)
    turn = np.arange(400) * np.pi * (3 - np.sqrt(5))
    directions = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
    beams = wall_beams(np.full(400, np.inf), directions=directions)
    around = RegionBox(minimum_m=(-3.0, -3.0, -3.0), maximum_m=(3.0, 3.0, 3.0))
    listened = np.full(400, 3.0)
    counts, near = 0, 0
    for seed in range(3):
        rainfall = RainSimulation.start(RainSettings(intensity_mm_h=80.0, seed=seed, streak_region=around))
        found = drop_field_returns(
            rainfall.frame(3.0, HERE), beams, listened, signals := DropReturnModel(SENSOR, rainfall.state)
        )
        assert np.all(found.ranges_m < 3.0)
        counts, near = counts + len(found.beams), near + int(np.sum(found.ranges_m < 2.0))
    for count, end in ((counts, 3.0), (near, 2.0)):
        mean = 3 * 400 * float(signals.expected_up_to(np.array([end]))[0])
        assert mean > 60
        assert abs(count - mean) < 4 * np.sqrt(mean)


def test_a_drop_of_the_field_is_found_in_the_beam_that_is_aimed_at_it():
    field = RAINFALL.frame(0.0, HERE)
    drops = field.visible_drops(in_view=False)
    places = drops.positions_m
    assert len(places) > 10_000
    assert np.all(np.abs(places - np.clip(places, STREAK_REGION.minimum_m, STREAK_REGION.maximum_m)) < 1e-6)
    ranges = np.linalg.norm(places, axis=1)
    aimed = np.flatnonzero(drops.class_index >= SIGNALS.first_detected(ranges))[:5]
    assert len(aimed) == 5
    beams = wall_beams(np.full(5, np.inf), directions=places[aimed] / ranges[aimed, None])
    found = drop_field_returns(field, beams, np.full(5, 50.0), SIGNALS)
    for k in range(5):
        assert np.min(np.abs(found.ranges_m[found.beams == k] - ranges[aimed[k]])) < 1e-9


def test_the_span_of_a_beam_in_a_turned_box():
    turned = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    directions = np.array([[0.0, 1, 0], [1.0, 0, 0], [0.0, 0, -1], [0.0, -1, 0]])
    start, end = box_span(wall_beams(np.full(4, np.inf), directions=directions), STREAK_REGION, turned)
    np.testing.assert_allclose(end, [5.0, 3.0, 1.5, 1.0])
    np.testing.assert_array_equal(start, 0)
    outside = turned.copy()
    outside[:3, 3] = (0, 10.0, 0)
    start, end = box_span(wall_beams(np.full(4, np.inf), directions=directions), STREAK_REGION, outside)
    np.testing.assert_allclose(start, [9.0, 0, 0, 0])
    np.testing.assert_allclose(end, [15.0, 0, 0, 0])


# Water

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


@pytest.mark.parametrize("wavelength", [905, 1550])
def test_larger_drops_send_back_more_and_at_1550_nm_only_from_the_front(wavelength):
    diameters = np.linspace(0.1, 8, 4000)
    assert np.all(np.diff(diameters**2 * drop_reflectance(diameters, wavelength)) > 0)
    small, large = drop_reflectance(np.array([0.2, 5.0]), wavelength)
    n = REFRACTIVE_INDEX[wavelength]
    front = ((n - 1) / (n + 1)) ** 2 / 4
    assert small > 3 * front
    assert large == pytest.approx(front, rel=1e-3) if wavelength == 1550 else large > 4 * front


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
