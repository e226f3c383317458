"""The plane of the ground, and the camera mirrored in it."""

import numpy as np
import pytest

from gsrain_engine.appearance.wet_look.ground_plane import GroundPlane, fit_ground_plane
from gsrain_engine.scene.camera import Camera, look_at

TILTED = GroundPlane(np.array([0.06, -0.03, 1.0]) / np.linalg.norm([0.06, -0.03, 1.0]), -1.2)
EYE = Camera(
    320, 200, 250.0, 260.0, 150.0, 90.0, look_at(np.array([1.0, 2, 1.5]), np.array([9.0, 1, 0.5]), np.eye(3)[2])
)


def pixels(camera, points):
    local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    return local[:, :2] / local[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy], local[:, 2]


def test_mirrored_twice_is_itself():
    twice = TILTED.mirrored(TILTED.mirrored(EYE))
    np.testing.assert_allclose(twice.world_to_camera, EYE.world_to_camera, atol=1e-12)
    assert (twice.cx, twice.cy) == (EYE.cx, EYE.cy)
    np.testing.assert_allclose(TILTED.reflection @ TILTED.reflection, np.eye(4), atol=1e-12)


def test_mirrored_camera_is_a_proper_one_below_the_ground():
    mirrored = TILTED.mirrored(EYE)
    assert np.linalg.det(mirrored.world_to_camera[:3, :3]) == pytest.approx(1)
    below, above = TILTED.heights(np.stack([mirrored.position, EYE.position]))
    assert -below == pytest.approx(above)
    assert above > 1


def test_mirrored_camera_sees_in_turned_rows_what_the_mirror_shows():
    """The mirror image of a point, seen by the eye, is the point itself, seen by the mirrored camera."""
    points = np.random.default_rng(0).uniform([4, -2, 0], [20, 4, 5], (50, 3))
    images = points @ TILTED.reflection[:3, :3].T + TILTED.reflection[:3, 3]
    by_eye, depth = pixels(EYE, images)
    by_mirrored, same_depth = pixels(TILTED.mirrored(EYE), points)
    np.testing.assert_allclose(same_depth, depth)
    np.testing.assert_allclose(by_mirrored, by_eye * [1, -1] + [0, EYE.height])


def test_plane_is_found_under_walls_and_cars():
    rng = np.random.default_rng(1)
    ground = rng.uniform([-20, -10, 0], [20, 10, 0], (4000, 3))
    ground[:, 2] = 0.03 * ground[:, 0] - 1.5 + rng.normal(0, 0.02, 4000)
    things = rng.uniform([-20, -10, -1.5], [20, 10, 6], (5000, 3))
    things = things[things[:, 2] > 0.03 * things[:, 0] - 1.4]
    found = fit_ground_plane(np.concatenate([ground, things]), 0.05)
    assert found is not None
    np.testing.assert_allclose(found.normal, np.array([-0.03, 0, 1]) / np.hypot(1, 0.03), atol=2e-3)
    assert found.heights(np.array([[0.0, 0, -1.5]])) == pytest.approx(0, abs=0.01)


def test_a_wall_is_no_ground():
    wall = np.random.default_rng(2).uniform([5, -10, -2], [5, 10, 8], (500, 3))
    assert fit_ground_plane(wall, 0.05) is None
    assert fit_ground_plane(wall[:2], 0.05) is None
