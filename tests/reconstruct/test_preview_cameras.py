from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.reconstruct.recoloring.ground_height import ground_height_m
from gsrain_engine.reconstruct.recoloring.preview_cameras import EYE_HEIGHT_M, PREVIEW_PIXELS, preview_cameras
from gsrain_engine.scene.scene import Scene

from .small_street import FORWARD, LEFT, small_street, still_track


def forward_of(camera) -> np.ndarray:
    return camera.camera_to_world[:3, 2]


def test_views_lie_evenly_on_the_way_driven_front_and_side_in_turn():
    views = preview_cameras(small_street(), 4)
    np.testing.assert_allclose([view.camera.position[0] for view in views], [0.75, 2.25, 3.75, 5.25])
    np.testing.assert_allclose([view.time_s for view in views], [0.125, 0.375, 0.625, 0.875])
    assert all(view.camera.position[2] == pytest.approx(1.5) for view in views)
    for view, mounted in zip(views, (FORWARD, LEFT, FORWARD, LEFT), strict=True):
        np.testing.assert_allclose(forward_of(view.camera), mounted[:3, 2], atol=1e-12)


def test_views_are_small_and_keep_the_field_of_view():
    for view in preview_cameras(small_street(), 2):
        assert view.camera.width * view.camera.height == pytest.approx(PREVIEW_PIXELS, rel=0.01)
        assert view.camera.vertical_fov_deg == pytest.approx(2 * np.degrees(np.arctan(32 / 60)))


def test_a_parked_ego_vehicle_looks_at_different_times():
    parked = replace(small_street(), ego=still_track((0, 0, 1.5), (0, 0, 1.5)))
    assert len({view.time_s for view in preview_cameras(parked, 8)}) == 8


def test_without_a_track_views_surround_the_middle():
    scene = replace(small_street(), ego=None)
    views = preview_cameras(scene, 8)
    middle = views[1].camera.position
    assert middle[2] == pytest.approx(EYE_HEIGHT_M)
    assert np.abs(middle[:2] - [12, 0]).max() < 6
    for ring, outward in zip(views[::2], views[1::2], strict=True):
        to_middle = (middle - ring.camera.position) / np.linalg.norm(middle - ring.camera.position)
        np.testing.assert_allclose(forward_of(ring.camera), to_middle, atol=1e-9)
        np.testing.assert_allclose(outward.camera.position, middle, atol=1e-9)
    assert len({tuple(np.round(forward_of(view.camera), 6)) for view in views}) == 8


def test_an_empty_scene_still_gives_cameras():
    assert len(preview_cameras(Scene("empty"), 3)) == 3


def test_ground_is_what_the_scene_says_or_what_lies_low():
    scene = small_street()
    assert ground_height_m(replace(scene, ground_m=-2.0)) == -2
    assert ground_height_m(replace(scene, ground_m=None)) == pytest.approx(0, abs=0.01)
    assert ground_height_m(Scene("empty")) == 0
