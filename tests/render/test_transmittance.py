"""Contrast that walls keep in rain, measured in float images of black and white ones (docs/physics/extinction.md)."""

import numpy as np
import pytest

from benchmarks.transmittance import (
    DISTANCES_M,
    FAINT,
    INTENSITIES_MM_H,
    SIZE,
    WallPair,
    errors,
    lidar_beta,
    mean_error,
    ray_lengths_m,
    reported_beta,
)
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.cpu.renderer import CpuRenderer

ROUNDING = 1e-4  # of the full contrast, by conversion between linear light and display values


@pytest.fixture(scope="module")
def betas():
    return {rate: reported_beta(rate) for rate in INTENSITIES_MM_H}


@pytest.mark.parametrize(
    ("kind", "size", "relative"), [("cpu", SIZE, 0.01), ("opengl", (60, 40), 0.005), ("opengl-tiles", (60, 40), 0.005)]
)
def test_pixels_keep_exp_of_minus_beta_r_of_their_own_ray(betas, open_kind, kind, size, relative):
    """Far off the axis, Gaussians of a wall are nearer or farther than their pixels."""
    renderer = open_kind(kind)
    for distance_m in DISTANCES_M:
        walls, rays = WallPair(renderer, distance_m, size), ray_lengths_m(distance_m, size)
        for rate in INTENSITIES_MM_H:
            expected = np.exp(-betas[rate] * rays)
            found = walls.transmittance(RainSettings(intensity_mm_h=rate, streaks=False), 0.0)
            tolerance = np.where(expected > FAINT, relative, 0.002)
            assert (np.abs(errors(found, expected)) < tolerance).all(), (distance_m, rate)


@pytest.mark.parametrize(("rate", "distance_m"), [(8.5, 161.0), (50.0, 10.0)])
def test_streaks_and_medium_keep_it_together(betas, rate, distance_m):
    """Streaks alone take 0.2 and 1.2 %: some hundred times the tolerance."""
    walls = WallPair(CpuRenderer(), distance_m)
    drawn = np.array([walls.transmittance(RainSettings(intensity_mm_h=rate), 0.5 * k) for k in range(20)])
    error = mean_error(drawn, np.exp(-betas[rate] * ray_lengths_m(distance_m)))
    assert error.standard_error < 1.5e-4
    assert abs(error.mean) < 3 * error.standard_error + ROUNDING


@pytest.mark.parametrize("kind", ["opengl", "opengl-tiles"])
def test_back_ends_agree(open_kind, kind):
    """In streaks and medium, at each pixel."""
    rain, size = RainSettings(intensity_mm_h=100.0), (150, 100)
    ours, cpu = (WallPair(each, 50.0, size).transmittance(rain, 1.0) for each in (open_kind(kind), CpuRenderer()))
    assert np.ptp(cpu) > 0.02
    assert np.abs(ours - cpu).max() < 2e-3


def test_lidar_has_the_same_beta(betas):
    assert [lidar_beta(rate) for rate in betas] == pytest.approx(list(betas.values()), rel=1e-9)
