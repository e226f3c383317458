"""The height map of the ground: slopes, crowns, kerbs, and what stands on it."""

import numpy as np
import pytest

from gsrain_engine.appearance.wet_look.ground_plane import GroundPlane, ground_heights

LEVEL = GroundPlane(np.array([0.0, 0, 1]), 0.0)


def road(height, n=12000, noise=0.01, seed=0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform([-20, -6], [20, 6], (n, 2))
    return np.column_stack([xy, height(xy) + rng.normal(0, noise, n)])


def checked(heights, height):
    places = np.array([[x, y, 0.0] for x in (-12, 0, 9) for y in (-4, -1.5, 0, 3)])
    np.testing.assert_allclose(heights.sampled(heights.fine_m, places), height(places[:, :2]), atol=0.02)


def test_a_hill_is_followed_far_from_the_first_guess():
    def height(xy):
        return 0.05 * xy[:, 0] + 0.4

    found = ground_heights(road(height), LEVEL)
    checked(found, height)
    np.testing.assert_allclose(
        found.normals(np.zeros((1, 3)))[0], np.array([-0.05, 0, 1]) / np.hypot(1, 0.05), atol=5e-3
    )


def test_the_crown_of_a_road_is_seen():
    def height(xy):
        return -0.025 * np.abs(xy[:, 1])

    found = ground_heights(road(height), LEVEL)
    left, right = found.normals(np.array([[0, 3.0, 0], [0, -3.0, 0]]))
    assert left[1] == pytest.approx(0.025, abs=5e-3)
    assert right[1] == pytest.approx(-0.025, abs=5e-3)


def test_cars_and_walls_do_not_lift_the_ground():
    rng = np.random.default_rng(3)
    car = rng.uniform([-3, -1, 0.2], [1.5, 1, 1.5], (6000, 3))
    wall = rng.uniform([-20, 5.5, 0], [20, 6, 8], (20000, 3))
    checked(ground_heights(np.concatenate([road(lambda xy: 0 * xy[:, 0]), car, wall]), LEVEL), lambda xy: 0 * xy[:, 0])


def test_gutters_and_ruts_are_sunk_and_pavements_are_not():
    def height(xy):
        return np.where(np.abs(xy[:, 1]) > 3, 0.12, 0.0)

    found = ground_heights(road(height), LEVEL)
    gutter, lane, kerb = found.sampled(found.sunk_m, np.array([[0, 2.6, 0], [0, 0, 0], [0, 3.5, 0]]))
    assert gutter > lane + 0.001 > kerb + 0.002
    rutted = found.with_ruts(np.array([[-10.0, 0], [10, 0]]))
    wheel, middle, beyond = rutted.sampled(
        rutted.sunk_m - found.sunk_m, np.array([[0, 0.78, 0], [0, 0, 0], [18, 0.78, 0]])
    )
    assert wheel > 0.003
    assert middle < 0.002
    assert beyond == pytest.approx(0, abs=1e-4)
