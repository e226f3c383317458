"""Boxes in pictures."""

import numpy as np

from gsrain_engine.render.object_labels import area_px, bounding_rectangle, convex_outline, cut_at_edges
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.geometry import box_corners

CAMERA = Camera(200, 100, 100.0, 100.0, 100.0, 50.0)
AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""From x forward, y left, z up to the camera's axes."""


def at(x, y, z):
    pose = AHEAD.copy()
    pose[:3, 3] = AHEAD[:3, :3] @ [x, y, z]
    return pose


def test_a_box_ahead_is_where_its_nearest_face_is():
    hull = convex_outline(box_corners(at(11, 0, -1), (2.0, 4.0, 2.0)), CAMERA)
    np.testing.assert_allclose(bounding_rectangle(hull), (80, 40, 120, 60), atol=1e-3)
    assert abs(area_px(hull) - 800) < 0.01


def test_what_lies_outside_the_picture_is_cut_off():
    hull = convex_outline(box_corners(at(11, 10, -1), (2.0, 4.0, 2.0)), CAMERA)
    np.testing.assert_allclose(bounding_rectangle(hull), (-20, 40, 100 - 800 / 12, 60), atol=1e-3)
    within = cut_at_edges(hull, CAMERA)
    np.testing.assert_allclose(bounding_rectangle(within), (0, 40, 100 - 800 / 12, 60), atol=1e-3)
    assert area_px(within) < area_px(hull)
    assert len(cut_at_edges(convex_outline(box_corners(at(11, 40, -1), (2.0, 4.0, 2.0)), CAMERA), CAMERA)) == 0


def test_a_box_beside_the_camera_is_cut_at_it_and_one_behind_is_not_there():
    hull = convex_outline(box_corners(at(0, 2, -1), (8.0, 2.0, 2.0)), CAMERA)
    left, _, right, _ = bounding_rectangle(cut_at_edges(hull, CAMERA))
    np.testing.assert_allclose((left, right), (0, 100 - 100 / 4), atol=1e-3)
    assert len(convex_outline(box_corners(at(-5, 0, -1), (2.0, 2.0, 2.0)), CAMERA)) == 0
