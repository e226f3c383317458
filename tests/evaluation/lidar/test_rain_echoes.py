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
from gsrain_engine.rain.properties import CLASSES
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
def test_expected_number_is_the_integral_of_the_spectrum(intensity):
    state = RainSimulation.start(RainSettings(intensity_mm_h=intensity)).state
    found = DropReturnModel(SENSOR, state).expected_up_to(np.array([2.0, 4.0, 50.0]))
    integrals = [integrated(SENSOR, state, 0.0, end) for end in (2.0, 4.0, 12.0)]
    assert integrals[0] > 1e-5
    np.testing.assert_allclose(found, integrals, rtol=0.03)  # 16,384 classes are coarse for the few largest drops


@pytest.mark.parametrize("intensity", [1.2, 12.0, 50.0])
def test_no_drop_is_detected_beyond_the_reach(intensity):
    model = DropReturnModel(SENSOR, RainSimulation.start(RainSettings(intensity_mm_h=intensity)).state)
    ranges = np.arange(0.0, 60.0, 1e-3)
    farthest_m = ranges[model.first_detected(ranges) < CLASSES].max()
    assert 1 < farthest_m <= model.reach_m < farthest_m + 0.02


def test_far_drops_follow_the_integral():
    beams = sky_beams(40_000)
    nowhere, listened = (np.zeros(len(beams)), np.zeros(len(beams))), np.full(len(beams), 50.0)
    found = sample_far_returns(beams, listened, nowhere, SIGNALS, seed=1)
    for end in (1.5, 2.0, 3.0, 50.0):
        mean = len(beams) * float(SIGNALS.expected_up_to(np.array([end]))[0])
        assert abs(np.sum(found.ranges_m < end) - mean) < 4 * np.sqrt(mean)
    assert np.all(SENSOR.signal(found.ranges_m, found.reflectances, RAINFALL.state.extinction_per_m) >= 1 - 1e-6)
    beyond = np.array([SIGNALS.reach_m + 0.02, SIGNALS.reach_m - 0.02])
    assert (SIGNALS.first_detected(beyond) == 16384).tolist() == [True, False]

    simulated = np.full(len(beams), 1.5), np.full(len(beams), 2.5)
    found = sample_far_returns(beams, listened, simulated, SIGNALS, seed=1)
    assert not np.any((found.ranges_m > 1.505) & (found.ranges_m < 2.495))
    whole, start, end = SIGNALS.expected_up_to(np.array([50.0, 1.5, 2.5]))
    mean = len(beams) * (whole - end + start)
    assert abs(len(found.beams) - mean) < 4 * np.sqrt(mean)


def test_drops_of_the_field_follow_the_integral():
    """Beams far enough apart that no drop is in two of them, over three seeds."""
    z = np.linspace(-0.9, 0.9, 400)
    turn = np.arange(400) * np.pi * (3 - np.sqrt(5))
    directions = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
    beams = wall_beams(np.full(400, np.inf), directions=directions)
    around = RegionBox(minimum_m=(-3.0, -3.0, -3.0), maximum_m=(3.0, 3.0, 3.0))
    ranges = []
    for seed in range(3):
        rainfall = RainSimulation.start(RainSettings(intensity_mm_h=80.0, seed=seed, streak_region=around))
        signals = DropReturnModel(SENSOR, rainfall.state)
        ranges += drop_field_returns(rainfall.frame(3.0, HERE), beams, np.full(400, 3.0), signals).ranges_m.tolist()
    assert max(ranges) < 3.0
    for end in (2.0, 3.0):
        mean = 3 * 400 * float(signals.expected_up_to(np.array([end]))[0])
        assert abs(np.sum(np.array(ranges) < end) - mean) < 4 * np.sqrt(mean) < mean / 2


def test_span_of_beams_in_a_turned_box():
    turned = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    directions = np.array([[0.0, 1, 0], [1.0, 0, 0], [0.0, 0, -1], [0.0, -1, 0]])
    for y, spans in ((0.0, ([0, 0, 0, 0], [5.0, 3.0, 1.5, 1.0])), (10.0, ([9.0, 0, 0, 0], [15.0, 0, 0, 0]))):
        turned[1, 3] = y
        beams = wall_beams(np.full(4, np.inf), directions=directions)
        np.testing.assert_allclose(box_span(beams, STREAK_REGION, turned), spans)


# Water

N = REFRACTIVE_INDEX[905]
FRONT = {each: ((n - 1) / (n + 1)) ** 2 for each, n in REFRACTIVE_INDEX.items()}


def test_drop_reflectance_equals_that_of_traced_rays():
    """A ray of impact parameter b (radius 1) leaves at theta from straight back: dsigma/dOmega = b db / (sin theta
    dtheta), once from the front and once after a reflection inside; a matt disc of reflectance rho has rho."""
    b = np.linspace(1e-4, 2e-4, 3)
    outside, inside = np.arcsin(b), np.arcsin(b / N)
    mirrored = fresnel_reflectance(np.cos(outside), N)
    total = 0.0
    for turned, share in ((2 * outside, mirrored), (4 * inside - 2 * outside, (1 - mirrored) ** 2 * mirrored)):
        total += share[1] * abs(b[1] * (b[2] - b[0]) / (np.sin(turned[1]) * (turned[2] - turned[0])))
    assert drop_reflectance(np.array([1e-6]), 905)[0] == pytest.approx(total, rel=1e-3)


def test_fresnel_reflectance_of_known_angles():
    brewster = np.arctan(N)
    across = np.sin(brewster - np.arcsin(np.sin(brewster) / N)) ** 2
    found = fresnel_reflectance(np.array([1.0, np.cos(brewster), 1e-6]), N)
    assert found == pytest.approx([FRONT[905], across / 2, 1], abs=1e-4)


def test_wet_road_loses_grazing_echoes_first():
    cosines, matt = np.array([1.0, 0.3, 0.1, 0.03]), np.full(4, 0.2)
    np.testing.assert_array_equal(wet_road_share(cosines, matt, 0.0, 0.0, 905), 1)
    soaked = wet_road_share(cosines, matt, 1.0, 0.0, 905)
    assert np.all(np.diff(soaked) < 0)
    assert soaked[0] == pytest.approx((1 - FRONT[905]) ** 2 / (N**2 * (1 - 0.472 * 0.2)), rel=1e-6)
    np.testing.assert_allclose(wet_road_share(cosines, matt, 0.4, 0.0, 905), 0.6 + 0.4 * soaked)
    assert np.all(wet_road_share(cosines, matt, 1.0, 0.5, 1550) < 0.5 * soaked)
