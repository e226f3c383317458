"""The ground: its plane, heights and mirrored camera; puddles and small slopes that belong to places of the world."""

import numpy as np
import pytest

from gsrain_engine.appearance.wet_look.ground_plane import GroundPlane, fit_ground_plane, ground_heights
from gsrain_engine.appearance.wet_look.noise import tilt_normals, water_slopes
from gsrain_engine.appearance.wet_look.water import standing_water
from gsrain_engine.scene.camera import Camera, look_at

LEVEL = GroundPlane(np.array([0.0, 0, 1]), 0.0)

# Plane

TILTED = GroundPlane(np.array([0.06, -0.03, 1.0]) / np.linalg.norm([0.06, -0.03, 1.0]), -1.2)
POSE = look_at(np.array([1.0, 2, 1.5]), np.array([9.0, 1, 0.5]), np.eye(3)[2])
EYE = Camera(320, 200, 250.0, 260.0, 150.0, 90.0, POSE)


def pixels(camera, points):
    local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    return local[:, :2] / local[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy], local[:, 2]


def test_a_mirrored_camera_is_a_proper_one_below_the_ground_that_sees_the_mirror_image():
    """The mirror image of a point, seen by the eye, is the point itself, seen by the mirrored camera."""
    mirrored = TILTED.mirrored(EYE)
    np.testing.assert_allclose(TILTED.mirrored(mirrored).world_to_camera, EYE.world_to_camera, atol=1e-12)
    np.testing.assert_allclose(TILTED.reflection @ TILTED.reflection, np.eye(4), atol=1e-12)
    assert np.linalg.det(mirrored.world_to_camera[:3, :3]) == pytest.approx(1)
    below, above = TILTED.heights(np.stack([mirrored.position, EYE.position]))
    assert -below == pytest.approx(above) and above > 1
    points = np.random.default_rng(0).uniform([4, -2, 0], [20, 4, 5], (50, 3))
    images = points @ TILTED.reflection[:3, :3].T + TILTED.reflection[:3, 3]
    (by_eye, depth), (by_mirrored, same_depth) = pixels(EYE, images), pixels(mirrored, points)
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


# Heights


def road(height):
    rng = np.random.default_rng(0)
    xy = rng.uniform([-20, -6], [20, 6], (12000, 2))
    return np.column_stack([xy, height(xy) + rng.normal(0, 0.01, 12000)])


HILL, CROWN, FLAT = (
    lambda xy: 0.05 * xy[:, 0] + 0.4,
    lambda xy: -0.025 * np.abs(xy[:, 1]),
    lambda xy: 0 * xy[:, 0],
)


@pytest.mark.parametrize(
    ("height", "slopes"), [(HILL, [(0.05, 0), (0.05, 0)]), (CROWN, [(0, -0.025), (0, 0.025)]), (FLAT, [(0, 0)] * 2)]
)
def test_hills_and_crowns_are_followed_and_cars_and_walls_do_not_lift_the_ground(height, slopes):
    rng = np.random.default_rng(3)
    car = rng.uniform([-3, -1, 0.5], [1.5, 1, 1.8], (6000, 3))
    wall = rng.uniform([-20, 5.5, 0], [20, 6, 8], (20000, 3))
    found = ground_heights(np.concatenate([road(height), car, wall][: 3 if height is FLAT else 1]), LEVEL)
    places = np.array([[x, y, 0.0] for x in (-12, 0, 9) for y in (-4, -1.5, 1.5, 3)])
    np.testing.assert_allclose(found.sampled(found.fine_m, places), height(places[:, :2]), atol=0.02)
    normals = found.normals(np.array([[0, 3.0, 0], [0, -3.0, 0]]))
    np.testing.assert_allclose(-normals[:, :2] / normals[:, 2:], slopes, atol=5e-3)


# Puddles and slopes, which belong to places of the world


def field(x0=0.0, y0=0.0, n=200, step=0.1):
    x, y = np.meshgrid(x0 + step * np.arange(n), y0 + step * np.arange(n))
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def water(points, wetness=1.0, sunk=0.0, seed=0):
    size = points.shape[:2]
    return standing_water(points, np.full(size, 0.01, np.float32), np.full(size, sunk, np.float32), wetness, seed)


def test_a_puddle_belongs_to_its_place_and_its_seed_and_has_a_rim():
    one, other = water(field()), water(field(x0=5.0, y0=3.0))
    np.testing.assert_allclose(one.puddle[30:, 50:], other.puddle[:-30, :-50], atol=2e-3)
    assert one.puddle.std() > 0.1 and np.array_equal(one.puddle, water(field()).puddle)
    assert np.abs(one.puddle - water(field(), seed=1).puddle).mean() > 0.02
    assert (one.rim[one.puddle > 0.5] > 0.7).all() and one.rim.mean() > one.puddle.mean()


def test_puddles_grow_with_wetness_and_fill_low_places_first():
    wide = field(n=500, step=0.5)
    cover = [float(water(wide, w).puddle.mean()) for w in (0.25, 0.5, 1.0)]
    assert cover == sorted(cover) and cover[0] < 0.6 * cover[-1]
    assert cover[-1] == pytest.approx(0.12, abs=0.03)
    low, level, high = (float(water(wide, sunk=s).puddle.mean()) for s in (0.004, 0.0, -0.004))
    assert high < 0.6 * level < 0.4 * low


def test_slopes_belong_to_places_tilt_normals_and_vanish_within_a_pixel():
    near = np.full((200, 200), 0.001, np.float32)
    one, other = water_slopes(field(step=0.05), near, 0), water_slopes(field(x0=2.0, step=0.05), near, 0)
    np.testing.assert_allclose(one[:, 40:], other[:, :-40], atol=0.05)
    assert one.std() == pytest.approx(1, rel=0.12)
    assert abs(np.corrcoef(one[..., 0].ravel(), one[..., 1].ravel())[0, 1]) < 0.1
    assert np.abs(water_slopes(field(), np.full_like(near, 20.0), 0)).max() < 0.01
    tilted = tilt_normals(np.array([[[0.0, 0, 1]]], np.float32), np.array([[[2.0, 0]]], np.float32), 0.05)
    np.testing.assert_allclose(tilted[0, 0], np.array([0.1, 0, 1]) / np.hypot(1, 0.1), atol=1e-6)
